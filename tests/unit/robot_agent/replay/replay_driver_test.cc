#include "robot_agent/drivers/replay/replay_driver.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/recordings/recording_set.h"
#include "robot_agent/agent_config.h"

namespace rg::robot_agent {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

// A pendulum's set of two recordings at 20 Hz; `second` starts at 1 rad.
class Replay : public testing::Test {
 protected:
  Replay() : folder_(std::filesystem::temp_directory_path() / ("rg-replay-" + RandomHex(6))) {
    std::filesystem::create_directories(folder_);
    recordings::RecordingSet set;
    set.urdf_text =
        ReadFile(std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/pendulum.urdf").value();
    set.joints = {"hinge"};
    set.effort_excludes_gravity = true;
    for (const double start : {0.0, 1.0}) {
      recordings::Recording recording;
      recording.name = start == 0.0 ? "first.csv" : "second.csv";
      recording.joints = set.joints;
      recording.t = Eigen::VectorXd::LinSpaced(kRows, 5.0, 5.0 + 0.05 * (kRows - 1));
      recording.q = start + 0.01 * Eigen::RowVectorXd::LinSpaced(kRows, 0, kRows - 1).array();
      recording.v = Eigen::RowVectorXd::Constant(kRows, 0.2);
      recording.effort_command = Eigen::RowVectorXd::Constant(kRows, 0.7);
      set.recordings.push_back(recording);
    }
    EXPECT_TRUE(recordings::WriteSet(folder_, set).ok());
  }
  ~Replay() override { std::filesystem::remove_all(folder_); }
  ReplayOptions Options(const std::string& recording = "") const {
    return {.robot = "p", .folder = folder_, .recording = recording, .lock_step = true};
  }

  static constexpr int kRows = 40;
  const std::string folder_;
};

TEST_F(Replay, PlaysRowByRowFromTorqueModeOnWhateverIsCommanded) {
  ReplayDriver driver(Options());
  ASSERT_TRUE(driver.Connect(1.0).ok());
  EXPECT_THAT(driver.info().joints, ElementsAre("hinge"));
  EXPECT_TRUE(driver.info().adds_gravity_compensation);
  EXPECT_NEAR(driver.info().state_rate_hz, 20.0, 1e-6);
  const double start = 0.0, torque = 3.0;
  ASSERT_TRUE(driver.MoveToPose(&start, 0.01, 1.0).ok());
  ASSERT_TRUE(driver.SleepUntil(2'000'000'000).ok());
  RobotState state;
  ASSERT_TRUE(driver.ReadState(&state).ok());
  EXPECT_EQ(state.q[0], 0.0);
  EXPECT_EQ(state.v[0], 0.0);
  EXPECT_EQ(state.stamp_ns, 2'000'000'000);

  ASSERT_TRUE(driver.EnterTorqueMode(&torque).ok());
  ASSERT_TRUE(driver.ReadState(&state).ok());
  uint64_t known = state.sequence;
  for (int64_t tick = 1; tick < 30; ++tick) {
    ASSERT_TRUE(driver.SleepUntil(2'000'000'000 + tick * 50'000'000 + 7'000'000).ok());
    ASSERT_TRUE(driver.ReadState(&state).ok());
    EXPECT_NEAR(state.q[0], 0.01 * static_cast<double>(tick), 1e-9);
    EXPECT_NEAR(static_cast<double>(state.stamp_ns), 2e9 + 5e7 * static_cast<double>(tick), 10.0);
    EXPECT_EQ(state.sequence, ++known);
    EXPECT_EQ(state.v[0], 0.2);
    EXPECT_EQ(state.effort[0], 0.7);
    EXPECT_TRUE(driver.SendTorque(&torque).ok());
  }
  EXPECT_EQ(driver.health().commands_sent, 29u);
}

TEST_F(Replay, IsSilentAfterItsLastRowAndStandsWhereItWas) {
  ReplayDriver driver(Options());
  ASSERT_TRUE(driver.Connect(1.0).ok());
  const double torque = 0.0;
  ASSERT_TRUE(driver.EnterTorqueMode(&torque).ok());
  RobotState end, later;
  ASSERT_TRUE(driver.SleepUntil(3'000'000'000).ok());
  ASSERT_TRUE(driver.ReadState(&end).ok());
  ASSERT_TRUE(driver.SleepUntil(4'000'000'000).ok());
  ASSERT_TRUE(driver.ReadState(&later).ok());
  EXPECT_EQ(later.sequence, end.sequence);
  EXPECT_EQ(later.stamp_ns, end.stamp_ns);
  ASSERT_TRUE(driver.Hold().ok());
  ASSERT_TRUE(driver.ReadState(&later).ok());
  EXPECT_EQ(later.mode, Mode::kPosition);
  EXPECT_NEAR(later.q[0], 0.01 * (kRows - 1), 1e-9);
  EXPECT_GT(later.stamp_ns, end.stamp_ns);
}

TEST_F(Replay, RefusesAnotherStartAndAnUnknownRecording) {
  ReplayDriver second(Options("second.csv"));
  ASSERT_TRUE(second.Connect(1.0).ok());
  const double start = 0.0;
  const Status refused = second.MoveToPose(&start, 0.1, 1.0);
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.message(), HasSubstr("second.csv begins with hinge at 1.0"));
  const Status unknown = ReplayDriver(Options("third.csv")).Connect(1.0);
  EXPECT_EQ(unknown.code(), StatusCode::kNotFound);
  EXPECT_THAT(unknown.message(), HasSubstr("first.csv second.csv"));
  RobotState state;
  EXPECT_EQ(ReplayDriver(Options()).ReadState(&state).code(), StatusCode::kUnavailable);
}

TEST_F(Replay, IsADriverOfTheAgentsConfiguration) {
  const auto config = ParseAgentConfig(R"({"format": "realitygrad.agent/1", "name": "p", "driver": "replay",
      "start_pose": [1.0], "urdf": "robot.urdf", "limits": {"lower": [-3], "upper": [3], "velocity": [5],
      "torque": [5], "torque_rate": [500], "task_box": null},
      "replay": {"set": ".", "recording": "second.csv", "lock_step": true}})",
                                       folder_, "agent.json");
  ASSERT_TRUE(config.ok()) << config.status().ToString();
  const auto driver = MakeDriver(*config, 1).value();
  ASSERT_TRUE(driver->Connect(1.0).ok());
  EXPECT_EQ(driver->info().driver, "replay");
  EXPECT_EQ(driver->info().robot, "p");
  EXPECT_TRUE(driver->MoveToPose(config->start_pose.data(), 0.01, 1.0).ok());
}

}  // namespace
}  // namespace rg::robot_agent
