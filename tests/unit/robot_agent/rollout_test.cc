// Whole rollouts against the simulated robot in its own process, in lock-step.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <nlohmann/json.hpp>
#include <stop_token>
#include <thread>

#include "common/base/hash.h"
#include "common/recordings/csv.h"
#include "common/sim/model_file.h"
#include "robot_agent/board.h"
#include "robot_agent/rollout/rollout_task.h"
#include "robot_agent/safety/latch.h"
#include "robot_agent/safety/own_arm.h"
#include "robot_agent/safety/watched_move.h"
#include "robot_agent/spool_delivery.h"
#include "services/policy/policy.h"
#include "services/rollouts/recording_bundle.h"
#include "tests/unit/robot_agent/rig.h"

namespace rg::robot_agent {
namespace {

using testing::HasSubstr;

TEST(Rollout, ReachesTheGoalAndLeavesARecordingSet) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const auto driver = rig.Driver();
  const RolloutResult result = rig.Run(*driver, plan, controller).value();
  EXPECT_EQ(result.reason, EndReason::kCompleted) << result.detail;
  EXPECT_EQ(result.rows, 51);
  EXPECT_LT(result.goal_error.joint_norm, 0.5 * result.goal_error.start_norm);
  const recordings::RecordingSet set = rollouts::LoadBundle(result.bundle).value();
  ASSERT_EQ(set.recordings.size(), 1u);
  EXPECT_EQ(set.joints, rig.plant.joint_names());
  EXPECT_NEAR(set.recordings[0].SamplePeriod(), 0.04, 1e-9);
  EXPECT_TRUE(set.recordings[0].has_velocity());
  EXPECT_TRUE(set.recordings[0].has_effort_command());
  EXPECT_EQ(set.control_rate_hz, 25.0);
  EXPECT_EQ(set.noise.position_stddev, 3e-4);
  EXPECT_FALSE(set.effort_excludes_gravity);
  const auto rollout = nlohmann::json::parse(result.rollout_json);
  EXPECT_EQ(rollout["end_reason"], "completed");
  EXPECT_EQ(rollout["held"], true);
  EXPECT_EQ(rollout["jitter"]["missed_deadlines"], 0);
}

TEST(Rollout, TheFirstOnesAreShorterSlowerAndNearer) {
  Rig rig(true);
  rig.config.first_rollouts = {.duration_s = 1.0, .speed = 0.4};
  const RolloutPlan full = PlanRollout(rig.spec, rig.config, rig.plant).value();
  const RolloutPlan first = PlanRollout(rig.spec, rig.config, rig.plant, 0.0).value();
  const RolloutPlan later = PlanRollout(rig.spec, rig.config, rig.plant, 0.5).value();
  EXPECT_EQ(full.spec.duration_s, 2.0);
  EXPECT_EQ(first.spec.duration_s, 1.0);
  EXPECT_EQ(later.spec.duration_s, 1.5);
  for (int i = 0; i < 6; ++i) {
    EXPECT_DOUBLE_EQ(first.limits.velocity[i], 0.4 * full.limits.velocity[i]);
    EXPECT_DOUBLE_EQ(later.limits.velocity[i], 0.7 * full.limits.velocity[i]);
  }
  EXPECT_NEAR((first.spec.goal - first.spec.start).norm(), 0.4 * (full.spec.goal - full.spec.start).norm(), 1e-9);
  EXPECT_EQ(first.limits.upper, full.limits.upper);
}

TEST(Rollout, SameSeedSameRecordingOtherSeedAnother) {
  std::string csv[3];
  for (int k = 0; k < 3; ++k) {
    Rig rig(true);
    const RolloutPlan plan = rig.Plan();
    auto controller = rig.ToGoal(plan);
    const auto driver = rig.Driver(k == 2 ? 8 : 7);
    const RolloutResult result = rig.Run(*driver, plan, controller).value();
    csv[k] = rollouts::UnpackBundle(result.bundle).value()[kRecordingFile];
  }
  EXPECT_EQ(csv[0], csv[1]);
  EXPECT_NE(csv[0], csv[2]);
}

TEST(Rollout, AnotherCallWithTheSameIdMovesNothing) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const auto driver = rig.Driver();
  const RolloutResult first = rig.Run(*driver, plan, controller).value();
  const auto untouched = rig.Driver();
  const RolloutResult again = rig.Run(*untouched, plan, controller).value();
  EXPECT_TRUE(again.was_there);
  EXPECT_EQ(again.bundle, first.bundle);
  EXPECT_EQ(again.goal_error.joint_norm, first.goal_error.joint_norm);
  EXPECT_EQ(untouched->pid(), -1);
}

TEST(Rollout, WhatBeganIsNeverBegunAgainThoughItsRecordingWasDeliveredOrLost) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const RolloutResult first = rig.Run(*rig.Driver(), plan, controller).value();
  rig.spool.reset();
  const auto take = [](auto&, auto&, auto&) { return Status::Ok(); };
  ASSERT_EQ(DeliverSpool(rig.folder, take).value(), 1);  // the upload that the worker did not live to see
  rig.spool = Spool::Open(rig.folder).value();
  const auto untouched = rig.Driver();
  const RolloutResult again = rig.Run(*untouched, plan, controller).value();
  EXPECT_TRUE(again.was_there);
  EXPECT_EQ(again.bundle, first.bundle);
  std::filesystem::remove_all(rig.folder + "/sent");
  const Status refused = rig.Run(*untouched, plan, controller).status();
  EXPECT_EQ(refused.code(), StatusCode::kAlreadyExists);
  EXPECT_THAT(refused.message(), HasSubstr("never begun again"));
  EXPECT_EQ(untouched->pid(), -1);
}

// Its first torque is not allowed: the rollout does not begin, and what is recorded of it stays.
TEST(Rollout, OneThatTripsBeforeItsFirstTorqueKeepsItsRecordingAndMayBeginLater) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  RolloutPlan weak = plan;
  weak.limits.torque.assign(6, 1e-6);
  auto controller = rig.ToGoal(plan);
  const Status refused = rig.Run(*rig.Driver(), weak, controller).status();
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.message(), HasSubstr("the rollout did not begin: torque_limit"));
  ASSERT_EQ(rig.spool->Ready(), std::vector<std::string>{"rollout-1+not-begun-1"});
  const auto bundle = rollouts::UnpackBundle(ReadFile(rig.spool->ReadyPath("rollout-1+not-begun-1")).value()).value();
  const auto said = nlohmann::json::parse(bundle.at("rollout.json"));
  EXPECT_EQ(said["id"], "rollout-1");
  EXPECT_EQ(said["began"], false);
  EXPECT_EQ(said["end_reason"], "torque_limit");
  EXPECT_THAT(said["detail"].get<std::string>(), HasSubstr("joint_"));
  EXPECT_EQ(said["stop"]["confirmed"], true);
  EXPECT_EQ(said["samples"], 1) << "the state that it was judged by";
  EXPECT_TRUE(rig.spool->Active().empty());
  EXPECT_FALSE(rig.spool->Begun("rollout-1").has_value());
  const auto again = rig.Run(*rig.Driver(), plan, controller);
  ASSERT_TRUE(again.ok()) << again.status().ToString();
  EXPECT_EQ(again->reason, EndReason::kCompleted);
  EXPECT_EQ(nlohmann::json::parse(again->rollout_json)["began"], true);
  EXPECT_EQ(rig.spool->Ready(), (std::vector<std::string>{"rollout-1", "rollout-1+not-begun-1"}));
}

TEST(Rollout, AFullDiskStopsANewRolloutBeforeTheArmIsTouched) {
  Rig rig(true);
  rig.config.min_free_mb = 1e12;
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const auto driver = rig.Driver();
  const Status refused = rig.Run(*driver, plan, controller).status();
  EXPECT_EQ(refused.code(), StatusCode::kResourceExhausted);
  EXPECT_THAT(refused.message(), HasSubstr("make room"));
  EXPECT_EQ(driver->pid(), -1);
}

TEST(Rollout, ExcitationMovesJointsThatTheControllerLeavesAtRest) {
  double moved[2];
  for (int k = 0; k < 2; ++k) {
    Rig rig(true);
    rig.spec.excitation = 0.1 * k;
    const RolloutPlan plan = rig.Plan();
    PlantArmModel arm(rig.plant, rig.values);
    FunctionController gravity(
        [&](double, const double* q, const double*, double* tau) { arm.GravityTorque(q, tau); });
    const auto driver = rig.Driver();
    const RolloutResult result = rig.Run(*driver, plan, gravity).value();
    EXPECT_EQ(result.reason, EndReason::kCompleted) << result.detail;
    const auto set = rollouts::LoadBundle(result.bundle).value();
    const auto joint_6 = set.recordings[0].q.row(5);
    moved[k] = joint_6.maxCoeff() - joint_6.minCoeff();
  }
  EXPECT_LT(moved[0], 0.01);
  EXPECT_GT(moved[1], 0.02);
}

struct FaultCase {
  Fault fault;
  double strength;
  EndReason reason;
};

class FaultyRobot : public testing::TestWithParam<FaultCase> {};

TEST_P(FaultyRobot, EndsInADefinedStopWithItsReasonAndKeepsTheRecording) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  const auto driver = rig.Driver();
  bool injected = false;
  auto controller = rig.ToGoal(plan, [&](double t) {
    if (t < 1.0 || injected) return;
    injected = true;
    ASSERT_TRUE(driver->InjectFault(GetParam().fault, GetParam().strength).ok());
  });
  const RolloutResult result = rig.Run(*driver, plan, controller).value();
  EXPECT_EQ(result.reason, GetParam().reason) << EndReasonName(result.reason) << ": " << result.detail;
  EXPECT_GE(result.rows, 25);
  EXPECT_LE(result.rows, 28);
  EXPECT_TRUE(rollouts::LoadBundle(result.bundle).ok());
  EXPECT_EQ(rig.spool->Ready(), std::vector<std::string>{"rollout-1"});
}

INSTANTIATE_TEST_SUITE_P(EachKind, FaultyRobot,
                         testing::Values(FaultCase{Fault::kFreeze, 0, EndReason::kDriverLost},
                                         FaultCase{Fault::kDropReplies, 0, EndReason::kDriverLost},
                                         FaultCase{Fault::kDie, 0, EndReason::kDriverLost},
                                         FaultCase{Fault::kNan, 0, EndReason::kRobotNan},
                                         FaultCase{Fault::kJump, 0.5, EndReason::kImpossibleState},
                                         FaultCase{Fault::kLeaveTorque, 0, EndReason::kModeLost}));

TEST(Rollout, RefusedTorqueModeIsFoundOutAndSaidSo) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const auto driver = rig.Driver();
  ASSERT_TRUE(driver->Connect(5).ok());
  ASSERT_TRUE(driver->InjectFault(Fault::kRefuseTorque).ok());
  const std::vector<double> zero(6, 0.0);
  const Status entered = driver->EnterTorqueMode(zero.data());
  EXPECT_EQ(entered.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(entered.message(), HasSubstr("refused torque mode"));
}

TEST(Rollout, NanFromTheControllerStopsTheArmAndTheRecordingSaysWhichJoint) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  auto spring = rig.ToGoal(plan);
  FunctionController controller([&](double t, const double* q, const double* v, double* tau) {
    spring.Command(t, q, v, tau);
    if (t > 0.9) tau[2] = std::nan("");
  });
  const auto driver = rig.Driver();
  const RolloutResult result = rig.Run(*driver, plan, controller).value();
  EXPECT_EQ(result.reason, EndReason::kControllerNan);
  EXPECT_THAT(result.detail, HasSubstr("joint_3"));
  RobotState state;
  ASSERT_TRUE(driver->SleepUntil(driver->NowNanos() + 1'000'000'000).ok());
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_EQ(state.mode, Mode::kPosition);
  for (int i = 0; i < 6; ++i) EXPECT_LT(std::abs(state.v[i]), 0.06);
}

TEST(Rollout, ABaseThatAddsGravityRunsTheSameControllers) {
  Rig rig(true);
  const std::string truth = ReadFile(rig.config.simulated.truth_path).value();
  auto json = nlohmann::json::parse(truth);
  json["gravity_compensation"] = "nominal";
  json["urdf"] = SourceDir() + "/deploy/robots/mico2.urdf";
  rig.config.simulated.truth_path = rig.folder + "/truth.json";
  ASSERT_TRUE(WriteFileAtomically(rig.config.simulated.truth_path, json.dump()).ok());
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const auto driver = rig.Driver();
  const RolloutResult result = rig.Run(*driver, plan, controller).value();
  EXPECT_EQ(result.reason, EndReason::kCompleted) << result.detail;
  EXPECT_LT(result.goal_error.joint_norm, 0.5 * result.goal_error.start_norm);
  const auto bundle = rollouts::UnpackBundle(result.bundle).value();
  EXPECT_THAT(bundle.at(kRecordingFile), HasSubstr("command_time"));
  EXPECT_THAT(bundle.at(kRecordingFile), HasSubstr("effort_asked.joint_2"));
  // The recording says that it lacks gravity, and with it the torque is the one that was asked for.
  const auto set = rollouts::LoadBundle(result.bundle).value();
  const auto whole = rollouts::LoadBundleOfWholeTorques(result.bundle).value();
  EXPECT_TRUE(set.effort_excludes_gravity);
  EXPECT_FALSE(whole.effort_excludes_gravity);
  const auto asked = whole.recordings[0].other.at("effort_asked.joint_2");
  const Eigen::VectorXd handed = set.recordings[0].effort_command.row(1);
  const Eigen::VectorXd with_gravity = whole.recordings[0].effort_command.row(1);
  EXPECT_GT((asked - handed).cwiseAbs().maxCoeff(), 1.0);
  EXPECT_LT((asked - with_gravity).cwiseAbs().maxCoeff(), 0.35);  // gravity between two rows, not at one
}

// What drives the arm is what it was handed plus the gravity of *its* masses. Sets that say different things
// about it are not mixed.
TEST(Rollout, RecordingsOfBothConventionsAreNotMixed) {
  std::vector<recordings::RecordingSet> sets;
  for (const char* compensation : {"none", "true"}) {
    Rig rig(true);
    auto json = nlohmann::json::parse(ReadFile(rig.config.simulated.truth_path).value());
    json["gravity_compensation"] = compensation;
    json["urdf"] = SourceDir() + "/deploy/robots/mico2.urdf";
    rig.config.simulated.truth_path = rig.folder + "/truth.json";
    ASSERT_TRUE(WriteFileAtomically(rig.config.simulated.truth_path, json.dump()).ok());
    const RolloutPlan plan = rig.Plan();
    auto controller = rig.ToGoal(plan);
    sets.push_back(rollouts::LoadBundle(rig.Run(*rig.Driver(), plan, controller).value().bundle).value());
    sets.back().folder = compensation;
    EXPECT_TRUE(sets.back().effort_excludes_gravity_given);
  }
  EXPECT_THAT(recordings::MergeSets(sets).status().message(), HasSubstr("effort_excludes_gravity"));
}

TEST(Rollout, SilencePutsTheArmInPositionMode) {
  Rig rig(true);
  const auto driver = rig.Driver();
  ASSERT_TRUE(driver->Connect(5).ok());
  PlantArmModel arm(rig.plant, rig.values);
  JointArray gravity{};
  RobotState state;
  ASSERT_TRUE(driver->ReadState(&state).ok());
  arm.GravityTorque(state.q.data(), gravity.data());
  ASSERT_TRUE(driver->EnterTorqueMode(gravity.data()).ok());
  ASSERT_TRUE(driver->SleepUntil(driver->NowNanos() + 200'000'000).ok());
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_EQ(state.mode, Mode::kTorque);
  ASSERT_TRUE(driver->SleepUntil(driver->NowNanos() + 100'000'000).ok());
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_EQ(state.mode, Mode::kPosition);
}

// A policy of the right shape that always asks for nothing.
// `first`: the torque that it asks of the first joint, whatever the state.
std::string IdlePolicy(const std::vector<std::string>& joints, double first = 0.0) {
  policy::Policy::Parts parts;
  const auto n = static_cast<int>(joints.size());
  parts.joints = joints;
  parts.encoding.inputs = 3 * n;
  parts.input_mean.assign(3 * n, 0.0);
  parts.input_scale.assign(3 * n, 1.0);
  parts.output_mean.assign(n, 0.0);
  parts.output_mean[0] = first;
  parts.output_scale.assign(n, 1.0);
  parts.network = policy::Network({3 * n, n});
  return policy::SerializePolicy(policy::Policy(parts));
}

TEST(RolloutTask, TakesTheBytesOfModelAndPolicyAndGivesTheBundleWithItsFigures) {
  Rig rig(true);
  rig.spool.reset();
  RolloutTaskInput input;
  input.model_json = sim::ModelToJson(rig.plant, rig.values);
  input.policy_bytes = IdlePolicy(rig.plant.joint_names());
  input.spec = rig.spec;
  std::vector<std::string> notes;
  const auto listen = [&](const ProgressUpdate& update) { notes.push_back(update.note); };
  const RolloutTaskOutput output = RunRolloutTask(rig.config, rig.folder, input, listen, rig.stop).value();
  EXPECT_TRUE(output.usable.ok());
  const auto summary = nlohmann::json::parse(output.summary_json);
  EXPECT_EQ(summary["end_reason"], "completed") << output.summary_json;
  EXPECT_EQ(summary["rows"], 51);
  EXPECT_GT(summary["goal_joint_norm"], 0.1);
  const auto metadata = nlohmann::json::parse(output.metadata_json);
  EXPECT_EQ(metadata["format"], "realitygrad.rollout/1");
  EXPECT_EQ(metadata["policy_sha256"], Sha256Hex(input.policy_bytes));
  EXPECT_FALSE(metadata.contains("urdf"));
  EXPECT_TRUE(rollouts::LoadBundle(output.bundle).ok());
  EXPECT_EQ(notes.back(), "completed");
  const RolloutTaskOutput again = RunRolloutTask(rig.config, rig.folder, input, listen, rig.stop).value();
  EXPECT_EQ(again.bundle, output.bundle);
}

TEST(RolloutTask, WhatCannotRunIsRefusedBeforeTheRobotIsTouched) {
  Rig rig(true);
  rig.spool.reset();
  RolloutTaskInput input;
  input.model_json = sim::ModelToJson(rig.plant, rig.values);
  input.policy_bytes = IdlePolicy({"joint_1"});
  input.spec = rig.spec;
  const auto run = [&] { return RunRolloutTask(rig.config, rig.folder, input, {}, rig.stop).status(); };
  EXPECT_EQ(run().code(), StatusCode::kInvalid);
  input.policy_bytes = "not a policy";
  EXPECT_FALSE(run().ok());
  input.controller = "dance";
  EXPECT_THAT(run().message(), HasSubstr("\"dance\""));
  input.model_json = "{}";
  EXPECT_FALSE(run().ok());
  EXPECT_TRUE(Spool::Open(rig.folder).value()->Active().empty());
}

TEST(RolloutTask, NamesRatesAndDurationsAreCheckedBeforeTheyBecomeAnything) {
  Rig rig(true);
  rig.spool.reset();
  RolloutTaskInput input;
  input.model_json = sim::ModelToJson(rig.plant, rig.values);
  input.policy_bytes = IdlePolicy(rig.plant.joint_names());
  const auto refusal = [&](const std::function<void(rollouts::RolloutSpec&)>& change) {
    input.spec = rig.spec;
    change(input.spec);
    return RunRolloutTask(rig.config, rig.folder, input, {}, rig.stop).status().message();
  };
  EXPECT_THAT(refusal([](auto& s) { s.id = "job1-../../../x-aa"; }), HasSubstr("id \"job1-../../../x-aa\""));
  EXPECT_THAT(refusal([](auto& s) { s.rate_hz = 2000; }), HasSubstr("rate_hz is 2000"));
  EXPECT_THAT(refusal([](auto& s) { s.duration_s = std::nan(""); }), HasSubstr("duration_s is nan"));
  rig.config.max_rate_hz = 50;
  EXPECT_THAT(refusal([](auto& s) { s.rate_hz = 51; }), HasSubstr("max_rate_hz 50"));
  rig.config.max_duration_s = 3;
  EXPECT_THAT(refusal([](auto& s) { s.duration_s = 4; }), HasSubstr("max_duration_s 3"));
  int files = 0;
  for (const char* part : {"active", "ready", "sent"})
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(rig.folder + "/" + part))
      ++files;
  EXPECT_EQ(files, 0);
}

struct TaskRig : Rig {
  TaskRig() : Rig(true) {
    spool.reset();
    input.model_json = sim::ModelToJson(plant, values);
    input.policy_bytes = IdlePolicy(plant.joint_names());
    input.spec = spec;
  }
  RolloutTaskInput input;
};

TEST(RolloutTask, WhatTheMonitorEndsIsMadeAgainSlowerAndARepeatOfTheTaskMovesNothing) {
  TaskRig rig;
  rig.config.limits.upper[0] = 0.1;
  rig.input.policy_bytes = IdlePolicy(rig.plant.joint_names(), 10.0);
  rig.input.slower_attempts = 1;
  rig.input.spec.excitation = 0.02;
  const auto task = [&] { return RunRolloutTask(rig.config, rig.folder, rig.input, {}, rig.stop).value(); };
  const RolloutTaskOutput output = task();
  const auto said = nlohmann::json::parse(output.metadata_json);
  EXPECT_EQ(said["end_reason"], "position_limit");
  ASSERT_EQ(said["made_again"].size(), 1u) << "whichever attempt counts, the other is said";
  const std::vector<std::string> ids = {"rollout-1", "rollout-1-slower1"};
  EXPECT_EQ(Spool::Open(rig.folder).value()->Ready(), ids);
  const auto attempt = [&](size_t k) {
    const std::string bundle = ReadFile(Spool::Open(rig.folder).value()->ReadyPath(ids[k])).value();
    return nlohmann::json::parse(rollouts::UnpackBundle(bundle).value().at("rollout.json"));
  };
  for (size_t k = 0; k < ids.size(); ++k) {
    EXPECT_EQ(attempt(k)["speed"], std::pow(0.5, k));
    EXPECT_EQ(attempt(k)["excitation"], 0.02 * std::pow(0.5, k));
    EXPECT_EQ(attempt(k)["made_again"].size(), k);
  }
  EXPECT_THAT(attempt(1)["made_again"][0].get<std::string>(), HasSubstr("stopped by position_limit ("));
  EXPECT_EQ(task().bundle, output.bundle);
  EXPECT_EQ(Spool::Open(rig.folder).value()->Ready(), ids);
}

TEST(RolloutTask, AStopByTheAgentEndsItAndNothingBeginsBeforeItIsArmedAgain) {
  TaskRig rig;
  auto board = Board::Create(rig.folder).value();
  const auto refused = RunRolloutTask(rig.config, rig.folder, rig.input, {}, rig.stop).status();
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.message(), HasSubstr("realitygrad agent arm"));
  board->Arm(true);
  board->Beat(RealClock().SteadyNanos() + 3'600'000'000'000);
  rig.input.spec.duration_s = 300;  // stopped long before
  std::atomic<bool> saw_motion = false;
  // Not before the controller has the arm: a rollout that did not begin is none.
  std::jthread person([&](const std::stop_token& over) {
    for (ArmStatus now = board->Read(); now.phase != Phase::kRollout || now.ticks < 10; now = board->Read()) {
      if (over.stop_requested()) return;
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    saw_motion = board->mover() == getpid();
    board->AskStop();
  });
  const auto output = RunRolloutTask(rig.config, rig.folder, rig.input, {}, rig.stop).value();
  const auto rollout = nlohmann::json::parse(output.metadata_json);
  EXPECT_EQ(rollout["end_reason"], "operator_stop");
  EXPECT_EQ(rollout["stop"]["confirmed"], true);
  EXPECT_TRUE(saw_motion);
  EXPECT_EQ(board->mover(), 0);
  EXPECT_EQ(std::string(board->Read().last_reason), "operator_stop");
  EXPECT_NEAR(board->Read().q[1], M_PI, 0.5);
  EXPECT_FALSE(board->armed());
}

TEST(RolloutTask, AnArmThatOutlivesItsDriverNeedsAnAgentBesideIt) {
  TaskRig rig;
  rig.config.simulated.socket_path = rig.folder + "/robot.sock";
  const auto refused = RunRolloutTask(rig.config, rig.folder, rig.input, {}, rig.stop).status();
  EXPECT_THAT(refused.message(), HasSubstr("a stop would not be heard"));
}

TEST(RolloutTask, ADryRunComputesAndSendsNothing) {
  TaskRig rig;
  rig.config.dry_run = true;
  rig.input.spec.duration_s = 0.5;
  const auto outcome = RunRolloutTask(rig.config, rig.folder, rig.input, {}, rig.stop).status();
  EXPECT_EQ(outcome.code(), StatusCode::kFailedPrecondition) << "it is no recording";
  EXPECT_THAT(outcome.message(), HasSubstr("commands were computed and none was sent"));
  const RawRecording raw = ReadRawRecording(rig.folder + "/dry_run.rec").value();
  EXPECT_GE(raw.samples.size(), 3u);
  for (const Sample& sample : raw.samples)
    for (int i = 0; i < 6; ++i) EXPECT_NEAR(sample.q[i], raw.samples[0].q[i], 0.003) << "it moved";
  EXPECT_TRUE(Spool::Open(rig.folder).value()->Ready().empty());
}

TEST(RolloutTask, ThePapersControllerRunsLiveOnTheBelievedModel) {
  Rig rig(true);
  rig.spool.reset();
  RolloutTaskInput input;
  input.model_json = sim::ModelToJson(rig.plant, rig.values);
  input.controller = "mpc";
  input.spec = rig.spec;
  input.spec.duration_s = 1.0;
  const RolloutTaskOutput output = RunRolloutTask(rig.config, rig.folder, input, {}, rig.stop).value();
  EXPECT_EQ(nlohmann::json::parse(output.metadata_json)["controller"], "mpc");
  EXPECT_TRUE(output.usable.ok());
}

// joint_5 swings by `width` rad and comes back, in 3 s, from the candle pose.
std::string SwingCsv(double width) {
  std::string csv = "time";
  for (int j = 1; j <= 6; ++j) csv += ",position.joint_" + std::to_string(j);
  for (int k = 0; k <= 75; ++k) {
    const double t = 0.04 * k;
    csv += "\n" + std::to_string(t);
    const double swing = 0.5 * width * (1 - std::cos(2 * M_PI * t / 3));
    for (const double q : {0.0, 3.141593, 3.141593, 0.0, swing, 0.0}) csv += "," + std::to_string(q);
  }
  return csv + "\n";
}

TEST(RolloutTask, PlaysAGivenMotionInsideTheMonitorAndRecordsIt) {
  Rig rig(true);
  rig.spool.reset();
  RolloutTaskInput input;
  input.model_json = sim::ModelToJson(rig.plant, rig.values);
  input.controller = "trajectory";
  input.motion_csv = SwingCsv(0.4);
  input.spec = rig.spec;
  rig.config.excitation = 0.1;
  const RolloutTaskOutput output = RunRolloutTask(rig.config, rig.folder, input, {}, rig.stop).value();
  const auto rollout = nlohmann::json::parse(output.metadata_json);
  EXPECT_EQ(rollout["end_reason"], "completed") << rollout["detail"];
  EXPECT_EQ(rollout["controller"], "trajectory");
  EXPECT_EQ(rollout["duration_s"], 3.0) << "the motion says how long";
  EXPECT_EQ(rollout["excitation"], 0.0) << "nothing is added to the motion";
  const auto set = rollouts::LoadBundle(output.bundle).value();
  const auto& recording = set.recordings.at(0);
  EXPECT_EQ(recording.rows(), 76);
  // The robot has rotors, friction and lag that the model lacks, so it follows loosely.
  EXPECT_GT(recording.q.row(4).maxCoeff() - recording.q.row(4).minCoeff(), 0.05);
}

TEST(RolloutTask, AMotionOutsideTheAgentsBoxesMovesNothing) {
  Rig rig(true);
  rig.spool.reset();
  RolloutTaskInput input;
  input.model_json = sim::ModelToJson(rig.plant, rig.values);
  input.controller = "trajectory";
  input.spec = rig.spec;
  const SafetyLimits good = rig.config.limits;
  const auto refusal = [&](double width, const std::function<void(SafetyLimits&)>& change) {
    input.motion_csv = SwingCsv(width);
    rig.config.limits = good;
    change(rig.config.limits);
    return RunRolloutTask(rig.config, rig.folder, input, {}, rig.stop).status().message();
  };
  EXPECT_THAT(refusal(0.4, [](SafetyLimits& l) { l.velocity[4] = 0.3; }),
              HasSubstr("motion: joint_5 has velocity"));
  EXPECT_THAT(refusal(0.4, [](SafetyLimits& l) { l.upper[4] = 0.2; }),
              HasSubstr("motion: joint_5 has position"));
  EXPECT_THAT(refusal(0.4, [](SafetyLimits& l) { l.torque[4] = 0.001; }),
              HasSubstr("joint_5 needs a torque of"));
  EXPECT_THAT(refusal(0.4, [](SafetyLimits& l) { l.task.upper[2] = 0.3; }),
              HasSubstr("the end effector has z ="));
  input.motion_csv = "";
  EXPECT_THAT(RunRolloutTask(rig.config, rig.folder, input, {}, rig.stop).status().message(),
              HasSubstr("motion"));
  EXPECT_TRUE(Spool::Open(rig.folder).value()->Active().empty());
}

TEST(Rollout, PlansRefuseGoalsOutsideTheBoxAndKeepTheGivenOnes) {
  Rig rig(true);
  rig.spec.goal = Eigen::VectorXd::Zero(6);  // joint_2 cannot be at 0
  const auto refused = PlanRollout(rig.spec, rig.config, rig.plant);
  EXPECT_THAT(refused.status().message(), HasSubstr("joint_2"));
  rig.spec.goal.resize(0);
  rig.spec.goal_position = Eigen::Vector3d(0.3, 0.3, 0.5);
  const RolloutPlan plan = PlanRollout(rig.spec, rig.config, rig.plant).value();
  const Eigen::MatrixXd tip = rollouts::TipPositions(rig.plant.model(), plan.spec.goal);
  EXPECT_LT((tip.col(0) - rig.spec.goal_position).norm(), 1e-3);
  rig.spec.goal_position = Eigen::Vector3d(3, 0, 0);
  EXPECT_FALSE(PlanRollout(rig.spec, rig.config, rig.plant).ok());
}

// A job's model says that joint_2 may go anywhere, with any torque, and that the arm is ten times as long.
TEST(Rollout, ABadModelDoesNotMoveTheFence) {
  Rig rig(true);
  std::string urdf = ReadFile(SourceDir() + "/deploy/robots/mico2.urdf").value();
  const auto replace = [&](const std::string& from, const std::string& to) {
    const size_t at = urdf.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    urdf.replace(at, from.size(), to);
  };
  replace("lower=\"0.8726646259971648\" upper=\"5.410520681182422\" effort=\"80\"",
          "lower=\"-90\" upper=\"90\" effort=\"8000\"");
  auto model = model::ParseUrdf(urdf, "bad.urdf",
                                {.joints = rig.plant.joint_names(), .locked = {}, .end_effector = ""});
  const auto bad =
      sim::Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
  const RolloutPlan plan = PlanRollout(rig.spec, rig.config, bad).value();
  EXPECT_EQ(LimitsToJson(plan.limits), LimitsToJson(rig.config.limits));
  replace("lower=\"-90\" upper=\"90\"", "lower=\"2\" upper=\"4\"");
  auto narrow = model::ParseUrdf(urdf, "narrow.urdf",
                                 {.joints = rig.plant.joint_names(), .locked = {}, .end_effector = ""});
  const SafetyLimits limits = LimitsFor(rig.config, narrow.value(), rig.config.start_pose).value();
  EXPECT_EQ(limits.lower[1], 2.02) << "what is tighter counts";
  EXPECT_EQ(limits.upper[1], 3.98);
}

TEST(Rollout, HomingStopsAtOnceWhenItIsCancelledAndTheArmIsAtRest) {
  Rig rig(true);
  rig.config.start_pose = {2.0, M_PI, M_PI, 0, 0, 0};
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const auto driver = rig.Driver();
  ASSERT_TRUE(driver->Connect(5).ok());
  RobotState before, after;
  ASSERT_TRUE(driver->ReadState(&before).ok());
  OwnArm arm(*rig.config.arm, Eigen::Vector3d(0, 0, -9.81));
  MoveOptions options;
  options.timeout_s = 30;
  // Stops when the arm has come half a radian.
  class Halfway final : public ArmModel {
   public:
    Halfway(OwnArm& arm, CancelToken& stop) : arm_(arm), stop_(stop) {}
    void GravityTorque(const double* q, double* tau) override { arm_.GravityTorque(q, tau); }
    void Tip(const double* q, double* position) override {
      arm_.Tip(q, position);
      if (q[0] > 0.5) stop_.Cancel();
    }
    OwnArm& arm_;
    CancelToken& stop_;
  } halfway(arm, rig.stop);
  const MoveOutcome moved =
      MoveUnderWatch(*driver, halfway, rig.config.limits, rig.config.start_pose.data(), options, rig.stop);
  EXPECT_EQ(moved.status.code(), StatusCode::kCancelled);
  EXPECT_TRUE(moved.stop.confirmed) << moved.stop.why;
  ASSERT_TRUE(driver->ReadState(&after).ok());
  EXPECT_GT(after.q[0], 0.4);
  EXPECT_LT(after.q[0], 0.8) << "it went on after the stop";
  EXPECT_EQ(after.mode, Mode::kPosition);
}

TEST(Rollout, HomingThroughAForbiddenPlaceIsStoppedByTheMonitor) {
  Rig rig(true);
  rig.config.start_pose = {2.0, M_PI, M_PI, 0, 0, 0};
  rig.config.limits.upper[0] = 2.1;
  const RolloutPlan plan = rig.Plan();
  rig.config.limits.upper[0] = 1.0;  // the fence is narrower than where it is sent
  auto controller = rig.ToGoal(plan);
  const auto driver = rig.Driver();
  const auto result = rig.Run(*driver, plan, controller);
  EXPECT_THAT(result.status().message(), HasSubstr("start pose: position_limit: joint_1"));
  RobotState state;
  ASSERT_TRUE(driver->ReadState(&state).ok());
  EXPECT_LT(state.q[0], 1.1);
  EXPECT_FALSE(Latch(rig.folder).Read().has_value()) << "it was seen at rest";
}

TEST(Rollout, AStopThatWasNotConfirmedLatchesUntilAPersonClearsIt) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  const auto driver = rig.Driver();
  bool killed = false;
  auto controller = rig.ToGoal(plan, [&](double t) {
    if (t > 0.5 && !killed) killed = driver->InjectFault(Fault::kDie).ok();
  });
  rig.config.simulated.socket_path = "/an/arm/that/outlives/its/driver";
  const RolloutResult result = rig.Run(*driver, plan, controller).value();
  EXPECT_EQ(result.reason, EndReason::kDriverLost);
  EXPECT_EQ(nlohmann::json::parse(result.rollout_json)["stop"]["confirmed"], false);
  rig.spec.id = "rollout-2";
  const RolloutPlan next = rig.Plan();
  auto calm = rig.ToGoal(next);
  const SimulatedDriverOptions child{.truth_path = rig.config.simulated.truth_path, .lock_step = true};
  rig.spool.reset();
  rig.spool = Spool::Open(rig.folder).value();  // the agent was started again
  SimulatedDriver untouched(child);
  const Status refused = rig.Run(untouched, next, calm).status();
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.message(), HasSubstr("realitygrad agent clear"));
  EXPECT_EQ(untouched.pid(), -1) << "nobody spoke to the arm";
  ASSERT_TRUE(Latch(rig.folder).Clear().ok());
  SimulatedDriver again(child);
  EXPECT_EQ(rig.Run(again, next, calm).value().reason, EndReason::kCompleted);
  EXPECT_FALSE(Latch(rig.folder).Read().has_value());
}

TEST(Rollout, ARateThatTheArmWouldTakeForSilenceIsRefused) {
  Rig rig(true);
  rig.spec.rate_hz = 5;
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  EXPECT_THAT(rig.Run(*rig.Driver(), plan, controller).status().message(), HasSubstr("rate_hz is 5"));
}

TEST(Rollout, MissingProgramAndMissingTruthAreAnErrorNotACrash) {
  Rig rig(true);
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  rig.config.simulated.program = "/nonexistent/robot";
  EXPECT_EQ(rig.Run(*rig.Driver(), plan, controller).status().code(), StatusCode::kFailedPrecondition);
  rig.config.simulated.program = "";
  rig.config.simulated.truth_path = "/nonexistent/truth.json";
  EXPECT_FALSE(rig.Run(*rig.Driver(), plan, controller).ok());
  EXPECT_TRUE(rig.spool->Ready().empty());
}

}  // namespace
}  // namespace rg::robot_agent
