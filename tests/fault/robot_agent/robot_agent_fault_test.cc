// Real processes, real time: the simulated robot and the agent's executor are stopped and killed.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <nlohmann/json.hpp>
#include <thread>

#include "common/sim/model_file.h"
#include "robot_agent/board.h"
#include "robot_agent/rollout/rollout_task.h"
#include "robot_agent/safety/latch.h"
#include "robot_agent/spool_delivery.h"
#include "services/rollouts/recording_bundle.h"
#include "tests/unit/robot_agent/rig.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

// A rollout in real time during which `act` is called once after `at` seconds.
RolloutResult RunWith(Rig& rig, SimulatedDriver& driver, double at, const std::function<void()>& act) {
  const RolloutPlan plan = rig.Plan();
  bool done = false;
  auto controller = rig.ToGoal(plan, [&](double t) {
    if (t < at || done) return;
    done = true;
    act();
  });
  return rig.Run(driver, plan, controller).value();
}

TEST(RealTimeRollout, CompletesAndReportsItsJitter) {
  Rig rig(false);
  const auto driver = rig.Driver();
  const RolloutResult result = RunWith(rig, *driver, 9, [] {});
  // On a machine that leaves the loop no processor, missing deadlines is the defined end.
  ASSERT_TRUE(result.reason == EndReason::kCompleted || result.reason == EndReason::kMissedDeadlines)
      << EndReasonName(result.reason) << ": " << result.detail;
  EXPECT_GT(result.jitter.lateness.count(), 5u);
  EXPECT_GT(result.jitter.cycle.max_us(), 0.0);
  EXPECT_FALSE(result.jitter.lock_step);
  RecordProperty("jitter", result.jitter.ToJson());
  std::printf("jitter %s\nstop %s\n", result.jitter.ToJson().c_str(),
              json::parse(result.rollout_json)["stop"].dump().c_str());
}

TEST(RealTimeRollout, ARobotThatStopsAnsweringIsStale) {
  Rig rig(false);
  const auto driver = rig.Driver();
  const RolloutResult result = RunWith(rig, *driver, 0.5, [&] { kill(driver->pid(), SIGSTOP); });
  EXPECT_TRUE(result.reason == EndReason::kStaleState || result.reason == EndReason::kMissedDeadlines)
      << EndReasonName(result.reason);
  EXPECT_GE(result.rows, 5);
  EXPECT_TRUE(rollouts::LoadBundle(result.bundle).ok());
  kill(driver->pid(), SIGCONT);
}

TEST(RealTimeRollout, AKilledRobotIsALostDriverAndTheRecordingIsKept) {
  Rig rig(false);
  const auto driver = rig.Driver();
  const RolloutResult result = RunWith(rig, *driver, 0.5, [&] { kill(driver->pid(), SIGKILL); });
  EXPECT_TRUE(result.reason == EndReason::kDriverLost || result.reason == EndReason::kMissedDeadlines)
      << EndReasonName(result.reason);
  EXPECT_EQ(json::parse(result.rollout_json)["held"], false);
  EXPECT_GE(result.rows, 5);
  EXPECT_EQ(rig.spool->Ready().size(), 1u);
}

TEST(RealTimeRollout, TheOperatorStopsItFromAnotherThread) {
  Rig rig(false);
  const auto driver = rig.Driver();
  std::thread operator_thread([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(1200));
    rig.stop.Cancel();
  });
  rig.spec.duration_s = 20;
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const auto result = rig.Run(*driver, plan, controller);
  operator_thread.join();
  if (!result.ok()) {
    EXPECT_EQ(result.status().code(), StatusCode::kCancelled);  // it was still on the way to its start
  } else {
    EXPECT_TRUE(result->reason == EndReason::kOperatorStop || result->reason == EndReason::kMissedDeadlines);
  }
}

// The executor is killed in the middle of a rollout. Its robot child ends with it, the next agent
// finishes the recording and delivers it; a delivery that fails is repeated, one that is known ends.
TEST(KilledExecutor, LosesAtMostAFractionOfASecondAndTheRecordingIsDelivered) {
  Rig rig(false);
  rig.spool.reset();  // the child opens it
  int ready[2];
  ASSERT_EQ(pipe(ready), 0);
  const pid_t child = fork();
  if (child == 0) {
    rig.spool = Spool::Open(rig.folder).value();
    rig.spec.duration_s = 30;
    const RolloutPlan plan = rig.Plan();
    int ticks = 0;
    auto controller = rig.ToGoal(plan, [&](double) {
      ++ticks;
      if (write(ready[1], &ticks, sizeof ticks) != sizeof ticks) _exit(2);
    });
    (void)rig.Run(*rig.Driver(), plan, controller).ok();
    _exit(3);
  }
  close(ready[1]);
  int ticks = 0;
  while (ticks < 30 && read(ready[0], &ticks, sizeof ticks) == static_cast<ssize_t>(sizeof ticks)) {
  }
  kill(child, SIGKILL);
  while (read(ready[0], &ticks, sizeof ticks) == static_cast<ssize_t>(sizeof ticks)) {
  }
  close(ready[0]);
  int status = 0;
  waitpid(child, &status, 0);
  ASSERT_TRUE(WIFSIGNALED(status)) << "the rollout ended by itself, status " << status;

  const auto away = [](auto&, auto&, auto&) { return UnavailableError("coordinator away"); };
  EXPECT_EQ(DeliverSpool(rig.folder, away).value(), 0);
  std::string delivered, metadata;
  const auto take = [&](const std::string& id, const std::string& bundle, const std::string& about) {
    EXPECT_EQ(id, "rollout-1");
    delivered = bundle;
    metadata = about;
    return Status::Ok();
  };
  EXPECT_EQ(DeliverSpool(rig.folder, take).value(), 1);
  EXPECT_EQ(DeliverSpool(rig.folder, take).value(), 0);
  EXPECT_EQ(json::parse(metadata)["end_reason"], "interrupted");
  const auto set = rollouts::LoadBundle(delivered).value();
  ASSERT_EQ(set.recordings.size(), 1u);
  EXPECT_GE(set.recordings[0].rows(), ticks - 8);  // 20 ms of samples, more on a loaded machine
}

// A robot that outlives everybody, as a real arm does.
class StandingRobot {
 public:
  explicit StandingRobot(const std::string& socket) {
    pid_ = fork();
    if (pid_ != 0) return;
    const std::string program = std::string(std::getenv("RG_BIN_DIR")) + "/realitygrad-simulated-robot";
    const std::string truth = SourceDir() + "/deploy/robots/mico2_truth.json";
    execl(program.c_str(), program.c_str(), "--truth", truth.c_str(), "--socket", socket.c_str(), nullptr);
    _exit(127);
  }
  ~StandingRobot() {
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }

 private:
  pid_t pid_ = -1;
};

// joint_5 swings.
std::string LongSwing(double duration_s = 30.0) {
  std::string csv = "time";
  for (int j = 1; j <= 6; ++j) csv += ",position.joint_" + std::to_string(j);
  for (int k = 0; k <= 25 * duration_s; ++k) {
    csv += "\n" + std::to_string(0.04 * k);
    const double swing = 0.2 * (1 - std::cos(2 * M_PI * 0.04 * k / 3));
    for (const double q : {0.0, 3.141593, 3.141593, 0.0, swing, 0.0}) csv += "," + std::to_string(q);
  }
  return csv + "\n";
}

TEST(RealTimeRollout, ThroughTheGuardItIsOnTimeToo) {
  Rig rig(false);
  rig.spool.reset();
  const auto board = Board::Create(rig.folder).value();
  board->Arm(true);
  board->Beat(RealClock().SteadyNanos() + 3'600'000'000'000);
  RolloutTaskInput input;
  input.model_json = sim::ModelToJson(rig.plant, rig.values);
  input.controller = "trajectory";
  input.motion_csv = LongSwing(3.0);
  input.spec = rig.spec;
  const auto output = RunRolloutTask(rig.config, rig.folder, input, {}, rig.stop);
  ASSERT_TRUE(output.ok()) << output.status().ToString();
  const json rollout = json::parse(output->metadata_json);
  const std::string reason = rollout["end_reason"];
  // On a machine that leaves the loop no processor, being late is the defined end.
  EXPECT_TRUE(reason == "completed" || reason == "missed_deadlines" || reason == "controller_hung") << reason;
  EXPECT_EQ(rollout["driver"], "simulated");
  EXPECT_EQ(rollout["stop"]["confirmed"], true);
  EXPECT_FALSE(Latch(rig.folder).Read().has_value());
  std::printf("jitter with the guard %s\n", rollout["jitter"].dump().c_str());
}

// The executor is killed with the arm under torque: the guard, a process of its own, stops the arm, sees it
// at rest and takes the latch away; the next executor finds the recording and never begins that rollout
// again.
TEST(KilledExecutor, LeavesAGuardThatStopsTheArm) {
  Rig rig(false);
  rig.spool.reset();
  const std::string robot_socket = rig.folder + "/robot.sock";
  const StandingRobot robot(robot_socket);
  json config = json::parse(ReadFile(SourceDir() + "/deploy/robots/mico2_agent.json").value());
  config["simulated"] = {{"socket", robot_socket}};
  config["urdf"] = SourceDir() + "/deploy/robots/mico2.urdf";
  const std::string path = rig.folder + "/agent.json";
  ASSERT_TRUE(WriteFileAtomically(path, config.dump()).ok());
  const AgentConfig agent = LoadAgentConfig(path).value();
  const auto board = Board::Create(rig.folder).value();
  board->Arm(true);
  board->Beat(RealClock().SteadyNanos() + 3'600'000'000'000);
  RolloutTaskInput input;
  input.model_json = sim::ModelToJson(rig.plant, rig.values);
  input.controller = "trajectory";
  input.motion_csv = LongSwing();
  input.spec = rig.spec;
  const auto soon = [](const std::function<bool()>& done) {
    const double give_up = RealClock().SteadySeconds() + 30;
    bool is = false;
    while (!(is = done()) && RealClock().SteadySeconds() < give_up) usleep(5000);
    return is;
  };
  ASSERT_TRUE(soon([&] { return std::filesystem::exists(robot_socket); }));

  const pid_t child = fork();
  if (child == 0) {
    CancelToken stop;
    const auto result = RunRolloutTask(agent, rig.folder, input, {}, stop);
    std::printf("it ended by itself: %s\n",
                result.ok() ? result->summary_json.c_str() : result.status().ToString().c_str());
    std::fflush(stdout);
    _exit(3);
  }
  const bool moved = soon([&] { return board->Read().phase == Phase::kRollout && board->Read().ticks > 20; });
  const bool latched_meanwhile = Latch(rig.folder).Read().has_value();
  kill(child, SIGKILL);
  const double killed = RealClock().SteadySeconds();
  int status = 0;
  waitpid(child, &status, 0);
  ASSERT_TRUE(moved) << "the rollout never began";
  EXPECT_TRUE(latched_meanwhile);
  EXPECT_TRUE(soon([&] { return !Latch(rig.folder).Read().has_value(); })) << "nobody stopped the arm";
  std::printf("seen at rest %.2f s after the kill\n", RealClock().SteadySeconds() - killed);
  SimulatedDriverOptions options;
  options.socket_path = robot_socket;
  SimulatedDriver look(options);
  ASSERT_TRUE(soon([&] { return look.Connect(1).ok(); })) << "the guard still holds the arm";
  RobotState state;
  ASSERT_TRUE(look.ReadState(&state).ok());
  EXPECT_EQ(state.mode, Mode::kPosition);
  const auto again = RunRolloutTask(agent, rig.folder, input, {}, rig.stop);
  ASSERT_TRUE(again.ok()) << again.status().ToString();
  EXPECT_EQ(json::parse(again->metadata_json)["end_reason"], "interrupted");
}

}  // namespace
}  // namespace rg::robot_agent
