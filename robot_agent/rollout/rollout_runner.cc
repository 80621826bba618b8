#include "robot_agent/rollout/rollout_runner.h"

#include <unistd.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/base/file.h"
#include "common/base/log.h"
#include "common/model/robot_model.h"
#include "robot_agent/guard/guard_driver.h"
#include "robot_agent/rollout/controllers.h"
#include "robot_agent/rollout/limited_controller.h"
#include "robot_agent/safety/latch.h"
#include "robot_agent/safety/own_arm.h"
#include "robot_agent/safety/watched_move.h"
#include "services/trajectories/inverse_kinematics.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

constexpr double kAway = 1.0;   // s before an arm that is away is connected to again
constexpr double kLook = 0.05;  // s between looks at a stop meanwhile

std::vector<double> ToVector(const Eigen::VectorXd& x) { return {x.data(), x.data() + x.size()}; }

Status CheckSize(const char* what, const Eigen::VectorXd& x, int n) {
  if (x.size() == n) return Status::Ok();
  return InvalidError(std::string("rollout: ") + what + " has " + std::to_string(x.size()) + " entries for " +
                      std::to_string(n) + " joints");
}

Status CheckMost(const char* field, double value, double most) {
  if (value <= most) return Status::Ok();
  return InvalidError(std::string("rollout: ") + field + " is " + std::to_string(value) +
                      ", this agent's configuration allows max_" + field + " " + std::to_string(most));
}

Status CheckInBox(const model::RobotModel& model, const SafetyLimits& limits, const Eigen::VectorXd& goal) {
  for (int i = 0; i < model.num_joints(); ++i)
    if (goal[i] < limits.lower[i] || goal[i] > limits.upper[i])
      return InvalidError("rollout: the goal has " + model.joint(i).name + " at " + std::to_string(goal[i]) +
                          ", outside its box [" + std::to_string(limits.lower[i]) + ", " +
                          std::to_string(limits.upper[i]) + "]");
  return Status::Ok();
}

// The joints of the arm, in the order of the model: drivers and models number them alike.
Status CheckJoints(const DriverInfo& info, const sim::Plant& plant) {
  if (info.joints == plant.joint_names()) return Status::Ok();
  std::string have, want;
  for (const auto& joint : info.joints) have += " " + joint;
  for (const auto& joint : plant.joint_names()) want += " " + joint;
  return InvalidError("the robot " + info.robot + " has the joints" + have + ", the model" + want);
}

json NoiseOf(const DriverInfo& info) {
  json noise = json::object();
  if (info.position_stddev > 0) noise["position_stddev"] = info.position_stddev;
  if (info.velocity_stddev > 0) noise["velocity_stddev"] = info.velocity_stddev;
  if (info.position_resolution > 0) noise["position_resolution"] = info.position_resolution;
  return noise;
}

// `setbacks`: how the arm was away before this, one line each.
std::string MetadataOf(const DriverInfo& info, const RolloutInput& input,
                       const std::vector<std::string>& setbacks, const Clock& clock) {
  const auto& spec = input.plan.spec;
  const Eigen::Vector3d gravity = input.plant.options().gravity;
  return json{{"format", rollouts::kRolloutFormat},
              {"id", spec.id},
              {"robot", info.robot},
              {"driver", info.driver},
              {"lock_step", info.lock_step},
              {"joints", info.joints},
              {"urdf", input.plant.model().urdf_text()},
              {"gravity", {gravity.x(), gravity.y(), gravity.z()}},
              {"rate_hz", spec.rate_hz},
              {"duration_s", spec.duration_s},
              {"torque_convention", info.adds_gravity_compensation
                                        ? "what the arm was handed; its base adds gravity compensation"
                                        : "whole joint torque, gravity included"},
              {"adds_gravity_compensation", info.adds_gravity_compensation},
              {"start", ToVector(spec.start)},
              {"goal", ToVector(spec.goal)},
              {"goal_seed", spec.goal_seed},
              {"controller", input.controller_name},
              {"excitation", spec.excitation},
              {"trust", input.plan.trust},
              {"speed", input.plan.speed},
              {"made_again", input.made_again},
              {"policy_sha256", input.policy_sha256},
              {"model_sha256", input.model_sha256},
              {"database", input.database},
              {"job", input.job_id},
              {"task", input.task_id},
              {"limits", json::parse(LimitsToJson(input.plan.limits))},
              {"noise", NoiseOf(info)},
              {"setbacks", setbacks},
              {"started", FormatWallTime(clock.WallNanos())}}
      .dump();
}

std::string DetailOf(const ControlLoopResult& loop, const std::vector<std::string>& joints) {
  return loop.refusal.ok() ? DescribeTrip(loop.trip, joints) : loop.refusal.message();
}

std::string EndOf(const ControlLoopResult& loop, const std::vector<std::string>& joints) {
  return json{{"end_reason", EndReasonName(loop.trip.reason)},
              {"detail", DetailOf(loop, joints)},
              {"began", loop.began},
              {"ended_after_s", loop.duration_s},
              {"commands", loop.commands},
              {"saturated_samples", loop.saturated_samples},
              {"held", loop.stop.confirmed},
              {"stop",
               {{"confirmed", loop.stop.confirmed},
                {"attempts", loop.stop.attempts},
                {"took_s", loop.stop.took_s},
                {"why", loop.stop.why}}},
              {"jitter", json::parse(loop.jitter.ToJson())}}
      .dump();
}

RolloutResult ResultOf(const FinishedRollout& finished, std::string bundle, std::string path,
                       const RolloutInput& input) {
  RolloutResult result;
  const json rollout = json::parse(finished.rollout_json);
  result.reason = EndReasonFromName(rollout.value("end_reason", ""));
  result.detail = rollout.value("detail", "");
  result.rows = finished.recording.rows();
  if (result.rows > 0)
    result.goal_error = rollouts::ScoreGoal(input.plant.model(), finished.recording, input.plan.spec.goal);
  result.rollout_json = finished.rollout_json;
  result.bundle = std::move(bundle);
  result.bundle_path = std::move(path);
  return result;
}

// A rollout of that id is in the spool already, finished or just salvaged, delivered or not.
Result<RolloutResult> AlreadyThere(const std::string& path, const RolloutInput& input) {
  RG_ASSIGN_OR_RETURN(std::string bytes, ReadFile(path));
  RG_ASSIGN_OR_RETURN(rollouts::Bundle bundle, rollouts::UnpackBundle(bytes));
  FinishedRollout finished{.bundle = bundle, .recording = {}, .rollout_json = bundle["rollout.json"]};
  const auto recording = recordings::ParseCsv(bundle[kRecordingFile], kRecordingFile,
                                              {.joints = input.plant.joint_names(), .robot = {}});
  if (recording.ok()) finished.recording = *recording;
  RolloutResult result = ResultOf(finished, std::move(bytes), path, input);
  result.was_there = true;
  return result;
}

Result<Eigen::VectorXd> GoalByInverseKinematics(const sim::Plant& plant, const rollouts::RolloutSpec& spec) {
  Rng rng(spec.goal_seed);
  trajectories::TaskGoal goal{.position = spec.goal_position, .orientation = std::nullopt, .link = ""};
  const auto found = trajectories::SolveInverseKinematics(plant.model(), goal, spec.start, {}, rng);
  if (!found.reached) return InvalidError("rollout: " + found.message);
  return found.q;
}

MoveOutcome GoToStart(Driver& driver, ArmModel& arm, const RolloutInput& input, const ProgressFn& progress,
                      const CancelToken& stop) {
  if (progress) progress({"rollout", 0.0, input.plan.spec.duration_s, "to the start pose"});
  MoveOptions options;
  options.tolerance = input.config.pose_tolerance;
  options.timeout_s = input.config.pose_timeout_s;
  options.settle_s = input.config.settle_s;
  options.stop = input.config.stop;
  if (input.observer != nullptr)
    options.on_state = [&input](const RobotState& state) { input.observer->OnState(state); };
  return MoveUnderWatch(driver, arm, input.config.limits, input.plan.spec.start.data(), options, stop);
}

// Nothing that was lost makes an arm move twice.
Status CheckNeverBegun(const Spool& spool, const std::string& id) {
  const auto line = spool.Begun(id);
  if (!line) return Status::Ok();
  return AlreadyExistsError("rollout " + *line +
                            " began on this arm and is never begun again; its recording is no "
                            "longer in the spool " +
                            spool.folder() +
                            " (the store has it, or look in broken/): "
                            "`realitygrad job retry` makes another attempt, which moves the arm");
}

double SamplesOf(const rollouts::RolloutSpec& spec) { return spec.rate_hz * spec.duration_s + 64.0; }

// The recording, its bundle as text, and what the disk's owner wants left.
Status CheckRoom(const Spool& spool, const RolloutInput& input, int n) {
  const double bytes = SamplesOf(input.plan.spec) * static_cast<double>(Recorder::SampleBytes(n));
  return spool.CheckRoom(4e-6 * bytes + input.config.min_free_mb);
}

// The loop only sees that the arm left its mode: the guard knows why.
void AskGuard(const GuardDriver& guard, Trip* trip) {
  const bool symptom = trip->reason == EndReason::kModeLost || trip->reason == EndReason::kDriverLost ||
                       trip->reason == EndReason::kMissedDeadlines || trip->reason == EndReason::kNotStarted;
  if (!symptom || guard.trip().reason == EndReason::kNone) return;
  const int64_t at_ns = trip->at_ns;
  *trip = guard.trip();
  trip->at_ns = at_ns;
}

// The stop is known to have worked, or the arm is latched. Safe stop first, words second.
void CloseLatch(Latch& latch, const StopReport& stop, const std::string& id, const Clock& clock) {
  const std::string now = FormatWallTime(clock.WallNanos());
  const Status written = stop.confirmed ? latch.EndMotion() : latch.Set(id, stop.why, now);
  if (!stop.confirmed) spdlog::error("rollout {}: the stop was not confirmed: {}; latched", id, stop.why);
  if (!written.ok()) spdlog::error("rollout {}: {}", id, written.ToString());
}

// An arm that is a process of its driver's is gone with it, and its successor begins at rest.
Status CheckLatch(Latch& latch, const AgentConfig& config) {
  const Status clear = latch.CheckClear();
  if (clear.ok() || !config.arm_ends_with_driver()) return clear;
  spdlog::warn("{}; that simulated arm is gone, cleared", clear.message());
  return latch.Clear();
}

// A command has to come well before the arm counts the agent as silent.
Status CheckRate(const DriverInfo& info, const rollouts::RolloutSpec& spec) {
  if (info.silence_timeout_s <= 0 || 2.0 / spec.rate_hz <= info.silence_timeout_s) return Status::Ok();
  return InvalidError("rollout: rate_hz is " + std::to_string(spec.rate_hz) + "; the arm " + info.robot +
                      " takes silence of " + std::to_string(info.silence_timeout_s) +
                      " s for a lost agent and needs at least " +
                      std::to_string(2.0 / info.silence_timeout_s));
}

// From where the arm stands. Never a result: what was computed was not what moved it.
Status DryRun(Driver& driver, ArmModel& arm, const RolloutInput& input, const Spool& spool,
              const CancelToken& stop, const Clock& clock) {
  const std::string path = spool.folder() + "/dry_run.rec";
  std::filesystem::remove(path);
  const int n = input.plant.num_joints();
  RG_ASSIGN_OR_RETURN(const auto recorder,
                      Recorder::Start(path, MetadataOf(driver.info(), input, {}, clock), n, {}));
  ControlLoopOptions options;
  options.rate_hz = input.plan.spec.rate_hz;
  options.duration_s = input.plan.spec.duration_s;
  options.velocity_source = input.config.velocity_source;
  options.observer = input.observer;
  const ControlLoopResult loop =
      RunControlLoop(driver, input.controller, arm, input.plan.limits, options, *recorder, stop, clock);
  RG_RETURN_IF_ERROR(recorder->Finish(EndOf(loop, driver.info().joints)));
  const std::string detail = DescribeTrip(loop.trip, driver.info().joints);
  return FailedPreconditionError("dry run: " + std::to_string(loop.commands) +
                                 " commands were computed and none was sent, it ended with " +
                                 std::string(EndReasonName(loop.trip.reason)) +
                                 (detail.empty() ? "" : " (" + detail + ")") + "; they are in " + path);
}

// One way to the start pose and through the control loop.
struct Attempt {
  Status failed;      // the rollout did not begin
  bool away = false;  // because the arm could not be reached for a while
  StopReport stop;
  ControlLoopResult loop;
  std::unique_ptr<Recorder> recorder;  // where it began
};

// The arm, its driver or this machine was not there for a moment: nothing that the arm did.
bool WasAway(EndReason reason, const Status& failed) {
  return reason == EndReason::kStaleState || reason == EndReason::kDriverLost ||
         reason == EndReason::kControllerHung || IsOutage(failed);
}

EndReason ReasonOf(const Trip& own, const GuardDriver* guard) {
  return own.reason == EndReason::kNone && guard != nullptr ? guard->trip().reason : own.reason;
}

Status StartRecording(const Driver& driver, const RolloutInput& input, const Spool& spool,
                      const std::vector<std::string>& setbacks, const Clock& clock, Attempt* attempt) {
  const int n = input.plant.num_joints();
  const uint64_t room = static_cast<uint64_t>(SamplesOf(input.plan.spec)) * Recorder::SampleBytes(n);
  RG_ASSIGN_OR_RETURN(attempt->recorder, Recorder::Start(spool.ActivePath(input.plan.spec.id),
                                                         MetadataOf(driver.info(), input, setbacks, clock), n,
                                                         {.reserve_bytes = room}));
  return Status::Ok();
}

// About what passes until a command acts: in transport, in the drive.
constexpr double kCommandDelay_s = 0.02;

ControlLoopResult RunLoop(Driver& driver, ArmModel& arm, const RolloutInput& input, Recorder& recorder,
                          const ProgressFn& progress, const CancelToken& stop, const Clock& clock) {
  const auto& spec = input.plan.spec;
  ControlLoopOptions options;
  options.rate_hz = spec.rate_hz;
  options.duration_s = spec.duration_s;
  options.velocity_source = input.config.velocity_source;
  options.observer = input.observer;
  options.stop = input.config.stop;
  if (progress) progress({"rollout", 0.0, options.duration_s, "running"});
  ExcitedController excited(input.controller, spec.excitation * ToEigen(input.plan.limits.torque),
                            options.duration_s, spec.goal_seed);
  std::optional<LimitedController> limited;
  if (input.limit_speed) {
    limited.emplace(excited, arm,
                    VelocityShare{.velocity = input.plan.speed * ToEigen(input.plan.limits.velocity),
                                  .ahead_s = 1.0 / spec.rate_hz + kCommandDelay_s});
  }
  Controller& controller = limited ? static_cast<Controller&>(*limited) : excited;
  ControlLoopResult loop =
      RunControlLoop(driver, controller, arm, input.plan.limits, options, recorder, stop, clock);
  if (limited && limited->limited() > 0)
    spdlog::info("{} of {} commands kept from the velocity limits", limited->limited(), loop.commands);
  if (input.guard != nullptr) AskGuard(*input.guard, &loop.trip);
  return loop;
}

Status KeepRecording(Spool& spool, const std::string& id, const std::string& end, Recorder& recorder) {
  RG_RETURN_IF_ERROR(recorder.Finish(end));
  RG_ASSIGN_OR_RETURN(const std::string bundle, FinishFile(spool.ActivePath(id)));
  return spool.CommitNotBegun(id, bundle);
}

// Nothing was sent that its controller asked for: it may begin later. Why it did not is recorded, and kept.
void TakeBackBeginning(Spool& spool, const std::string& id, const std::string& end, Attempt* attempt) {
  const Status kept = KeepRecording(spool, id, end, *attempt->recorder);
  attempt->recorder.reset();
  if (!kept.ok()) spdlog::error("rollout {} did not begin, but counts as begun: {}", id, kept.message());
}

Attempt TryRollout(Driver& driver, ArmModel& arm, const RolloutInput& input, Spool& spool,
                   const std::vector<std::string>& setbacks, const ProgressFn& progress,
                   const CancelToken& stop, const Clock& clock) {
  const std::string& id = input.plan.spec.id;
  Attempt attempt;
  const MoveOutcome moved = GoToStart(driver, arm, input, progress, stop);
  attempt.failed = moved.status.WithPrefix("start pose");
  attempt.stop = moved.stop;
  attempt.away = WasAway(ReasonOf(moved.trip, input.guard), moved.status);
  if (!attempt.failed.ok()) {
    if (attempt.away) attempt.failed = UnavailableError(attempt.failed.message());
    return attempt;
  }
  attempt.failed = StartRecording(driver, input, spool, setbacks, clock, &attempt);
  if (attempt.failed.ok()) attempt.failed = spool.MarkBegun(id, FormatWallTime(clock.WallNanos()));
  if (!attempt.failed.ok()) {
    attempt.stop = StopArm(driver, input.config.stop);
    ControlLoopResult none;
    none.trip.reason = EndReason::kNotStarted;
    none.refusal = attempt.failed;
    none.stop = attempt.stop;
    if (attempt.recorder != nullptr)
      TakeBackBeginning(spool, id, EndOf(none, driver.info().joints), &attempt);
    return attempt;
  }
  attempt.loop = RunLoop(driver, arm, input, *attempt.recorder, progress, stop, clock);
  attempt.stop = attempt.loop.stop;
  if (attempt.loop.began) return attempt;
  const EndReason reason = attempt.loop.trip.reason;
  const std::string detail = DetailOf(attempt.loop, driver.info().joints);
  const std::string words = "the rollout did not begin: " + std::string(EndReasonName(reason)) +
                            (detail.empty() ? "" : " (" + detail + ")");
  attempt.away =
      WasAway(reason == EndReason::kNotStarted ? ReasonOf({}, input.guard) : reason, attempt.loop.refusal);
  attempt.failed = reason == EndReason::kOperatorStop ? CancelledError(words)
                   : attempt.away                     ? UnavailableError(words)
                                                      : FailedPreconditionError(words);
  TakeBackBeginning(spool, id, EndOf(attempt.loop, driver.info().joints), &attempt);
  return attempt;
}

// How the arm was away before the rollout began, and whether it is tried again.
struct Setbacks {
  const int most;
  std::vector<std::string> lines = {};

  // Ok: once more, with what is said to whoever listens; else what the attempt failed with, and which one it
  // was.
  Status Next(const Status& failed, bool may_go_on, const char* note, const RolloutInput& input,
              const ProgressFn& progress) {
    lines.push_back(failed.message());
    const std::string count = std::to_string(lines.size()) + " of " + std::to_string(most);
    if (!may_go_on || static_cast<int>(lines.size()) >= most)
      return Status(failed.code(), failed.message() + " (attempt " + count + ")");
    spdlog::warn("{}, attempt {}: {}", note, count, failed.message());
    if (progress) progress({"rollout", 0.0, input.plan.spec.duration_s, note});
    return Status::Ok();
  }
};

Status ConnectUntilThere(Driver& driver, const RolloutInput& input, Setbacks* setbacks,
                         const ProgressFn& progress, const CancelToken& stop) {
  while (true) {
    const Status connected = driver.Connect(input.config.connect_timeout_s);
    if (!IsOutage(connected)) return connected;
    RG_RETURN_IF_ERROR(setbacks->Next(connected.WithPrefix("connecting"), !stop.cancelled(),
                                      "the arm was away: connecting again", input, progress));
    for (double waited = 0.0; waited < kAway && !stop.cancelled(); waited += kLook) Pause(driver, kLook);
  }
}

// An arm that was away before the rollout's first torque is stopped, and prepared again when it is back. A
// rollout that began is not begun again.
Attempt TryUntilItBegins(Driver& driver, ArmModel& arm, const RolloutInput& input, Spool& spool,
                         Setbacks* setbacks, const ProgressFn& progress, const CancelToken& stop,
                         const Clock& clock) {
  while (true) {
    Attempt attempt = TryRollout(driver, arm, input, spool, setbacks->lines, progress, stop, clock);
    if (attempt.failed.ok() || !attempt.away) return attempt;
    attempt.failed = setbacks->Next(attempt.failed, attempt.stop.confirmed && !stop.cancelled(),
                                    "the arm was away: prepared again", input, progress);
    if (!attempt.failed.ok()) return attempt;
  }
}

}  // namespace

Eigen::VectorXd ToEigen(const std::vector<double>& x) {
  return Eigen::Map<const Eigen::VectorXd>(x.data(), static_cast<Eigen::Index>(x.size()));
}

Result<RolloutPlan> PlanRollout(const rollouts::RolloutSpec& spec, const AgentConfig& config,
                                const sim::Plant& plant, double trust) {
  RG_RETURN_IF_ERROR(rollouts::CheckSpec(spec));
  RG_RETURN_IF_ERROR(CheckMost("rate_hz", spec.rate_hz, config.max_rate_hz));
  RG_RETURN_IF_ERROR(CheckMost("duration_s", spec.duration_s, config.max_duration_s));
  const model::RobotModel& model = plant.model();
  const int n = plant.num_joints();
  RolloutPlan plan{.spec = spec, .limits = {}, .trust = trust};
  const double speed = config.first_rollouts.SpeedOf(trust);
  plan.spec.duration_s = config.first_rollouts.DurationOf(spec.duration_s, trust);
  if (plan.spec.excitation < 0) plan.spec.excitation = config.excitation;
  if (plan.spec.start.size() == 0) plan.spec.start = ToEigen(config.start_pose);
  RG_RETURN_IF_ERROR(CheckSize("start", plan.spec.start, n));
  RG_ASSIGN_OR_RETURN(plan.limits, LimitsFor(config, model, ToVector(plan.spec.start)));
  for (double& limit : plan.limits.velocity) limit *= speed;
  if (plan.spec.goal.size() == 0 && plan.spec.goal_position.size() == 3) {
    RG_ASSIGN_OR_RETURN(plan.spec.goal, GoalByInverseKinematics(plant, plan.spec));
  } else if (plan.spec.goal.size() == 0) {
    Rng rng(spec.goal_seed);
    plan.spec.goal = rollouts::SampleGoal(model, plan.spec.start, ToEigen(plan.limits.lower),
                                          ToEigen(plan.limits.upper), speed * spec.goal_reach_s, rng);
  }
  RG_RETURN_IF_ERROR(CheckSize("goal", plan.spec.goal, n));
  RG_RETURN_IF_ERROR(CheckInBox(model, plan.limits, plan.spec.goal));
  return plan;
}

Result<RolloutResult> RunRollout(Driver& driver, const RolloutInput& input, Spool& spool,
                                 const ProgressFn& progress, const CancelToken& stop, const Clock& clock) {
  const std::string& id = input.plan.spec.id;
  RG_RETURN_IF_ERROR(rollouts::CheckSpec(input.plan.spec));
  if (const auto path = spool.FinishedPath(id)) return AlreadyThere(*path, input);
  RG_RETURN_IF_ERROR(CheckNeverBegun(spool, id));
  const int n = input.plant.num_joints();
  RG_RETURN_IF_ERROR(CheckRoom(spool, input, n));
  Latch latch(spool.folder());
  RG_RETURN_IF_ERROR(CheckLatch(latch, input.config));
  Setbacks setbacks{.most = input.config.start_attempts};
  RG_RETURN_IF_ERROR(ConnectUntilThere(driver, input, &setbacks, progress, stop));
  RG_RETURN_IF_ERROR(CheckJoints(driver.info(), input.plant));
  RG_RETURN_IF_ERROR(CheckRate(driver.info(), input.plan.spec));
  OwnArm arm(*input.config.arm, Eigen::Map<const Eigen::Vector3d>(input.config.gravity.data()),
             input.config.parts);
  if (stop.cancelled()) return CancelledError("stopped before the rollout began");
  if (input.config.dry_run) return DryRun(driver, arm, input, spool, stop, clock);
  RG_RETURN_IF_ERROR(latch.BeginMotion(id, FormatWallTime(clock.WallNanos())));
  const Attempt attempt = TryUntilItBegins(driver, arm, input, spool, &setbacks, progress, stop, clock);
  CloseLatch(latch, attempt.stop, id, clock);
  if (!attempt.failed.ok()) return attempt.failed;
  const ControlLoopResult& loop = attempt.loop;
  const Status recorded = attempt.recorder->Finish(EndOf(loop, driver.info().joints));
  if (!recorded.ok()) spdlog::error("recording {}: {}", id, recorded.ToString());

  RG_ASSIGN_OR_RETURN(const RawRecording raw, ReadRawRecording(spool.ActivePath(id)));
  RG_ASSIGN_OR_RETURN(const FinishedRollout finished, FinishRollout(raw));
  std::string bundle = rollouts::PackBundle(finished.bundle);
  RG_RETURN_IF_ERROR(spool.Commit(id, bundle));
  RolloutResult result = ResultOf(finished, std::move(bundle), spool.ReadyPath(id), input);
  result.jitter = loop.jitter;
  if (progress)
    progress(
        {"rollout", loop.duration_s, input.plan.spec.duration_s, std::string(EndReasonName(result.reason))});
  return result;
}

}  // namespace rg::robot_agent
