#include "robot_agent/rollout/rollout_task.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "common/base/clock.h"
#include "common/base/hash.h"
#include "common/base/printf.h"
#include "common/sim/model_file.h"
#include "robot_agent/board.h"
#include "robot_agent/guard/guard_driver.h"
#include "robot_agent/rollout/controllers.h"
#include "robot_agent/rollout/dry_run_driver.h"
#include "robot_agent/rollout/rollout_runner.h"
#include "robot_agent/safety/latch.h"
#include "robot_agent/spool_delivery.h"
#include "services/rollouts/recording_bundle.h"
#include "services/rollouts/reference_motion.h"
#include "services/rollouts/rollout_end.h"
#include "services/rollouts/trust.h"
#include "services/trajectories/reference_tracking.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

constexpr double kLockWait = 10.0;  // s, for who finishes a dead process's recordings

// Start, goal and duration are the motion's; nothing is added to it.
rollouts::RolloutSpec SpecOf(const rollouts::ReferenceMotion& motion, rollouts::RolloutSpec spec) {
  spec.start = motion.q.col(0);
  spec.goal = motion.q.col(motion.q.cols() - 1);
  spec.duration_s = motion.duration_s();
  spec.excitation = 0.0;
  return spec;
}

Status CheckTaskBox(const rollouts::ReferenceMotion& motion, const model::RobotModel& model,
                    const TaskBox& box) {
  if (!box.enabled) return Status::Ok();
  const Eigen::MatrixXd tip = rollouts::TipPositions(model, motion.q);
  for (Eigen::Index k = 0; k < tip.cols(); ++k) {
    for (int axis = 0; axis < 3; ++axis) {
      if (tip(axis, k) >= box.lower[axis] && tip(axis, k) <= box.upper[axis]) continue;
      const std::string text =
          Printf("motion: the end effector has %c = %.4g m at %.3g s, its box is %.4g to %.4g", "xyz"[axis],
                 tip(axis, k), motion.t[k], box.lower[axis], box.upper[axis]);
      return InvalidError(text);
    }
  }
  return Status::Ok();
}

// Everything that can be known before the arm moves.
Result<std::unique_ptr<Controller>> FollowMotion(const rollouts::ReferenceMotion& motion,
                                                 const sim::ModelFile& model, const RolloutPlan& plan) {
  const SafetyLimits& limits = plan.limits;
  RG_RETURN_IF_ERROR(rollouts::CheckMotion(
      motion, {ToEigen(limits.lower), ToEigen(limits.upper), ToEigen(limits.velocity)}));
  RG_RETURN_IF_ERROR(CheckTaskBox(motion, model.plant.model(), limits.task));
  RG_ASSIGN_OR_RETURN(auto tracking,
                      trajectories::PlanTracking(
                          model.plant, model.values,
                          [&](double t, Eigen::VectorXd* q, Eigen::VectorXd* v, Eigen::VectorXd* a) {
                            motion.At(t, q, v, a);
                          },
                          motion.duration_s(), 1.0 / plan.spec.rate_hz, ToEigen(limits.torque)));
  return std::unique_ptr<Controller>(std::make_unique<TrackingController>(std::move(tracking)));
}

// How long a policy's goal takes to its place where the rollout is slower than the policy was trained for.
double ApproachSeconds(const RolloutPlan& plan, const model::RobotModel& model) {
  if (plan.speed >= 1.0) return 0.0;
  const Eigen::VectorXd far = (plan.spec.goal - plan.spec.start).cwiseAbs();
  return std::min(0.5 * plan.spec.duration_s,
                  (far.array() / (plan.speed * model.VelocityLimits().array())).maxCoeff());
}

Result<std::unique_ptr<Controller>> MakeController(const RolloutTaskInput& input, const sim::ModelFile& model,
                                                   const RolloutPlan& plan,
                                                   const std::optional<rollouts::ReferenceMotion>& motion) {
  if (motion) return FollowMotion(*motion, model, plan);
  if (input.controller == "mpc") {
    return MakeMpcController(model.plant, model.values, plan.spec.goal, ToEigen(plan.limits.torque),
                             plan.spec.rate_hz, plan.speed);
  }
  if (input.controller != "policy")
    return InvalidError("rollout: controller \"" + input.controller + "\", needs policy, mpc or trajectory");
  RG_ASSIGN_OR_RETURN(policy::Policy policy, policy::ParsePolicy(input.policy_bytes, "policy"));
  RG_ASSIGN_OR_RETURN(auto controller,
                      PolicyController::Create(std::move(policy), model.plant.joint_names(), plan.spec.goal));
  controller->ApproachGoal(plan.spec.start, ApproachSeconds(plan, model.plant.model()));
  return std::unique_ptr<Controller>(std::move(controller));
}

// A real arm without an agent beside it would not hear a stop.
Status CheckArmed(const AgentConfig& config, const Result<std::unique_ptr<Board>>& board) {
  if (board.ok()) {
    if ((*board)->armed()) return Status::Ok();
    return FailedPreconditionError("the arm " + config.name + " is disarmed: realitygrad agent arm");
  }
  if (config.arm_ends_with_driver() && board.status().code() == StatusCode::kNotFound) return Status::Ok();
  return FailedPreconditionError("no agent runs beside the arm " + config.name +
                                 ", a stop would not be heard: " + board.status().message());
}

// For as long as --arm-timeout says. What is wrong then is said by the checks that follow.
Status WaitUntilArmed(const AgentConfig& config, const std::string& spool_folder, const ProgressFn& progress,
                      const CancelToken& stop) {
  const double begin = RealClock().SteadySeconds();
  while (true) {
    const std::string why = WaitsFor(config, spool_folder);
    const double waited_s = RealClock().SteadySeconds() - begin;
    if (why.empty() || waited_s >= config.arm_timeout_s) return Status::Ok();
    if (stop.cancelled()) return CancelledError("told to stop: it " + why);
    if (progress) progress({"waiting", waited_s, config.arm_timeout_s, why});
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
}

std::string GuardProgram() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  return (self.parent_path() / "realitygrad-guard").string();
}

// Beside an agent the arm is the guard's. Without one (tests, tools) it is a simulated arm's own driver.
Result<std::unique_ptr<Driver>> DriverFor(const AgentConfig& config, const rollouts::RolloutSpec& spec,
                                          const std::string& spool_folder, bool beside_agent,
                                          const GuardDriver** guard) {
  if (config.dry_run || !beside_agent || config.path.empty()) {
    RG_ASSIGN_OR_RETURN(auto driver, MakeDriver(config, spec.robot_seed));
    if (!config.dry_run) return driver;
    return std::unique_ptr<Driver>(std::make_unique<DryRunDriver>(std::move(driver)));
  }
  std::vector<std::string> arguments = {GuardProgram(),
                                        "--config",
                                        config.path,
                                        "--spool",
                                        spool_folder,
                                        "--seed",
                                        std::to_string(spec.robot_seed)};
  if (config.simulated.lock_step) arguments.push_back("--lock-step");
  RG_ASSIGN_OR_RETURN(auto guarded, GuardDriver::Start(std::move(arguments), 1.0 / spec.rate_hz));
  *guard = guarded.get();
  return std::unique_ptr<Driver>(std::move(guarded));
}

// `others`: how the attempts ended that do not count.
RolloutTaskOutput OutputOf(const RolloutResult& result, const std::vector<std::string>& others) {
  json rollout = json::parse(result.rollout_json);
  rollout["made_again"] = others;
  const json jitter = rollout.value("jitter", json::object());
  const json none = json::object();
  RolloutTaskOutput output;
  output.metadata_json = rollout.dump();
  output.end = rollouts::HowItEnded(rollout);
  if (!output.end.as_asked && !others.empty())
    output.end.text += ", in the longest of " + std::to_string(others.size() + 1) + " attempts";
  output.summary_json = json{{"ended", output.end.text},
                             {"end_reason", EndReasonName(result.reason)},
                             {"detail", result.detail},
                             {"rows", result.rows},
                             {"ended_after_s", rollout.value("ended_after_s", 0.0)},
                             {"goal_joint_norm", result.goal_error.joint_norm},
                             {"goal_tip_m", result.goal_error.tip_distance},
                             {"missed_deadlines", jitter.value("missed_deadlines", 0)},
                             {"cycle_p99_us", jitter.value("cycle_us", none).value("p99", 0.0)},
                             {"lateness_p99_us", jitter.value("lateness_us", none).value("p99", 0.0)}}
                            .dump();
  output.bundle = result.bundle;
  output.usable = rollouts::CheckRows(result.bundle, 2);
  return output;
}

// What all attempts of a rollout have in common.
struct Common {
  const AgentConfig& config;
  const RolloutTaskInput& input;
  const std::string& spool_folder;
  Spool& spool;
  const sim::ModelFile& model;
  const std::optional<rollouts::ReferenceMotion>& motion;
};

// `plan` at a share of the speed: less excitation, tighter prediction, and a policy's goal that moves there
// first.
void SlowDown(double speed, RolloutPlan* plan) {
  plan->speed = speed;
  plan->spec.excitation *= speed;
}

// One attempt: everything from the plan to a recording in the spool.
Result<RolloutResult> RunOnce(const Common& all, const RolloutPlan& plan, std::vector<std::string> made_again,
                              const ProgressFn& progress, const CancelToken& stop) {
  RG_ASSIGN_OR_RETURN(const auto controller, MakeController(all.input, all.model, plan, all.motion));
  RG_RETURN_IF_ERROR(WaitUntilArmed(all.config, all.spool_folder, progress, stop));
  const auto board = Board::Open(all.spool_folder);
  RG_RETURN_IF_ERROR(CheckArmed(all.config, board));
  const GuardDriver* guard = nullptr;
  RG_ASSIGN_OR_RETURN(const auto driver,
                      DriverFor(all.config, plan.spec, all.spool_folder, board.ok(), &guard));
  RolloutInput rollout{
      .plan = plan,
      .config = all.config,
      .plant = all.model.plant,
      .controller = *controller,
      .limit_speed = !all.motion,
      .made_again = std::move(made_again),
      .controller_name = all.input.controller,
      .policy_sha256 = all.input.policy_bytes.empty() ? "" : Sha256Hex(all.input.policy_bytes),
      .model_sha256 = Sha256Hex(all.input.model_json),
      .database = all.input.database,
      .job_id = all.input.job_id,
      .task_id = all.input.task_id};
  rollout.guard = guard;
  if (!board.ok()) return RunRollout(*driver, rollout, all.spool, progress, stop, RealClock());
  const StopListener listener(**board, stop);
  BoardPublisher publisher(**board, plan.spec.id, all.model.plant.joint_names(), plan.limits,
                           plan.spec.rate_hz, all.config.dry_run);
  rollout.observer = &publisher;
  auto result = RunRollout(*driver, rollout, all.spool, progress, listener.token(), RealClock());
  if (guard != nullptr && guard->trip().reason == EndReason::kOperatorStop)
    (*board)->Arm(false);  // as any other stop
  if (result.ok()) {
    publisher.SetEnd(std::string(EndReasonName(result->reason)), result->detail);
  } else {
    publisher.SetEnd(std::string(StatusCodeName(result.status().code())), result.status().message());
  }
  return result;
}

// Whether another, slower attempt may follow.
bool MayBeMadeAgain(const RolloutResult& result) {
  return rollouts::MayBeMadeAgain(EndReasonName(result.reason)) &&
         json::parse(result.rollout_json).value("held", false);
}

// Full speed first. Ids are a function of the attempt, so that a repeat of the task finds every attempt in
// the spool.
Result<RolloutTaskOutput> RunUntilItEnds(const Common& all, const RolloutPlan& full,
                                         const ProgressFn& progress, const CancelToken& stop) {
  RG_ASSIGN_OR_RETURN(RolloutResult best, RunOnce(all, full, {}, progress, stop));
  bool may_follow = MayBeMadeAgain(best);
  std::vector<std::string> ends = {rollouts::HowItEnded(best.rollout_json).text};
  size_t chosen = 0;
  const int most = all.motion ? 0 : all.input.slower_attempts;
  for (int again = 1; again <= most && may_follow && !stop.cancelled(); ++again) {
    spdlog::warn("rollout {} was {}: made again at half the speed, {} of {}", full.spec.id, ends.back(),
                 again, most);
    RolloutPlan plan = full;
    SlowDown(std::pow(0.5, again), &plan);
    plan.spec.id = full.spec.id + "-slower" + std::to_string(again);
    auto next = RunOnce(all, plan, ends, progress, stop);
    if (!next.ok()) {
      spdlog::error("rollout {}: {}; the ones before count", plan.spec.id, next.status().message());
      break;
    }
    may_follow = MayBeMadeAgain(*next);
    ends.push_back(rollouts::HowItEnded(next->rollout_json).text);
    if (next->reason == EndReason::kCompleted || next->rows >= best.rows)
      best = std::move(*next), chosen = ends.size() - 1;
  }
  ends.erase(ends.begin() + static_cast<std::ptrdiff_t>(chosen));
  return OutputOf(best, ends);
}

}  // namespace

std::string WaitsFor(const AgentConfig& config, const std::string& spool_folder) {
  const auto board = Board::Open(spool_folder);
  if (!board.ok() || (*board)->mover() != 0) return "";
  const auto latch = config.arm_ends_with_driver() ? std::nullopt : Latch(spool_folder).Read();
  if (latch) return "waits for " + config.name + ", which is latched (" + latch->reason + "): realitygrad agent clear";
  return (*board)->armed() ? "" : "waits for " + config.name + " to be armed: realitygrad agent arm";
}

Result<RolloutTaskOutput> RunRolloutTask(const AgentConfig& config, const std::string& spool_folder,
                                         const RolloutTaskInput& input, const ProgressFn& progress,
                                         const CancelToken& stop) {
  RG_RETURN_IF_ERROR(rollouts::CheckSpec(input.spec));  // its id becomes a path
  RG_ASSIGN_OR_RETURN(const auto spool, Spool::Open(spool_folder, kLockWait));
  SalvageRecordings(*spool);
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, sim::ModelFromJson(input.model_json, "model"));
  std::optional<rollouts::ReferenceMotion> motion;
  rollouts::RolloutSpec spec = input.spec;
  if (input.controller == "trajectory") {
    RG_ASSIGN_OR_RETURN(motion, rollouts::ParseMotion(input.motion_csv, "motion", model.plant.model()));
    spec = SpecOf(*motion, std::move(spec));
  }
  RG_ASSIGN_OR_RETURN(const RolloutPlan plan, PlanRollout(spec, config, model.plant, input.trust));
  const Common all{config, input, spool_folder, *spool, model, motion};
  return RunUntilItEnds(all, plan, progress, stop);
}

}  // namespace rg::robot_agent
