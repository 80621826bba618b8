#include "common/recordings/prescribed.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/base/rng.h"
#include "common/recordings/csv.h"

namespace rg::recordings {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::string Urdf() {
  std::string text = R"(<robot name="three"><link name="link_0"/>)";
  const char* joints[] = {"lift", "shoulder", "elbow"};
  for (int k = 1; k <= 3; ++k) {
    const std::string n = std::to_string(k);
    text += "<link name=\"link_" + n + R"("><inertial><mass value="1"/><origin xyz="0 0 0.1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>)";
    text += std::string("<joint name=\"") + joints[k - 1] + "\" type=\"" +
            (k == 1 ? "prismatic" : "continuous") + "\"><parent link=\"link_" + std::to_string(k - 1) +
            "\"/><child link=\"link_" + n +
            "\"/><axis xyz=\"0 1 0\"/><limit lower=\"-1\" upper=\"1\" effort=\"10\" velocity=\"5\"/></joint>";
  }
  return text + "</robot>";
}

// 41 rows of 10 ms in which every joint moves; which columns there are is the caller's.
std::string Csv(const std::vector<std::string>& columns) {
  std::string text = "time";
  for (const std::string& c : columns) text += "," + c;
  for (int k = 0; k <= 40; ++k) {
    const double t = 0.01 * k;
    text += "\n" + std::to_string(t);
    for (const std::string& c : columns) {
      const double value = c.starts_with("position")   ? 0.3 * std::sin(3 * t)
                           : c.starts_with("velocity") ? 0.9 * std::cos(3 * t)
                                                       : 2.0 + t;
      text += "," + std::to_string(value);
    }
  }
  return text + "\n";
}

const std::vector<std::string> kAllPositions = {"position.lift", "position.shoulder", "position.elbow"};

std::vector<std::string> With(std::vector<std::string> columns, const std::vector<std::string>& more) {
  columns.insert(columns.end(), more.begin(), more.end());
  return columns;
}

const std::vector<std::string> kLiftIsHeld =
    With(kAllPositions,
         {"velocity.shoulder", "velocity.elbow", "effort_command.shoulder", "effort_command.elbow"});
const std::vector<std::string> kAllDriven =
    With(kAllPositions, {"effort_command.lift", "effort_command.shoulder", "effort_command.elbow"});

class Folder {
 public:
  Folder(const std::string& extra, const std::string& a, const std::string& b)
      : path_(fs::temp_directory_path() / ("rg_prescribed_" + RandomHex(6))) {
    fs::create_directories(path_);
    Write("robot.urdf", Urdf());
    Write("manifest.json", R"({"format": "realitygrad.recordings/1", "robot": "robot.urdf",
      "joints": ["lift", "shoulder", "elbow"], )" +
                               extra + R"("recordings": [{"file": "a.csv"}, {"file": "b.csv"}]})");
    Write("a.csv", a), Write("b.csv", b);
  }
  ~Folder() { fs::remove_all(path_); }
  Result<RecordingSet> Load() const { return LoadSet(path_.string()); }

 private:
  void Write(const std::string& file, const std::string& text) const {
    ASSERT_TRUE(WriteFileAtomically((path_ / file).string(), text).ok());
  }
  fs::path path_;
};

Result<RecordingSet> Load(const std::string& extra, const std::string& a, const std::string& b) {
  return Folder(extra, a, b).Load();
}

std::string ErrorOf(const std::string& extra, const std::string& a, const std::string& b) {
  const auto set = Load(extra, a, b);
  return set.ok() ? "accepted" : set.status().message();
}

TEST(Prescribed, AreJointsWithoutAnyEffortWhereOthersHaveOne) {
  const auto set = Load("", Csv(kLiftIsHeld), Csv(kLiftIsHeld));
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_THAT(set->prescribed, ElementsAre("lift"));
  EXPECT_FALSE(set->prescribed_listed);
  for (const Recording& r : set->recordings) {
    EXPECT_THAT(r.prescribed, ElementsAre(0));
    EXPECT_TRUE(r.IsPrescribed(0));
    EXPECT_FALSE(r.IsPrescribed(1));
    EXPECT_EQ(r.effort_command.row(0).cwiseAbs().maxCoeff(), 0.0);
    EXPECT_NEAR(r.effort_command(1, 10), 2.1, 1e-6);
  }
  EXPECT_THAT(NoteOnPrescribed(*set),
              HasSubstr("lift moves as measured (prescribed): it has no effort column"));
}

TEST(Prescribed, TakeTheirVelocityFromPositionsWhereNoColumnGivesIt) {
  const auto set = Load("", Csv(kLiftIsHeld), Csv(kLiftIsHeld));
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  const Recording& r = set->recordings[0];
  EXPECT_THAT(r.without_velocity, ElementsAre(0));
  for (int k = 2; k + 2 < r.rows(); ++k) EXPECT_NEAR(r.v(0, k), 0.9 * std::cos(3 * r.t[k]), 5e-3) << k;
}

TEST(Prescribed, AreWhatTheManifestSaysWhereItSaysAnything) {
  const auto listed = Load(R"("prescribed": ["lift"], )", Csv(kAllDriven), Csv(kAllDriven));
  ASSERT_TRUE(listed.ok()) << listed.status().ToString();
  EXPECT_THAT(listed->prescribed, ElementsAre("lift"));
  EXPECT_EQ(listed->recordings[0].effort_command.row(0).cwiseAbs().maxCoeff(), 0.0);
  EXPECT_NEAR(listed->recordings[0].other.at("effort_command.lift")[10], 2.1, 1e-6);
  EXPECT_THAT(NoteOnPrescribed(*listed), HasSubstr("the manifest says so"));
  const std::string held = Csv(With(kAllPositions, {"effort_command.shoulder", "effort_command.elbow"}));
  EXPECT_THAT(ErrorOf(R"("prescribed": [], )", held, held),
              HasSubstr("column effort_command.lift is missing, other joints have effort_command "
                        "(\"prescribed\" in the manifest"));
}

TEST(Prescribed, AreNotJointsThatHaveAnEffortInSomeRecordingsOnly) {
  EXPECT_THAT(ErrorOf("", Csv(kAllDriven), Csv(kLiftIsHeld)),
              HasSubstr("b.csv: header (line 1): no effort of lift, which other recordings have"));
}

TEST(Prescribed, AreNamesOfJointsOnceAndNeverAll) {
  const std::string csv = Csv(kAllDriven);
  EXPECT_THAT(ErrorOf(R"("prescribed": ["lif"], )", csv, csv),
              HasSubstr("manifest.json: prescribed[0]: \"lif\" is not among joints"));
  EXPECT_THAT(ErrorOf(R"("prescribed": ["lift", "lift"], )", csv, csv),
              HasSubstr("prescribed[1]: \"lift\" is there twice"));
  EXPECT_THAT(ErrorOf(R"("prescribed": ["lift", "shoulder", "elbow"], )", csv, csv),
              HasSubstr("prescribed: names every joint, nothing is left to model"));
  EXPECT_THAT(ErrorOf(R"("prescribed": ["lift"], "passive": ["lift"], )", csv, csv),
              HasSubstr("passive: 'lift' is among prescribed too"));
  EXPECT_THAT(ErrorOf(R"("passive": ["wrist"], )", csv, csv),
              HasSubstr("passive[0]: \"wrist\" is not among joints"));
}

TEST(Prescribed, AreTheSameAfterWritingAndReading) {
  const auto set = Load(R"("passive": ["elbow"], )", Csv(kLiftIsHeld), Csv(kLiftIsHeld));
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  const std::string folder = (fs::temp_directory_path() / ("rg_prescribed_" + RandomHex(6))).string();
  ASSERT_TRUE(WriteSet(folder, *set).ok());
  const auto again = LoadSet(folder);
  fs::remove_all(folder);
  ASSERT_TRUE(again.ok()) << again.status().ToString();
  EXPECT_EQ(again->prescribed, set->prescribed);
  EXPECT_EQ(again->passive, set->passive);
  EXPECT_THAT(*again->passive, ElementsAre("elbow"));
  EXPECT_EQ(again->recordings[0].without_velocity, set->recordings[0].without_velocity);
  EXPECT_EQ(again->recordings[0].v, set->recordings[0].v);
  EXPECT_EQ(again->recordings[0].other.count("effort_command.lift"), 0u);
}

TEST(Prescribed, FollowTheirRowsWhenJointsAreReordered) {
  const auto set = Load("", Csv(kLiftIsHeld), Csv(kLiftIsHeld));
  ASSERT_TRUE(set.ok());
  const auto picked = Reorder(set->recordings[0], {"elbow", "lift"});
  ASSERT_TRUE(picked.ok());
  EXPECT_THAT(picked->prescribed, ElementsAre(1));
  EXPECT_THAT(picked->without_velocity, ElementsAre(1));
  const auto without = Reorder(set->recordings[0], {"elbow", "shoulder"});
  ASSERT_TRUE(without.ok());
  EXPECT_THAT(without->prescribed, IsEmpty());
}

// A lift that moves from rest to rest, read by an encoder of 0.5 mm at uneven times, with rows missing.
Recording NoisyLift(bool velocity) {
  Recording r;
  r.joints = {"lift", "elbow"};
  Rng rng(3);
  std::vector<double> times;
  for (double t = 0; t < 6; t += 0.01 * rng.Uniform(0.8, 1.2)) {
    if (t < 2.0 || t > 2.07) times.push_back(t);
  }
  const auto K = static_cast<Eigen::Index>(times.size());
  r.t = Eigen::Map<const Eigen::VectorXd>(times.data(), K);
  r.q.setZero(2, K), r.effort_command.setZero(2, K);
  if (velocity) r.v.setZero(2, K);
  for (Eigen::Index k = 0; k < K; ++k) {
    r.q(0, k) = 0.3 * std::sin(1.7 * r.t[k]) + 0.1 * std::sin(4.3 * r.t[k]) + 5e-4 * rng.Normal();
    if (velocity)
      r.v(0, k) = 0.51 * std::cos(1.7 * r.t[k]) + 0.43 * std::cos(4.3 * r.t[k]) + 5e-3 * rng.Normal();
  }
  r.prescribed = {0};
  return r;
}

TEST(SmoothPrescribed, StaysWithinTheNoiseAndHasAnAccelerationOfUse) {
  for (const bool velocity : {false, true}) {
    const Recording r = NoisyLift(velocity);
    const SmoothMotionRows rows = SmoothPrescribed(r);
    ASSERT_EQ(rows.q.rows(), 1);
    double q = 0, v = 0, a = 0, left = 0, difference = 0;
    const Eigen::Index K = r.t.size();
    for (Eigen::Index k = 20; k + 20 < K; ++k) {
      const double t = r.t[k];
      q += std::pow(rows.q(0, k) - 0.3 * std::sin(1.7 * t) - 0.1 * std::sin(4.3 * t), 2);
      v += std::pow(rows.v(0, k) - 0.51 * std::cos(1.7 * t) - 0.43 * std::cos(4.3 * t), 2);
      const double truth = -0.867 * std::sin(1.7 * t) - 1.849 * std::sin(4.3 * t);
      a += std::pow(rows.a(0, k) - truth, 2);
      left += std::pow(rows.q(0, k) - r.q(0, k), 2);
      const double before = (r.q(0, k) - r.q(0, k - 1)) / (t - r.t[k - 1]);
      const double after = (r.q(0, k + 1) - r.q(0, k)) / (r.t[k + 1] - t);
      difference += std::pow(2 * (after - before) / (r.t[k + 1] - r.t[k - 1]) - truth, 2);
    }
    const double n = static_cast<double>(K - 40);
    EXPECT_LT(std::sqrt(q / n), 2.5e-4) << velocity;
    EXPECT_NEAR(std::sqrt(left / n), 5e-4, 1e-4) << "neither follows the noise nor loses the motion";
    EXPECT_LT(std::sqrt(v / n), 5e-3) << velocity;
    EXPECT_LT(std::sqrt(a / n), 0.12) << velocity;
    EXPECT_GT(std::sqrt(difference / n), 5.0) << "what differences of rows would say";
  }
}

// The ways in which it may differ, what it may have been as well, and how far it was off speak of one distribution.
TEST(PrescribedDoubt, WaysAndDrawsSpreadAsFarAsTheTruthIsOff) {
  for (const bool velocity : {false, true}) {
    const Recording r = NoisyLift(velocity);
    const SmoothMotionRows smooth = SmoothPrescribed(r);
    const PrescribedDoubt doubt(r);
    const int first = 60, last = 180;
    const WaysToDiffer ways = doubt.Ways(0, first, last);
    ASSERT_EQ(ways.a.rows(), last - first + 1);
    EXPECT_LE(ways.a.cols(), ways.a.rows());
    Rng rng(9);
    constexpr int kDraws = 200;
    double q = 0, v = 0, a = 0, off_q = 0, off_v = 0;
    for (int draw = 0; draw < kDraws; ++draw) {
      const SmoothMotionRows other = doubt.Draw(rng);
      q += (other.q - smooth.q).middleCols(first, ways.q.rows()).squaredNorm() / kDraws;
      v += (other.v - smooth.v).middleCols(first, ways.v.rows()).squaredNorm() / kDraws;
      a += (other.a - smooth.a).middleCols(first, ways.a.rows()).squaredNorm() / kDraws;
    }
    for (int k = first; k <= last; ++k) {
      const double t = r.t[k];
      off_q += std::pow(smooth.q(0, k) - 0.3 * std::sin(1.7 * t) - 0.1 * std::sin(4.3 * t), 2);
      off_v += std::pow(smooth.v(0, k) - 0.51 * std::cos(1.7 * t) - 0.43 * std::cos(4.3 * t), 2);
    }
    EXPECT_NEAR(ways.v.squaredNorm() / v, 0.99, 0.05) << velocity;
    // Velocities leave some of the others' doubt open.
    EXPECT_LT(ways.q.squaredNorm(), 1.05 * q);
    EXPECT_LT(ways.a.squaredNorm(), 1.05 * a);
    EXPECT_GT(off_q, q / 4) << velocity;
    EXPECT_LT(off_q, q * 4) << velocity;
    EXPECT_GT(off_v, v / 4) << velocity;
    EXPECT_LT(off_v, v * 4) << velocity;
  }
}

// A joint at rest until 1 s and again from 3 s on, which swings hard in between, at 100 Hz.
Recording RestAndSwing(uint64_t seed, Eigen::VectorXd* truth) {
  Recording r;
  r.joints = {"shoulder", "elbow"};
  Rng rng(seed);
  constexpr int kRows = 401;
  r.t = Eigen::VectorXd::LinSpaced(kRows, 0.0, 4.0);
  r.q.setZero(2, kRows), r.v.setZero(2, kRows), r.effort_command.setZero(2, kRows), truth->setZero(kRows);
  for (int k = 0; k < kRows; ++k) {
    const double s = M_PI * std::clamp(r.t[k] - 1, 0.0, 2.0) / 2;  // 0.3·sin²(s)·sin(8s) of it
    const double envelope = std::sin(s) * std::sin(s), slope = 2 * std::sin(s) * std::cos(s);
    const bool swings = r.t[k] > 1 && r.t[k] < 3;
    if (swings)
      (*truth)[k] = 0.3 * M_PI / 2 * (slope * std::sin(8 * s) + 8 * envelope * std::cos(8 * s));
    r.q(0, k) = 0.3 * envelope * std::sin(8 * s) + 5e-4 * rng.Normal();
    r.v(0, k) = (*truth)[k] + 8e-3 * rng.Normal();
  }
  r.prescribed = {0};
  return r;
}

// One joint is in less doubt at rest than while it swings, and in either as much as it is off: a draw of its motion
// differs from the smooth one by as much as the truth does. From the first row on: its acceleration is in finite doubt.
TEST(PrescribedDoubt, IsOfTheMotionThereNotOfTheWholeRecording) {
  double off_rest = 0, off_swing = 0, doubt_rest = 0, doubt_swing = 0, first = 0, first_doubt = 0, held = 0, acceleration = 0;
  constexpr int kSeeds = 8;
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    Eigen::VectorXd truth;
    const Recording r = RestAndSwing(seed, &truth);
    const SmoothMotionRows smooth = SmoothPrescribed(r);
    const Eigen::VectorXd off = smooth.v.row(0).transpose() - truth;
    off_rest += off.head(60).squaredNorm() / 60, off_swing += off.segment(130, 140).squaredNorm() / 140;
    first += off.head(3).squaredNorm() / 3;
    const PrescribedDoubt doubt(r);
    Rng rng(seed);
    constexpr int kDraws = 20;
    for (int draw = 0; draw < kDraws; ++draw) {
      const SmoothMotionRows other = doubt.Draw(rng);
      const Eigen::VectorXd differs = (other.v - smooth.v).row(0).transpose();
      doubt_rest += differs.head(60).squaredNorm() / 60 / kDraws;
      doubt_swing += differs.segment(130, 140).squaredNorm() / 140 / kDraws;
      first_doubt += differs.head(3).squaredNorm() / 3 / kDraws;
      acceleration = std::max(acceleration, (other.a - smooth.a).cwiseAbs().maxCoeff());
    }
    // What the others are pushed by is how far the velocity may be off: the ways hold nearly all of that.
    held += doubt.Ways(0, 130, 269).v.squaredNorm() / 140;
  }
  EXPECT_NEAR(held / doubt_swing, 0.99, 0.1);
  EXPECT_LT(doubt_rest, 0.25 * doubt_swing);
  EXPECT_LT(std::max(off_rest / doubt_rest, doubt_rest / off_rest), 3.0) << off_rest << " " << doubt_rest;
  EXPECT_LT(std::max(off_swing / doubt_swing, doubt_swing / off_swing), 3.0) << off_swing << " " << doubt_swing;
  EXPECT_LT(std::max(first / first_doubt, first_doubt / first), 4.0) << first << " " << first_doubt;
  EXPECT_LT(acceleration, 50.0);
}

}  // namespace
}  // namespace rg::recordings
