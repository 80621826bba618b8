// What a set holds, as figures: against sets whose motion is known.
#include "services/diagnosis/data/motion_survey.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using ::testing::HasSubstr;

MotionSurvey SurveyOf(const recordings::RecordingSet& set) {
  const auto plant = sysid::NominalPlant(set);
  RG_CHECK(plant.ok()) << plant.status().ToString();
  auto survey = Survey(set, *plant);
  RG_CHECK(survey.ok()) << survey.status().ToString();
  return *std::move(survey);
}

// The shoulder as q(t), with v its slope; the rest of the set stays.
template <class Motion>
recordings::RecordingSet Moving(recordings::RecordingSet set, const Motion& q) {
  for (auto& rec : set.recordings) {
    for (int k = 0; k < rec.rows(); ++k) {
      rec.q(0, k) = q(rec.t[k]);
      rec.v(0, k) = (q(rec.t[k] + 1e-4) - q(rec.t[k] - 1e-4)) / 2e-4;
    }
  }
  return set;
}

TEST(MotionSurvey, SamplesCarryTheTorqueThatTheEffortWas) {
  const MotionSurvey s = SurveyOf(testing::MakeSet("arm2", {}, 41));
  ASSERT_EQ(s.samples.size(), 3u) << "recordings to fit";
  EXPECT_GT(s.Samples(), 400);
  double missed = 0, effort = 0, gravity = 0;
  for (const MotionSamples& m : s.samples) {
    missed += (m.u - m.needed).squaredNorm(), effort += m.u.squaredNorm(), gravity += m.gravity.squaredNorm();
    EXPECT_EQ((m.needed - m.rigid).norm(), 0);
  }
  EXPECT_LT(missed, 0.02 * effort);
  EXPECT_GT(gravity, 0.1 * effort);
}

TEST(MotionSurvey, WhereTheDriveCompensatesGravityTheEffortNeedNot) {
  auto set = testing::MakeSet("arm2", {}, 41);
  set.effort_excludes_gravity = true;
  for (const MotionSamples& m : SurveyOf(set).samples)
    EXPECT_LT((m.rigid - m.gravity - m.needed).norm(), 1e-12 * m.rigid.norm());
}

TEST(MotionSurvey, TellsTravelReversalsAndSpeeds) {
  // Half a hertz, from −0.5 to 0.5 rad: four seconds hold two periods, and the speed peaks at 1.57 rad/s.
  const auto set =
      Moving(testing::MakeSet("arm2", {}, 42), [](double t) { return 0.5 * std::sin(2 * M_PI * 0.5 * t); });
  const JointFigures f = SurveyOf(set).joints[0];
  EXPECT_TRUE(f.moved);
  EXPECT_NEAR(f.low, -0.5, 1e-3);
  EXPECT_NEAR(f.high, 0.5, 1e-3);
  EXPECT_NEAR(f.peak_speed, M_PI * 0.5, 0.02);
  EXPECT_NEAR(f.speed, M_PI * 0.5 / std::sqrt(2), 0.05);
  // 3 recordings of 4 s: 2 rad up and 2 rad down each second period.
  EXPECT_NEAR(f.up, 6, 0.4);
  EXPECT_NEAR(f.down, 6, 0.4);
  EXPECT_GT(f.fast, 3 * f.slow);
  EXPECT_GT(f.slow_rows, 5);
}

TEST(MotionSurvey, OneWayIsOneWay) {
  const auto set = Moving(testing::MakeSet("arm2", {}, 43), [](double t) { return 0.3 * t - 0.5; });
  const JointFigures f = SurveyOf(set).joints[0];
  EXPECT_NEAR(f.up, 3 * 1.2, 0.2);
  EXPECT_EQ(f.down, 0);
  EXPECT_EQ(f.slow_rows, 0);
  EXPECT_NEAR(f.fast, 0.3, 0.03);
  EXPECT_NEAR(f.slow, 0.3, 0.03);
}

TEST(MotionSurvey, NoiseAloneIsNoMotion) {
  auto set = testing::MakeSet("arm2", {}, 44);
  Rng rng(7);
  for (auto& rec : set.recordings) {
    for (int k = 0; k < rec.rows(); ++k)
      rec.q(0, k) = 0.3 + testing::kPositionNoise * rng.Normal(),
               rec.v(0, k) = testing::kVelocityNoise * rng.Normal();
  }
  const MotionSurvey s = SurveyOf(set);
  EXPECT_FALSE(s.joints[0].moved);
  EXPECT_LT(s.joints[0].up + s.joints[0].down, 0.1);
  EXPECT_TRUE(s.joints[1].moved);
  EXPECT_NEAR(s.estimated.position_stddev[0], testing::kPositionNoise, 0.2 * testing::kPositionNoise);
  const auto still = StillJoints(s);
  ASSERT_EQ(still.size(), 1u);
  EXPECT_EQ(still[0].joint, 0);
}

TEST(StillJoints, HoldAgainstTheLargestTorqueBesideTheirEffort) {
  auto set = testing::MakeSet("pendulum", {}, 45);
  // It hangs, where gravity asks for nothing, while 1.2 N·m push it for a while one way and 0.7 the other.
  for (auto& rec : set.recordings) {
    rec.q.setZero(), rec.v.setZero(), rec.effort_command.setZero();
    for (int k = 0; k < rec.rows(); ++k) {
      if (rec.t[k] > 1 && rec.t[k] < 1.5) rec.effort_command(0, k) = 1.2;
      if (rec.t[k] > 2 && rec.t[k] < 2.5) rec.effort_command(0, k) = -0.7;
    }
  }
  const auto still = StillJoints(SurveyOf(set));
  ASSERT_EQ(still.size(), 1u);
  EXPECT_NEAR(still[0].withstood, 1.2, 1e-6);
  EXPECT_TRUE(still[0].held);
}

TEST(MotionSurvey, PiecesOfOneFileAreOneWithGapsBetween) {
  auto set = testing::MakeSet("arm2", {}, 46);
  recordings::Recording behind = recordings::Slice(set.recordings[0], 200, 150);
  behind.t.array() += 5.0;
  set.recordings[0] = recordings::Slice(set.recordings[0], 0, 200);
  set.recordings.insert(set.recordings.begin() + 1, behind);
  const MotionSurvey s = SurveyOf(set);
  ASSERT_EQ(s.files.size(), 4u);
  EXPECT_EQ(s.samples.size(), 4u);
  EXPECT_EQ(s.files[0].rows, 350);
  ASSERT_EQ(s.files[0].gaps.size(), 1u);
  EXPECT_NEAR(s.files[0].gaps[0].second - s.files[0].gaps[0].first, 5.01, 1e-9);
  EXPECT_EQ(s.files[0].missing, 0);
  EXPECT_NEAR(s.files[0].duration, 3.49 + 5.0, 1e-9);
  EXPECT_NEAR(s.files[0].period, 0.01, 1e-9);
}

TEST(MotionSurvey, CountsMissingRowsAndKnowsTemperatures) {
  auto set = testing::MakeSet("arm2", {}, 47);
  set.recordings[0].t.tail(100).array() += 0.03;
  Eigen::VectorXd warm = Eigen::VectorXd::Constant(set.recordings[0].rows(), 30.0);
  warm.tail(50).setConstant(34.0);
  warm[0] = std::nan("");
  set.recordings[0].other["temperature.elbow"] = warm;
  const MotionSurvey s = SurveyOf(set);
  EXPECT_EQ(s.files[0].missing, 3);
  EXPECT_TRUE(s.files[0].gaps.empty());
  EXPECT_EQ(s.joints[1].temperature_low, 30);
  EXPECT_EQ(s.joints[1].temperature_high, 34);
  EXPECT_TRUE(std::isnan(s.joints[0].temperature_low));
  EXPECT_THAT(s.files[0].columns, ::testing::Contains("temperature"));
}

TEST(MotionSurvey, RefusesWhatNothingCanBeSaidOf) {
  const auto error = [](recordings::RecordingSet set) {
    const auto plant = sysid::NominalPlant(set);
    const auto s = Survey(set, *plant);
    return s.ok() ? "accepted" : s.status().message();
  };
  auto set = testing::MakeSet("pendulum", {}, 48, 1.0);
  auto aside = set;
  for (auto& rec : aside.recordings) rec.split = recordings::Split::kHoldout;
  EXPECT_THAT(error(aside), HasSubstr("no recording is there to fit"));
  set.recordings[1] = recordings::Slice(set.recordings[1], 0, 9);
  EXPECT_THAT(error(set), ::testing::AllOf(HasSubstr("rec_001.csv"), HasSubstr("fewer than 10 rows")));
}

TEST(WorkingNoise, AddsQuantisationToWhatADataSheetSays) {
  recordings::SensorNoise noise{Eigen::VectorXd::Constant(1, 3e-4), Eigen::VectorXd::Zero(1),
                                Eigen::VectorXd::Constant(1, 1e-3)};
  recordings::NoiseSpec given;
  EXPECT_DOUBLE_EQ(WorkingNoise(noise, given).position_stddev[0], 3e-4) << "an estimate holds it already";
  given.position_stddev = 3e-4;
  EXPECT_NEAR(WorkingNoise(noise, given).position_stddev[0], std::sqrt(9e-8 + 1e-6 / 12), 1e-12);
  EXPECT_GT(WorkingNoise(noise, given).velocity_stddev[0], 0);
}

}  // namespace
}  // namespace rg::diagnosis
