// The same physics told in another way gets the same verdict.
#include <gtest/gtest.h>

#include <filesystem>
#include <regex>

#include "common/base/ids.h"
#include "services/diagnosis/diagnosis.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;

constexpr double kLevel = 0.15;  // N·m

DiagnosisResult Diagnosed(const recordings::RecordingSet& set) {
  DiagnosisOptions options;
  options.threads = 2;
  options.max_effects = 1;
  auto result = Diagnose(set, options, RealClock());
  RG_CHECK(result.ok()) << result.status().ToString();
  return *result;
}

recordings::RecordingSet Rubbing(double level = kLevel, uint64_t seed = 81) {
  return testing::MakeSet("pendulum", {MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", level}})}, seed,
                          2.0);
}

// Multiplies the numbers of an attribute, wherever it stands: mass value="0.6".
std::string ScaleAttribute(const std::string& xml, const std::string& element, const std::string& attribute,
                           double factor) {
  const std::regex pattern("(<" + element + "[^>]*\\b" + attribute + "=\")([^\"]*)(\")");
  std::string out, rest = xml;
  std::smatch found;
  while (std::regex_search(rest, found, pattern)) {
    std::istringstream numbers(found[2]);
    std::ostringstream scaled;
    scaled.precision(17);
    for (double x; numbers >> x;) scaled << (scaled.tellp() > 0 ? " " : "") << factor * x;
    out += found.prefix().str() + found[1].str() + scaled.str() + found[3].str();
    rest = found.suffix();
  }
  return out + rest;
}

// The set in units of mass and length in which a kilogram is `mass` and a metre is `length`.
recordings::RecordingSet InUnits(recordings::RecordingSet set, double mass, double length) {
  std::string& xml = set.urdf_text;
  xml = ScaleAttribute(xml, "mass", "value", mass);
  for (const char* i : {"ixx", "iyy", "izz", "ixy", "ixz", "iyz"})
    xml = ScaleAttribute(xml, "inertia", i, mass * length * length);
  xml = ScaleAttribute(xml, "origin", "xyz", length);
  xml = ScaleAttribute(xml, "limit", "effort", mass * length * length);
  for (const char* d : {"damping", "friction"})
    xml = ScaleAttribute(xml, "dynamics", d, mass * length * length);
  set.gravity *= length;
  for (auto& rec : set.recordings) rec.effort_command *= mass * length * length;
  return set;
}

void ExpectFriction(const DiagnosisResult& r, const std::string& joint, double level) {
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  ASSERT_FALSE(r.findings.empty());
  const Finding& f = r.findings[0];
  EXPECT_EQ(f.effect, "coulomb_friction");
  EXPECT_EQ(f.joints, std::vector<std::string>{joint});
  ASSERT_FALSE(f.parameters.empty());
  EXPECT_NEAR(f.parameters[0].value, level, 0.05 * level);
}

TEST(Metamorphic, NamesOfJointsDoNotMatter) {
  auto set = Rubbing();
  set.urdf_text = std::regex_replace(set.urdf_text, std::regex("\"hinge\""), "\"a_joint with spaces/7\"");
  set.joints = {"a_joint with spaces/7"};
  for (auto& rec : set.recordings) rec.joints = set.joints;
  ExpectFriction(Diagnosed(set), set.joints[0], kLevel);
}

TEST(Metamorphic, UnitsOfMassDoNotMatter) {
  ExpectFriction(Diagnosed(InUnits(Rubbing(), 1000.0, 1.0)), "hinge", 1000.0 * kLevel);
  ExpectFriction(Diagnosed(InUnits(Rubbing(), 1e-3, 1.0)), "hinge", 1e-3 * kLevel);
}

TEST(Metamorphic, UnitsOfLengthDoNotMatter) {
  ExpectFriction(Diagnosed(InUnits(Rubbing(), 1.0, 10.0)), "hinge", 100.0 * kLevel);
}

TEST(Metamorphic, UnitsDoNotMakeAMismatch) {
  const auto set = testing::MakeSet("pendulum", {}, 82, 2.0);
  for (const double mass : {1e-3, 1e3}) {
    EXPECT_EQ(Diagnosed(InUnits(set, mass, 1.0)).verdict, "no_mismatch") << mass;
  }
}

TEST(Metamorphic, TheOtherDirectionOfAJointsAxisDoesNotMatter) {
  auto set = Rubbing();
  set.urdf_text = ScaleAttribute(set.urdf_text, "axis", "xyz", -1.0);
  for (auto& rec : set.recordings) rec.q *= -1, rec.v *= -1, rec.effort_command *= -1;
  ExpectFriction(Diagnosed(set), "hinge", kLevel);
}

TEST(Metamorphic, AnotherBaseFrameDoesNotMatter) {
  auto set = Rubbing();
  // The base's x axis points where z pointed: the first joint is turned back, and gravity with it.
  set.urdf_text = std::regex_replace(set.urdf_text, std::regex("xyz=\"0 0 1\" rpy=\"0 0 0\""),
                                     "xyz=\"1 0 0\" rpy=\"0 1.5707963267948966 0\"");
  set.gravity = Eigen::Vector3d(-9.81, 0, 0);
  ExpectFriction(Diagnosed(set), "hinge", kLevel);
}

TEST(Metamorphic, ARecordingCutInTwoSaysTheSame) {
  auto set = Rubbing();
  const recordings::Recording whole = set.recordings[0];
  set.recordings[0] = recordings::Slice(whole, 0, whole.rows() / 2);
  set.recordings.insert(set.recordings.begin() + 1,
                        recordings::Slice(whole, whole.rows() / 2, whole.rows() - whole.rows() / 2));
  set.recordings[1].name = "second_half.csv";
  ExpectFriction(Diagnosed(set), "hinge", kLevel);
}

TEST(Metamorphic, TheOrderOfRecordingsAndTheirClocksDoNotMatter) {
  auto set = Rubbing();
  std::swap(set.recordings[0], set.recordings[2]);
  set.recordings[0].t.array() += 1e4;
  set.recordings[1].t.array() -= 50.0;
  ExpectFriction(Diagnosed(set), "hinge", kLevel);
}

TEST(Metamorphic, TheOrderOfJointsInTheFilesDoesNotMatter) {
  const auto names = sysid::testing::LoadPlant("arm2").joint_names();
  auto set =
      testing::MakeSet("arm2", {MakeSpec("viscous_friction", {names[1]}, {{"viscous", 0.4}})}, 83, 2.0);
  const std::string folder = (std::filesystem::temp_directory_path() / ("rg_order_" + RandomHex(6))).string();
  // Files whose columns stand in the other order, and a manifest that lists them so.
  auto other = set;
  std::swap(other.joints[0], other.joints[1]);
  for (auto& rec : other.recordings) rec = *recordings::Reorder(rec, other.joints);
  ASSERT_TRUE(recordings::WriteSet(folder, other).ok());
  const auto loaded = recordings::LoadSet(folder);
  std::filesystem::remove_all(folder);
  ASSERT_TRUE(loaded.ok()) << loaded.status().ToString();
  const auto a = Diagnosed(set), b = Diagnosed(*loaded);
  EXPECT_EQ(a.verdict, b.verdict);
  ASSERT_EQ(a.findings.size(), b.findings.size());
  for (size_t i = 0; i < a.findings.size(); ++i) {
    EXPECT_EQ(a.findings[i].effect, b.findings[i].effect);
    EXPECT_EQ(a.findings[i].joints, b.findings[i].joints);
  }
  ASSERT_FALSE(a.findings.empty());
  EXPECT_EQ(a.findings[0].joints, std::vector<std::string>{names[1]});
}

TEST(Metamorphic, AStrongerEffectIsNeverLessLikelyToBeFound) {
  double last = 0;
  for (const double level : {0.01, 0.04, 0.16}) {
    const DiagnosisResult r = Diagnosed(Rubbing(level, 84));
    double confidence = 0;
    for (const Finding& f : r.findings) {
      if (f.effect == "coulomb_friction") confidence = f.confidence;
    }
    EXPECT_GE(confidence, last - 0.02) << level;
    last = confidence;
  }
  EXPECT_GT(last, 0.9);
}

}  // namespace
}  // namespace rg::diagnosis
