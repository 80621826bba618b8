// The driver `kinova` and the stand-in's arm without ROS, in a time of their own: the sequence, what each
// countermeasure is there for, and what a session keeps. tests/integration/kinova has the same through real topics.
#include "robot_agent/drivers/kinova/kinova_driver.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "tests/support/robot_agent/stand_in_link.h"
#include "tests/support/robot_agent/virtual_time.h"

namespace rg::robot_agent::kinova {
namespace {

using stand_in::LinkFaults;
using stand_in::StandInArm;
using stand_in::StandInConfig;
using testing::HasSubstr;

constexpr double kStart[6] = {0.0, kPi, kPi, 0.0, 0.0, 0.0};
constexpr double kZero[6] = {};
constexpr double kTolerance = 0.06;

StandInConfig Quirks() {
  const std::string source = std::getenv("RG_SOURCE_DIR");
  return stand_in::LoadStandInConfig(source + "/deploy/robots/mico2_stand_in.json").value();
}
StandInConfig Mild() {
  StandInConfig config = Quirks();
  config.refuse_torque_mode = 0;
  config.turns.assign(6, 0);
  return config;
}

class SimulatedSession : public testing::Test {
 protected:
  SimulatedSession()
      : folder_((std::filesystem::temp_directory_path() / ("rg-session-" + RandomHex(6))).string()) {
    std::filesystem::create_directories(folder_);
    options_ = ParseKinovaOptions("{}", "mico2").value();
    options_.session_path = folder_ + "/" + kSessionFile;
  }
  ~SimulatedSession() override { std::filesystem::remove_all(folder_); }

  void Place(const StandInConfig& config, const LinkFaults& faults = {}) {
    arm_ = std::make_unique<StandInArm>(config, faults, 1, time_);
  }
  std::unique_ptr<KinovaDriver> Connected() {
    auto driver = std::make_unique<KinovaDriver>(options_, LinkTo(*arm_), time_);
    const Status connected = driver->Connect(5.0);
    EXPECT_TRUE(connected.ok()) << connected.ToString();
    return driver;
  }
  Status Prepared(KinovaDriver& driver) { return driver.MoveToPose(kStart, kTolerance, 30.0); }
  double Now() const { return 1e-9 * static_cast<double>(time_->NowNanos()); }
  // Sends `torque` on `joint` at 25 Hz until `done` says so or for `seconds`.
  void Drive(KinovaDriver& driver, int joint, double torque, double seconds,
             const std::function<bool(const RobotState&)>& done) {
    const int64_t start = driver.NowNanos();
    for (int tick = 1; tick <= 25 * seconds; ++tick) {
      RobotState state;
      if (driver.ReadState(&state).ok() && done(state)) return;
      JointArray tau{};
      tau[joint] = torque;
      if (!driver.SendTorque(tau.data()).ok()) return;
      if (!driver.SleepUntil(start + tick * 40'000'000).ok()) return;
    }
  }

  std::string folder_;
  KinovaOptions options_;
  const std::shared_ptr<VirtualTime> time_ = std::make_shared<VirtualTime>();
  std::unique_ptr<StandInArm> arm_;
};

TEST_F(SimulatedSession, GoesThroughTheWholeSequenceWithEveryQuirk) {
  Place(Quirks());
  const auto driver = Connected();
  RobotState state;
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_NEAR(state.q[0], 0.30, 0.02);
  const Status prepared = Prepared(*driver);
  ASSERT_TRUE(prepared.ok()) << prepared.ToString();
  for (int i = 0; i < 6; ++i) EXPECT_GT(driver->responses()[i].torque_nm, 0.05) << i;
  const Status entered = driver->EnterTorqueMode(kZero);
  ASSERT_TRUE(entered.ok()) << entered.ToString();
  ASSERT_TRUE(driver->ReadState(&state).ok());
  const double before = state.q[5], began = Now();
  const int torques = arm_->torques;
  Drive(*driver, 5, 1.5, 5.0, [&](const RobotState& s) { return s.q[5] > before + 0.3; });
  // A command every 40 ms is sent at 100 Hz, and reaches an arm that listens for a third of the time twice.
  EXPECT_GT((arm_->torques - torques) / (Now() - began), 40.0);
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_GT(state.q[5], before + 0.3);
  EXPECT_EQ(state.mode, Mode::kTorque);
  EXPECT_TRUE(driver->Hold().ok());
  EXPECT_FALSE(arm_->base->in_torque_mode());
}

TEST_F(SimulatedSession, ATorqueModeRefusedInSilenceIsFoundOut) {
  StandInConfig config = Mild();
  config.refuse_torque_mode = -1;
  Place(config);
  options_.torque_mode_attempts = 1;
  const auto driver = Connected();
  const Status refused = Prepared(*driver);
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.message(), HasSubstr("refused torque mode in silence"));
  EXPECT_THAT(refused.message(), HasSubstr("joint_1 at 2.00 N·m"));
}

TEST_F(SimulatedSession, AWrongSignIsRefusedByItsJoint) {
  StandInConfig config = Mild();
  config.torque_sign = {1, 1, -1, 1, 1, 1};
  Place(config);
  const auto driver = Connected();
  EXPECT_THAT(Prepared(*driver).message(), HasSubstr("joint_3 moved against its torque"));
  EXPECT_FALSE(arm_->base->in_torque_mode());
}

TEST_F(SimulatedSession, AJointThatDoesNotMoveIsRefusedWithTheTorqueReached) {
  StandInConfig config = Mild();
  config.torque_sign = {1, 1, 1, 1, 0, 1};
  Place(config);
  const auto driver = Connected();
  EXPECT_THAT(Prepared(*driver).message(), HasSubstr("joint_5 did not move at 1.00 N·m above gravity"));
}

TEST_F(SimulatedSession, SensorsThatDoNotReadZeroAfterZeroingAreNamed) {
  Place(Mild());
  options_.zero_limit_nm = 0.01;  // below the sensors' noise
  const auto driver = Connected();
  const Status refused = Prepared(*driver);
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.message(), HasSubstr("the torque sensor of joint_"));
  EXPECT_THAT(refused.message(), HasSubstr("after zeroing"));
}

TEST_F(SimulatedSession, AFallBackToPositionModeIsSeenThoughTheArmSaysNothing) {
  Place(Mild());
  const auto driver = Connected();
  ASSERT_TRUE(Prepared(*driver).ok());
  ASSERT_TRUE(driver->EnterTorqueMode(kZero).ok());
  arm_->fall_back_wanted = true;
  Drive(*driver, 5, 2.0, 10.0, [](const RobotState& s) { return s.mode == Mode::kPosition; });
  RobotState state;
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_EQ(state.mode, Mode::kPosition);
  EXPECT_THAT(driver->health().last_error, HasSubstr("left torque mode"));
}

TEST_F(SimulatedSession, ACallerThatFallsSilentLeavesTheArmInPositionMode) {
  Place(Mild());
  const auto driver = Connected();
  ASSERT_TRUE(Prepared(*driver).ok());
  const double strong[6] = {0, 0, 0, 0, 0, 1.5};
  ASSERT_TRUE(driver->EnterTorqueMode(kZero).ok());
  ASSERT_TRUE(driver->SendTorque(strong).ok());
  const double began = Now();
  while (arm_->base->in_torque_mode() && Now() < began + 5.0) time_->SleepUntil(time_->NowNanos() + 10'000'000);
  EXPECT_LT(Now() - began, options_.command_timeout_s + 0.5 + 0.3);
  EXPECT_THAT(driver->health().last_error, HasSubstr("no command for too long"));
  EXPECT_EQ(driver->SendTorque(strong).code(), StatusCode::kFailedPrecondition);
}

TEST_F(SimulatedSession, AMoveIsSeenOnItsWayAndEndedByHold) {
  Place(Mild());
  const auto driver = Connected();
  RobotState first, state;
  ASSERT_TRUE(driver->ReadState(&first).ok());
  ASSERT_TRUE(driver->StartMove(kStart).ok());
  for (int i = 0; i < 1000 && std::abs(state.q[0] - first.q[0]) < 0.03; ++i) {
    ASSERT_TRUE(driver->SleepUntil(driver->NowNanos() + 10'000'000).ok());
    ASSERT_TRUE(driver->ReadState(&state).ok());
    EXPECT_TRUE(state.moving);
  }
  const Status held = driver->Hold();
  EXPECT_TRUE(held.ok()) << held.ToString();
  ASSERT_TRUE(driver->ReadState(&first).ok());
  ASSERT_TRUE(driver->SleepUntil(driver->NowNanos() + 1'000'000'000).ok());
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_FALSE(state.moving);
  EXPECT_NEAR(state.q[0], first.q[0], 0.01);
  EXPECT_GT(std::abs(state.q[0] - kStart[0]), 0.05) << "it was stopped on its way";
}

// ---- what a session keeps ----

class KeptSession : public SimulatedSession {
 protected:
  struct Preparation {
    double took_s = 0.0, torque_mode_s = 0.0;
    int zeroed = 0;
  };
  Preparation Prepare() {
    const auto driver = Connected();
    const Preparation before{Now(), arm_->torque_mode_s, arm_->zeroed};
    const Status prepared = Prepared(*driver);
    EXPECT_TRUE(prepared.ok()) << prepared.ToString();
    EXPECT_GT(driver->responses()[5].torque_nm, 0.05);
    EXPECT_FALSE(arm_->base->in_torque_mode());
    return {Now() - before.took_s, arm_->torque_mode_s - before.torque_mode_s, arm_->zeroed - before.zeroed};
  }
};

TEST_F(KeptSession, TorquesAreTestedOncePerSession) {
  Place(Mild());
  const Preparation first = Prepare(), second = Prepare();
  EXPECT_GT(first.torque_mode_s, 3.0);
  EXPECT_EQ(first.zeroed, 1);
  EXPECT_EQ(second.torque_mode_s, 0.0);
  EXPECT_EQ(second.zeroed, 0);
  EXPECT_LT(second.took_s, 0.5 * first.took_s);
  std::printf("preparation: first %.1f s, next %.1f s\n", first.took_s, second.took_s);
}

TEST_F(KeptSession, EachWayOutOfItLeadsToTheWholePreparation) {
  Place(Mild());
  Prepare();
  options_.prepare_every_s = 0.0;
  EXPECT_GT(Prepare().torque_mode_s, 3.0) << "too old";
  options_.prepare_every_s = 1800.0;
  ++arm_->run;
  EXPECT_GT(Prepare().torque_mode_s, 3.0) << "the arm's driver was started again";
  SessionFile(options_.session_path).Forget();
  EXPECT_GT(Prepare().torque_mode_s, 3.0) << "a person armed it";
  options_.session_path.clear();
  EXPECT_GT(Prepare().torque_mode_s, 3.0) << "nothing is kept";
}

TEST_F(KeptSession, SensorsThatAreOffAreZeroedAgain) {
  StandInConfig config = Mild();
  Place(config);
  Prepare();
  config.sensor_offset_nm = {0, 0, 3, 0, 0, 0};  // its sensors have drifted
  Place(config);
  arm_->number = 100'000;
  const Preparation again = Prepare();
  EXPECT_EQ(again.zeroed, 1);
  EXPECT_GT(again.torque_mode_s, 3.0);
}

TEST_F(KeptSession, AnOutageAndARefusalEndIt) {
  StandInConfig config = Mild();
  Place(config);
  Prepare();
  EXPECT_TRUE(SessionFile(options_.session_path).Read().has_value());
  {
    const auto driver = Connected();
    arm_->outage_wanted = true;
    while (driver->health().connected) time_->SleepUntil(time_->NowNanos() + 10'000'000);
    EXPECT_FALSE(SessionFile(options_.session_path).Read().has_value());
  }
  Prepare();
  config.refuse_torque_mode = -1;
  config.sensor_offset_nm.assign(6, 0.0);
  Place(config);
  arm_->number = 100'000;
  options_.torque_mode_attempts = 1;
  const auto driver = Connected();
  EXPECT_TRUE(Prepared(*driver).ok());
  EXPECT_FALSE(driver->EnterTorqueMode(kZero).ok());
  EXPECT_FALSE(SessionFile(options_.session_path).Read().has_value());
}

TEST(ArmSession, IsOfThisBootAndWhole) {
  const std::string path =
      (std::filesystem::temp_directory_path() / ("rg-session-" + RandomHex(6) + ".json")).string();
  const SessionFile file(path);
  EXPECT_FALSE(file.Read().has_value());
  ASSERT_TRUE(file.Write({.prepared_ns = 5, .arm = "a", .number = 7, .responses = {{1.5, 0.01}}}).ok());
  ASSERT_TRUE(file.Read().has_value());
  EXPECT_EQ(file.Read()->responses[0].torque_nm, 1.5);
  std::string text = ReadFile(path).value();
  const size_t at = text.find("\"boot\":\"") + 8;
  text[at] = text[at] == '0' ? '1' : '0';
  ASSERT_TRUE(WriteFileAtomically(path, text).ok());
  EXPECT_FALSE(file.Read().has_value()) << "another boot's clock";
  ASSERT_TRUE(WriteFileAtomically(path, "{\"format\":").ok());
  EXPECT_FALSE(file.Read().has_value());
  file.Forget();
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST(ArmSession, HoldsForItsArmItsRunAndItsTime) {
  const ArmSession session{.prepared_ns = 10'000'000'000, .arm = "a", .number = 100, .responses = {}};
  EXPECT_TRUE(Holds(session, "a", 100, 20'000'000'000, 10.0));
  EXPECT_FALSE(Holds(session, "b", 100, 20'000'000'000, 10.0));
  EXPECT_FALSE(Holds(session, "a", 99, 20'000'000'000, 10.0)) << "its driver counts from zero again";
  EXPECT_FALSE(Holds(session, "a", 100, 20'000'000'001, 10.0));
  EXPECT_FALSE(Holds(session, "a", 100, 9'000'000'000, 10.0));
}

}  // namespace
}  // namespace rg::robot_agent::kinova
