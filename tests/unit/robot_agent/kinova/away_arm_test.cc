// A Kinova arm that is away for a moment before its rollout begins, in a time of its own: stopped, prepared again when
// it is back, and no rollout begins twice.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "robot_agent/drivers/kinova/kinova_driver.h"
#include "robot_agent/safety/latch.h"
#include "services/rollouts/recording_bundle.h"
#include "tests/support/robot_agent/stand_in_link.h"
#include "tests/support/robot_agent/virtual_time.h"
#include "tests/unit/robot_agent/rig.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;
using stand_in::StandInArm;
using testing::HasSubstr;

class AwayArm : public testing::Test {
 protected:
  AwayArm() : rig_(true) {
    auto config = stand_in::LoadStandInConfig(SourceDir() + "/deploy/robots/mico2_stand_in.json").value();
    config.refuse_torque_mode = 0;
    arm_ = std::make_unique<StandInArm>(config, stand_in::LinkFaults{}, 1, time_);
    rig_.config.driver = "kinova";
    rig_.config.pose_tolerance = 0.06;
    rig_.config.velocity_source = VelocitySource::kDifferenced;
    rig_.config.stop = {};
    rig_.spec.duration_s = 1.0;
    options_ = kinova::ParseKinovaOptions("{}", "mico2").value();
    options_.session_path = rig_.folder + "/" + kinova::kSessionFile;
  }

  // `on_note`: at each note of the rollout's progress.
  Result<RolloutResult> Run(const std::function<void(const std::string&)>& on_note) {
    const RolloutPlan plan = rig_.Plan();
    FunctionController spring = rig_.ToGoal(plan);
    FunctionController controller([&](double t, const double* q, const double* v, double* tau) {
      begins_ += !in_rollout_;
      in_rollout_ = true;
      spring.Command(t, q, v, tau);
    });
    in_rollout_ = false;
    kinova::KinovaDriver driver(options_, stand_in::LinkTo(*arm_), time_);
    const auto progress = [&](const ProgressUpdate& update) { on_note(update.note); };
    auto result = rig_.Run(driver, plan, controller, progress);
    if (away_.joinable()) time_->Join(away_);
    return result;
  }
  // So many seconds from now.
  void GoAwayIn(double seconds) {
    if (away_.joinable()) time_->Join(away_);
    const int64_t when = time_->NowNanos() + std::llround(1e9 * seconds);
    away_ = time_->Start([this, when] {
      time_->SleepUntil(when);
      arm_->outage_wanted = true;
    });
  }
  void ExpectCompletedAfter(const Result<RolloutResult>& result, const char* setback) {
    ASSERT_TRUE(result.ok()) << result.status().ToString();
    EXPECT_EQ(result->reason, EndReason::kCompleted) << result->detail;
    const json said = json::parse(result->rollout_json);
    ASSERT_EQ(said["setbacks"].size(), 1u) << said["setbacks"];
    EXPECT_THAT(said["setbacks"][0], HasSubstr(setback));
    EXPECT_EQ(arm_->outages, 1);
    EXPECT_EQ(begins_, 1);
    EXPECT_FALSE(Latch(rig_.folder).Read().has_value());
    EXPECT_FALSE(arm_->base->in_torque_mode());
  }

  const std::shared_ptr<VirtualTime> time_ = std::make_shared<VirtualTime>();
  Rig rig_;
  std::unique_ptr<StandInArm> arm_;
  kinova::KinovaOptions options_;
  std::thread away_;
  int begins_ = 0;
  bool in_rollout_ = false;
};

TEST_F(AwayArm, OnTheWayToTheStartPoseIsPreparedAgain) {
  const auto result = Run([this](const std::string& note) {
    if (note == "to the start pose" && arm_->outages == 0) GoAwayIn(4.0);
  });
  ExpectCompletedAfter(result, "start pose: ");
}

// In the first of these its states are counted: what came is too rare for a rate, and says nothing of the arm.
TEST_F(AwayArm, WhileItIsConnectedToIsConnectedToAgain) {
  for (const double seconds : {0.1, 0.6, 1.08}) {
    SCOPED_TRACE(seconds);
    rig_.spec.id = "rollout-away-" + std::to_string(seconds);
    arm_ = std::make_unique<StandInArm>(arm_->config, stand_in::LinkFaults{}, 1, time_);
    begins_ = 0;
    GoAwayIn(seconds);
    const auto result = Run([](const std::string&) {});
    if (seconds == 0.1) {
      ExpectCompletedAfter(result, "connecting: the arm's driver fell silent");
      continue;
    }
    ASSERT_TRUE(result.ok()) << result.status().ToString();
    EXPECT_EQ(result->reason, EndReason::kCompleted) << result->detail;
    EXPECT_EQ(begins_, 1);
  }
}

TEST_F(AwayArm, ThatIsAwayEachTimeItIsConnectedToIsGivenUpInOneLine) {
  rig_.config.connect_timeout_s = 2.0;
  int again = 0;
  arm_->faults.away = true;
  const auto refused = Run([&](const std::string& note) { again += note == "the arm was away: connecting again"; });
  EXPECT_EQ(refused.status().code(), StatusCode::kUnavailable);
  EXPECT_THAT(refused.status().message(), HasSubstr("connecting: no state on /m1n6s200_driver/out/joint_state"));
  EXPECT_THAT(refused.status().message(), HasSubstr("(attempt 3 of 3)"));
  EXPECT_EQ(again, 2);
  EXPECT_FALSE(Latch(rig_.folder).Read().has_value()) << "nothing moved";
  arm_->faults.away = false;
  const auto there = Run([](const std::string&) {});
  ASSERT_TRUE(there.ok()) << there.status().ToString();
  EXPECT_EQ(there->reason, EndReason::kCompleted);
}

TEST_F(AwayArm, WhileItsTorqueModeIsProvedIsPreparedAgain) {
  const auto result = Run([this](const std::string& note) {
    if (note == "running" && arm_->outages == 0) GoAwayIn(0.3);
  });
  ExpectCompletedAfter(result, "the rollout did not begin: not_started");
}

// Not when the proof is over, 1.6 s later: the arm is under test torques meanwhile.
TEST_F(AwayArm, AStopIsHeardWhileItsTorqueModeIsProved) {
  int64_t asked_ns = 0;
  std::thread person;
  const auto stopped = Run([&](const std::string& note) {
    if (note != "running") return;
    person = time_->Start([&, when = time_->NowNanos() + 300'000'000] {
      time_->SleepUntil(when);
      EXPECT_TRUE(arm_->base->in_torque_mode());
      asked_ns = time_->NowNanos();
      rig_.stop.Cancel();
      while (arm_->base->in_torque_mode()) time_->SleepUntil(time_->NowNanos() + 1'000'000);
      EXPECT_LT(time_->NowNanos() - asked_ns, 200'000'000);
    });
  });
  time_->Join(person);
  EXPECT_EQ(stopped.status().code(), StatusCode::kCancelled);
  EXPECT_THAT(stopped.status().message(), HasSubstr("the rollout did not begin: operator_stop"));
  EXPECT_EQ(begins_, 0);
  EXPECT_FALSE(Latch(rig_.folder).Read().has_value());
  EXPECT_EQ(rig_.spool->Ready(), std::vector<std::string>{"rollout-1+not-begun-1"});
}

TEST_F(AwayArm, AStopOnItsTopicEndsTheProofOfItsTorqueModeAndIsSeenThrough) {
  const auto stopped = Run([&](const std::string& note) {
    if (note == "running") arm_->stop_published = true;
  });
  EXPECT_FALSE(stopped.ok());
  EXPECT_EQ(begins_, 0);
  EXPECT_FALSE(arm_->base->in_torque_mode());
  EXPECT_FALSE(Latch(rig_.folder).Read().has_value());
}

TEST_F(AwayArm, EachTimeIsGivenUpInOneLineAndMayBeAskedForAgain) {
  const auto refused = Run([this](const std::string& note) {
    if (note == "running") GoAwayIn(0.3);
  });
  EXPECT_EQ(refused.status().code(), StatusCode::kUnavailable);
  EXPECT_THAT(refused.status().message(), HasSubstr("the rollout did not begin: not_started ("));
  EXPECT_THAT(refused.status().message(), HasSubstr("(attempt 3 of 3)"));
  EXPECT_EQ(arm_->outages, 3);
  EXPECT_EQ(begins_, 0);
  EXPECT_FALSE(Latch(rig_.folder).Read().has_value());
  EXPECT_FALSE(rig_.spool->Begun("rollout-1").has_value());
  EXPECT_TRUE(rig_.spool->Active().empty());
  const std::vector<std::string> kept = rig_.spool->Ready();
  EXPECT_EQ(kept.size(), 3u) << "a recording with its reason is never removed";
  for (const std::string& name : kept) {
    const auto bundle = rollouts::UnpackBundle(ReadFile(rig_.spool->ReadyPath(name)).value()).value();
    EXPECT_EQ(json::parse(bundle.at("rollout.json"))["end_reason"], "not_started") << name;
  }
  const auto again = Run([](const std::string&) {});
  ASSERT_TRUE(again.ok()) << again.status().ToString();
  EXPECT_EQ(again->reason, EndReason::kCompleted);
  EXPECT_TRUE(rig_.spool->Begun("rollout-1").has_value());
}

TEST_F(AwayArm, OnceTheRolloutHasBegunItIsNotBegunAgain) {
  const auto result = Run([this](const std::string& note) {
    if (note == "running" && arm_->outages == 0) GoAwayIn(1.6 + 0.5);
  });
  ASSERT_TRUE(result.ok()) << result.status().ToString();
  EXPECT_EQ(result->reason, EndReason::kStaleState) << result->detail;
  EXPECT_EQ(begins_, 1);
  EXPECT_EQ(json::parse(result->rollout_json)["stop"]["confirmed"], true);
  const auto again = Run([](const std::string&) {});
  ASSERT_TRUE(again.ok());
  EXPECT_TRUE(again->was_there);
  EXPECT_EQ(begins_, 1);
}

// Its states go on: it was there, and did not do what it was asked.
TEST_F(AwayArm, ARefusalIsNoOutageAndNotTriedAgain) {
  struct Refusal {
    stand_in::LinkFaults faults;
    const char* words;
  };
  const Refusal refusals[] = {{{.failing_torque_modes = 1}, "start pose: torque mode: service failed"},
                              {{.creeps_s = 3.0}, "start pose: position mode is not confirmed: the arm still moves"}};
  for (const Refusal& refusal : refusals) {
    arm_ = std::make_unique<StandInArm>(arm_->config, refusal.faults, 1, time_);
    int ways = 0;
    const auto refused = Run([&](const std::string& note) { ways += note == "to the start pose"; });
    EXPECT_EQ(refused.status().code(), StatusCode::kFailedPrecondition);
    EXPECT_THAT(refused.status().message(), HasSubstr(refusal.words));
    EXPECT_EQ(ways, 1) << refusal.words;
    EXPECT_FALSE(Latch(rig_.folder).Read().has_value());
  }
  EXPECT_EQ(begins_, 0);
}

TEST_F(AwayArm, AJointThatDoesNotAnswerIsNoReasonToTryAgain) {
  auto config = arm_->config;
  config.torque_sign[2] = 0;
  arm_ = std::make_unique<StandInArm>(config, stand_in::LinkFaults{}, 1, time_);
  int ways = 0;
  const auto refused = Run([&](const std::string& note) { ways += note == "to the start pose"; });
  EXPECT_EQ(refused.status().code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.status().message(), HasSubstr("start pose: joint_3 did not move at "));
  EXPECT_EQ(ways, 1);
}

}  // namespace
}  // namespace rg::robot_agent
