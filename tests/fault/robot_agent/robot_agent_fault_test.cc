// Real processes, real time: the simulated robot and the agent's executor are stopped and killed.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <nlohmann/json.hpp>
#include <thread>

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
  std::printf("jitter %s\n", result.jitter.ToJson().c_str());
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

}  // namespace
}  // namespace rg::robot_agent
