// The driver `kinova` against a real ROS master and the stand-in: the whole sequence, and what only real topics
// and services show. The rest of its countermeasures is in tests/unit/robot_agent/kinova, without waiting.
#include <gmock/gmock.h>

#include <chrono>
#include <thread>

#include "robot_agent/drivers/kinova/kinova_driver.h"
#include "robot_agent/drivers/kinova/ros_arm_link.h"
#include "tests/integration/kinova/ros_rig.h"

namespace rg::robot_agent::kinova {
namespace {

using nlohmann::json;
using testing::HasSubstr;

constexpr double kStart[6] = {0.0, kPi, kPi, 0.0, 0.0, 0.0};
constexpr double kTolerance = 0.06;

void Mild(json& config) {
  config["refuse_torque_mode"] = 0;
  config["turns"] = {0, 0, 0, 0, 0, 0};
}

// Times are wide: the machine may be busy with other tests, and none of them is about speed.
KinovaOptions Options(const json& fields = json::object()) {
  json all = {{"least_rate_hz", 14}, {"command_timeout_s", 0.25}};
  all.update(fields);
  KinovaOptions options = ParseKinovaOptions(all.dump(), "mico2").value();
  if (!fields.contains("service_timeout_s")) options.service_timeout_s = 10;  // more than a configuration may say
  return options;
}

std::unique_ptr<KinovaDriver> MakeDriver(const KinovaOptions& options) {
  return std::make_unique<KinovaDriver>(options, MakeRosArmLink(options));
}

// Sends `torque` on `joint` at 25 Hz until `done` says so; how long that took, s, at most 10.
double Drive(KinovaDriver& driver, int joint, double torque,
             const std::function<bool(const RobotState&)>& done) {
  const int64_t start = driver.NowNanos();
  for (int tick = 1; tick <= 250; ++tick) {
    RobotState state;
    if (driver.ReadState(&state).ok() && done(state)) break;
    JointArray tau{};
    tau[joint] = torque;
    if (!driver.SendTorque(tau.data()).ok()) break;
    if (!driver.SleepUntil(start + tick * 40'000'000).ok()) break;
  }
  return 1e-9 * static_cast<double>(driver.NowNanos() - start);
}

class KinovaArm : public RosTest {
 protected:
  static std::string StandInSaid() { return ReadFile(*folder_ + "/stand_in.log").value(); }
  // The line of the last change of mode.
  static std::string LastMode() {
    const std::string said = StandInSaid();
    const size_t at = said.rfind("stand-in: ", said.rfind(", asked for "));
    return said.substr(at, said.find('\n', at) - at);
  }
  // How often torque mode was entered.
  static int TorqueModes() {
    const std::string said = StandInSaid(), line = "stand-in: torque mode, asked for torque";
    int count = 0;
    for (size_t at = said.find(line); at != std::string::npos; at = said.find(line, at + 1)) ++count;
    return count;
  }
  // Torques per second that the stand-in took in its last torque mode.
  static double TorqueRate() {
    int torques = 0;
    double seconds = 0.0;
    const std::string line = LastMode();
    const size_t at = line.find("after ");
    std::sscanf(line.c_str() + std::min(at, line.size()), "after %d torques in %lf s", &torques, &seconds);
    return seconds > 0 ? torques / seconds : 0.0;
  }
};

TEST_F(KinovaArm, GoesThroughTheWholeSequenceWithEveryQuirkOfTheStandIn) {
  const Child arm = StartStandIn([](json&) {});  // unzeroed sensors, turns, one refusal
  KinovaOptions options = Options();
  options.session_path = *folder_ + "/" + kSessionFile;
  auto driver = MakeDriver(options);
  const Status connected = driver->Connect(20.0);
  ASSERT_TRUE(connected.ok()) << connected.ToString();
  EXPECT_TRUE(driver->info().adds_gravity_compensation);
  EXPECT_EQ(driver->info().joints[5], "joint_6");
  RobotState state;
  ASSERT_TRUE(driver->ReadState(&state).ok());
  // The arm says 377° and -354°: one turn on, one back.
  EXPECT_NEAR(state.q[0], 0.30, 0.02);
  EXPECT_NEAR(state.q[3], 0.10, 0.02);
  EXPECT_GT(std::abs(state.effort[0]), 2.0) << "the stand-in's sensors are not zeroed yet";

  const Status moved = driver->MoveToPose(kStart, kTolerance, 30.0);
  ASSERT_TRUE(moved.ok()) << moved.ToString();
  ASSERT_TRUE(driver->ReadState(&state).ok());
  for (int i = 0; i < 6; ++i) {
    EXPECT_NEAR(state.q[i], kStart[i], kTolerance) << i;
    EXPECT_LT(std::abs(state.effort[i]), 1.0) << "sensor " << i << " was not zeroed";
    EXPECT_GT(driver->responses()[i].torque_nm, 0.05) << i;
  }
  EXPECT_EQ(state.mode, Mode::kPosition);

  const double zero[6] = {};
  const Status entered = driver->EnterTorqueMode(zero);
  ASSERT_TRUE(entered.ok()) << entered.ToString();
  const double before = state.q[5];
  Drive(*driver, 5, 1.5, [&](const RobotState& s) { return s.q[5] > before + 0.3; });
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_GT(state.q[5], before + 0.3);
  EXPECT_EQ(state.mode, Mode::kTorque);
  EXPECT_LE(state.stamp_ns, driver->NowNanos());

  EXPECT_TRUE(driver->Hold().ok());
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_EQ(state.mode, Mode::kPosition);
  EXPECT_FALSE(driver->SendTorque(zero).ok());
  const int modes = TorqueModes();
  // How often a command is sent again is seen in a time of its own (kinova_driver_test): here the machine may be busy.
  EXPECT_GT(TorqueRate(), 0.0) << StandInSaid();

  // The next rollout's driver finds the same arm prepared.
  driver = MakeDriver(options);
  ASSERT_TRUE(driver->Connect(20.0).ok());
  const Status again = driver->MoveToPose(kStart, kTolerance, 30.0);
  EXPECT_TRUE(again.ok()) << again.ToString();
  EXPECT_GT(driver->responses()[5].torque_nm, 0.05);
  EXPECT_THAT(LastMode(), HasSubstr("stand-in: position mode, asked for position mode")) << StandInSaid();
  EXPECT_EQ(TorqueModes(), modes) << "torques were tested again";
}

TEST_F(KinovaArm, StatesTooRareAreRefusedWithTheParameterToSet) {
  const Child arm = StartStandIn(Mild, 0.1);
  const auto driver = MakeDriver(Options({{"least_rate_hz", 20}}));
  const Status refused = driver->Connect(20.0);
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.message(), HasSubstr("feedback_publish_rate:=0.04"));
  EXPECT_THAT(refused.message(), HasSubstr("status_interval_seconds is 0.1"));
}

TEST_F(KinovaArm, AnOutageEndsTorqueModeTheDriverComesBackAndNeverLeavesTheArmFloating) {
  const Child arm = StartStandIn(Mild);
  auto driver = MakeDriver(Options());
  ASSERT_TRUE(driver->Connect(20.0).ok());
  ASSERT_TRUE(driver->MoveToPose(kStart, kTolerance, 30.0).ok());
  const double zero[6] = {};
  ASSERT_TRUE(driver->EnterTorqueMode(zero).ok());
  arm.Signal(SIGUSR1);
  const double took = Drive(*driver, 0, 0.0, [](const RobotState&) { return false; });
  EXPECT_LT(took, 9.0) << "the loss was never told";
  EXPECT_EQ(driver->SendTorque(zero).code(), StatusCode::kUnavailable);
  EXPECT_EQ(driver->Hold().code(), StatusCode::kUnavailable);
  EXPECT_FALSE(driver->health().connected);

  for (int i = 0; i < 1000 && !driver->health().connected; ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  RobotState state;
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_EQ(state.mode, Mode::kPosition);
  EXPECT_EQ(driver->EnterTorqueMode(zero).code(), StatusCode::kFailedPrecondition) << "not prepared again";
  const Status moved = driver->MoveToPose(kStart, kTolerance, 30.0);
  ASSERT_TRUE(moved.ok()) << moved.ToString();

  ASSERT_TRUE(driver->EnterTorqueMode(zero).ok());
  EXPECT_THAT(LastMode(), HasSubstr("stand-in: torque mode"));
  arm.Signal(SIGUSR1);  // away again when the rollout ends: its services are gone for more than a second
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  driver.reset();
  EXPECT_THAT(LastMode(), HasSubstr("stand-in: position mode"));
}

TEST_F(KinovaArm, AServiceThatHangsDoesNotHoldTheCaller) {
  const Child arm = StartStandIn(Mild);
  const auto driver = MakeDriver(Options({{"service_timeout_s", 0.5}, {"outage_s", 5.0}}));
  ASSERT_TRUE(driver->Connect(20.0).ok());
  arm.Signal(SIGSTOP);
  const Status held = driver->Hold();
  arm.Signal(SIGCONT);
  EXPECT_EQ(held.code(), StatusCode::kUnavailable);
  EXPECT_THAT(held.message(), HasSubstr("did not answer within"));
}

TEST_F(KinovaArm, AnotherModelOfTheFamilyIsFoundByItsPrefix) {
  const Child arm = StartStandIn([](json& config) {
    Mild(config);
    config["robot_type"] = "j2n6s300";
    config["robot_name"] = "left";
  });
  const auto driver = MakeDriver(Options({{"robot_type", "j2n6s300"},
                                          {"robot_name", "left"},
                                          {"joints", {"a", "b", "c", "d", "e", "f"}},
                                          {"zero_pose_deg", {0, 180, 180, 0, 0, 0}},
                                          {"test_torque_nm", {4, 8, 4, 2, 2, 2}}}));
  const Status connected = driver->Connect(20.0);
  ASSERT_TRUE(connected.ok()) << connected.ToString();
  EXPECT_EQ(driver->info().joints[5], "f");
  RobotState state;
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_NEAR(state.q[1], 3.0, 0.02);
  EXPECT_THAT(StandInSaid(), HasSubstr("/left_driver"));
}

TEST_F(KinovaArm, AnArmThatIsNotThereIsNamed) {
  const auto driver = MakeDriver(Options({{"robot_name", "nobody"}}));
  const Status lost = driver->Connect(0.3);
  EXPECT_EQ(lost.code(), StatusCode::kUnavailable);
  EXPECT_THAT(lost.message(), HasSubstr("/nobody_driver/out/joint_state"));
  EXPECT_THAT(lost.message(), HasSubstr("kinova_robotName:=nobody"));
}

TEST_F(KinovaArm, AStopOnItsTopicIsHeard) {
  const Child arm = StartStandIn(Mild);
  const auto driver = MakeDriver(Options());
  ASSERT_TRUE(driver->Connect(20.0).ok());
  EXPECT_FALSE(driver->StopWanted());
  for (int i = 0; i < 1200 && !driver->StopWanted(); ++i) {
    if (i % 20 == 0) arm.Signal(SIGHUP);  // what is published before it is subscribed to is lost
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  EXPECT_TRUE(driver->StopWanted());
  EXPECT_EQ(driver->MoveToPose(kStart, kTolerance, 30.0).code(), StatusCode::kCancelled);
  EXPECT_TRUE(driver->Hold().ok()) << "the stop itself is not stopped";
}

// A stop must not wait for an action server that is away, nor may the arm set out when it is back.
TEST_F(KinovaArm, AWayToAPoseThatNobodyOffersEndsWithTheStop) {
  const auto link = MakeRosArmLink(Options());
  ASSERT_TRUE(link->Open([](const Result<JointReport>&) {}).ok());
  std::atomic<bool> stop = false;
  std::thread person([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
    stop = true;
    link->CancelMove();
  });
  const auto before = std::chrono::steady_clock::now();
  const Status moved = link->MoveTo(std::vector<Degrees>(6), 600.0, stop);
  person.join();
  EXPECT_EQ(moved.code(), StatusCode::kAborted) << moved.ToString();
  EXPECT_LT(std::chrono::steady_clock::now() - before, std::chrono::seconds(60));
}

// In a process of its own: this one has its master already.
TEST(KinovaArmDeathTest, WithoutAMasterConnectFailsAtOnce) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        const auto driver = MakeDriver(Options({{"master", "http://127.0.0.1:9"}}));
        const Status status = driver->Connect(600.0);
        std::fprintf(stderr, "%s", status.message().c_str());
        std::_Exit(status.code() == StatusCode::kUnavailable ? 0 : 1);
      },
      testing::ExitedWithCode(0), "no ROS master at http://127.0.0.1:9");
}

}  // namespace
}  // namespace rg::robot_agent::kinova
