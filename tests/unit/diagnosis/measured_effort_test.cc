// Sets whose drive's effort is measured, with a coloured noise of its own: what real robots give.
#include <gtest/gtest.h>

#include <regex>

#include "services/diagnosis/diagnosis.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;

constexpr double kEffortNoise = 0.03;  // of the effort's RMS

recordings::RecordingSet MeasuredSet(const std::string& robot, std::vector<effects::EffectSpec> effects,
                                     uint64_t seed, double effort_noise = kEffortNoise) {
  auto set = testing::MakeSet(robot, std::move(effects), seed, 6.0);
  set.noise = {};
  // What the URDF declares is calibrated: take it away, so that all damping is an effect.
  set.urdf_text = std::regex_replace(set.urdf_text, std::regex("damping=\"[0-9.]+\""), "damping=\"0\"");
  testing::MeasureEffort(seed + 99, effort_noise, &set);
  return set;
}

DiagnosisResult Diagnosed(const recordings::RecordingSet& set, std::optional<sim::ModelFile> model = {}) {
  DiagnosisOptions options;
  options.model = std::move(model);
  options.threads = 2;
  auto result = Diagnose(set, options, RealClock());
  RG_CHECK(result.ok()) << result.status().ToString();
  return *result;
}

const Finding* Find(const DiagnosisResult& r, const std::string& effect) {
  for (const Finding& f : r.findings) {
    if (f.effect == effect) return &f;
  }
  return nullptr;
}

double Value(const Finding& f, const std::string& owner, const std::string& name) {
  for (const ParameterEstimate& p : f.parameters) {
    if (p.owner == owner && p.name == name) return p.value;
  }
  return NAN;
}

TEST(MeasuredEffort, NamesTwoFrictionsOnTwoJointsUnderACorrelatedEffortNoise) {
  const auto names = sysid::testing::LoadPlant("arm2").joint_names();
  const auto r = Diagnosed(MeasuredSet("arm2",
                                       {MakeSpec("coulomb_friction", {names[0]}, {{"coulomb", 2.0}}),
                                        MakeSpec("viscous_friction", {names[1]}, {{"viscous", 0.8}})},
                                       31));
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  const Finding* coulomb = Find(r, "coulomb_friction");
  ASSERT_NE(coulomb, nullptr);
  EXPECT_EQ(coulomb->joints, std::vector<std::string>{names[0]});
  EXPECT_NEAR(Value(*coulomb, names[0], "coulomb"), 2.0, 0.2);
  const Finding* viscous = Find(r, "viscous_friction");
  ASSERT_NE(viscous, nullptr);
  EXPECT_NEAR(Value(*viscous, names[1], "viscous"), 0.85, 0.08);  // 0.05 of it the URDF's own
  EXPECT_LT(r.holdout.after_rms, 0.5 * r.holdout.before_rms);
}

TEST(MeasuredEffort, NamesNoPhysicsWhereOnlyTheEffortIsNoisy) {
  for (const uint64_t seed : {41, 42, 43}) {
    for (const char* robot : {"pendulum", "arm2"}) {
      auto set = MeasuredSet(robot, {}, seed);
      set.urdf_text = testing::MakeSet(robot, {}, seed, 1.0).urdf_text;
      const auto r = Diagnosed(set);
      EXPECT_TRUE(r.verdict == "no_mismatch" || r.verdict == "parameters_only") << robot << " " << r.verdict;
    }
  }
}

TEST(MeasuredEffort, AnEffortThatHardlyGoesWithTheMotionIsNotCalledAMatch) {
  const auto r = Diagnosed(MeasuredSet("pendulum", {}, 44, 1.5));
  EXPECT_EQ(r.verdict, "unexplained");
  ASSERT_FALSE(r.findings.empty());
  EXPECT_EQ(r.findings[0].effect, "unknown_field");
}

TEST(MeasuredEffort, FindsByHowMuchMotionLagsEffort) {
  const auto name = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto r = Diagnosed(MeasuredSet("pendulum",
                                       {MakeSpec("actuator_delay", {name}, {{"delay", 0.03}}),
                                        MakeSpec("coulomb_friction", {name}, {{"coulomb", 0.15}})},
                                       51));
  const Finding* delay = Find(r, "actuator_delay");
  ASSERT_NE(delay, nullptr);
  EXPECT_NEAR(Value(*delay, name, "delay"), 0.03, 0.004);
  ASSERT_NE(Find(r, "coulomb_friction"), nullptr);
  EXPECT_NEAR(Value(*Find(r, "coulomb_friction"), name, "coulomb"), 0.15, 0.02);
}

TEST(MeasuredEffort, OfAGivenModelOnlyTheBaseParametersCount) {
  const auto name = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto set = MeasuredSet("pendulum", {MakeSpec("coulomb_friction", {name}, {{"coulomb", 0.15}})}, 51);
  const sim::Plant urdf = sysid::NominalPlant(set).value();
  const sim::Plant given = sim::Plant::Create(urdf.shared_model(), urdf.options(),
                                              {MakeSpec("coulomb_friction", {name}, {{"coulomb", 0.15}})})
                               .value();
  const auto alone = Diagnosed(set);
  const auto from = Diagnosed(set, sim::ModelFile{given, given.parameters().Nominal(), 0});
  ASSERT_NE(Find(from, "coulomb_friction"), nullptr);
  EXPECT_EQ(from.verdict, alone.verdict);
  EXPECT_EQ(from.values, alone.values);
}

// Friction that depends on the direction is the same as Coulomb friction and an effort whose zero is off,
// which is what is said.
TEST(MeasuredEffort, TellsAnEffortWhoseZeroIsOff) {
  const auto name = sysid::testing::LoadPlant("slide").joint_names()[0];
  const auto asymmetric =
      MakeSpec("asymmetric_friction", {name}, {{"coulomb_positive", 6.0}, {"coulomb_negative", 14.0}});
  const std::vector<effects::EffectSpec> offset = {MakeSpec("coulomb_friction", {name}, {{"coulomb", 10.0}}),
                                                   MakeSpec("torque_offset", {name}, {{"offset", 4.0}})};
  for (const auto& truth : {std::vector<effects::EffectSpec>{asymmetric}, offset}) {
    const auto r = Diagnosed(MeasuredSet("slide", truth, 61));
    const Finding *zero = Find(r, "torque_offset"), *dry = Find(r, "coulomb_friction");
    ASSERT_NE(zero, nullptr);
    ASSERT_NE(dry, nullptr);
    EXPECT_NEAR(Value(*zero, name, "offset"), 4.0, 1.0);
    EXPECT_NEAR(Value(*dry, name, "coulomb"), 10.0, 1.5);
    EXPECT_NE(std::find(zero->effect_class.begin(), zero->effect_class.end(), "asymmetric_friction"),
              zero->effect_class.end());
  }
}

// The same physics, whatever it is called and however it is cut.
TEST(MeasuredEffort, VerdictDoesNotDependOnHowRecordingsAreCut) {
  const auto names = sysid::testing::LoadPlant("arm2").joint_names();
  const auto set = MeasuredSet("arm2", {MakeSpec("coulomb_friction", {names[0]}, {{"coulomb", 2.0}})}, 71);
  auto cut = set;
  const recordings::Recording whole = cut.recordings[0];
  cut.recordings[0] = recordings::Slice(whole, 0, whole.rows() / 2);
  cut.recordings.push_back(recordings::Slice(whole, whole.rows() / 2, whole.rows() - whole.rows() / 2));
  cut.recordings.back().name = "second_half.csv";
  for (const auto& s : {set, cut}) {
    const auto r = Diagnosed(s);
    const Finding* f = Find(r, "coulomb_friction");
    ASSERT_NE(f, nullptr);
    EXPECT_EQ(f->joints, std::vector<std::string>{names[0]});
    EXPECT_NEAR(Value(*f, names[0], "coulomb"), 2.0, 0.2);
  }
}

}  // namespace
}  // namespace rg::diagnosis
