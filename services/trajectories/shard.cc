#include "services/trajectories/shard.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "common/base/check.h"
#include "common/model/robot_model.h"

namespace rg::trajectories {
namespace {

// A slot that fails this often before any slot succeeded says something about the model.
constexpr int kSlotsBeforeGivingUp = 2;

Status CheckSpec(const ShardSpec& spec) {
  if (spec.count == 0) return InvalidError("shard: count is 0");
  if (spec.max_draws < 1) return InvalidError("shard: max_draws must be ≥ 1");
  if (!(spec.goal_tolerance > 0.0)) return InvalidError("shard: goal_tolerance must be > 0");
  if (!(spec.duration_s > 0.0) || spec.duration_s > 1000.0)
    return InvalidError("shard: duration_s must be in 0 … 1000");
  return Status::Ok();
}

std::optional<Failure> FailureOf(const MpcStatus& status) {
  if (status.ok) return std::nullopt;
  switch (status.termination) {
    case Termination::kNonFinite:
      return Failure::kNonFinite;
    case Termination::kInfeasible:
      return Failure::kInfeasible;
    default:
      return Failure::kSolver;
  }
}

// First joint whose |value| exceeds the limit, or −1.
int Outside(const Eigen::VectorXd& value, const Eigen::VectorXd& low, const Eigen::VectorXd& high) {
  for (int i = 0; i < value.size(); ++i)
    if (!(value[i] >= low[i] && value[i] <= high[i])) return i;
  return -1;
}

Attempt Failed(Failure failure, std::string message) {
  Attempt attempt;
  attempt.failure = failure;
  attempt.message = std::move(message);
  return attempt;
}

class SlotFiller {
 public:
  SlotFiller(const ShardSpec& spec, MpcController& controller, StartGoalSampler sampler)
      : spec_(spec),
        controller_(controller),
        sampler_(std::move(sampler)),
        root_(spec.seed),
        intervals_(std::max(1, static_cast<int>(std::lround(spec.duration_s / spec.mpc.interval_s)))),
        tolerance_(spec.goal_tolerance) {}

  // The first good draw of a slot. Counts the others in `shard`.
  bool Fill(uint64_t slot, const CancelToken* cancel, Shard* shard) {
    const Rng stream = root_.Split(slot);
    for (int draw = 0; draw < spec_.max_draws; ++draw) {
      if (cancel != nullptr && cancel->cancelled()) return false;
      Rng rng = stream.Split(draw);
      const auto pair = sampler_.Draw(rng);
      Attempt attempt = pair ? RunRecedingHorizon(controller_, *pair, intervals_, tolerance_)
                             : Failed(Failure::kSampling, "no pose is high enough");
      if (!attempt.good) {
        ++shard->failures[static_cast<int>(attempt.failure)];
        last_message_ = std::move(attempt.message);
        continue;
      }
      attempt.trajectory.slot = slot;
      attempt.trajectory.draw = draw;
      AsMeasured(controller_.encoder_offset(), &attempt.trajectory);
      shard->trajectories.push_back(std::move(attempt.trajectory));
      return true;
    }
    shard->unfilled.push_back(slot);
    return true;
  }

  const std::string& last_message() const { return last_message_; }

 private:
  const ShardSpec& spec_;
  MpcController& controller_;
  StartGoalSampler sampler_;
  Rng root_;
  int intervals_;
  double tolerance_;
  std::string last_message_;
};

}  // namespace

std::string_view FailureName(Failure failure) {
  constexpr std::array<std::string_view, kFailureKinds> kNames = {
      "sampling", "infeasible", "non_finite", "solver", "goal_not_reached", "joint_box", "torque_box"};
  return kNames[static_cast<int>(failure)];
}

uint64_t Shard::num_failures() const {
  uint64_t sum = 0;
  for (uint64_t count : failures) sum += count;
  return sum;
}

int Shard::num_samples() const {
  int sum = 0;
  for (const Trajectory& t : trajectories) sum += t.num_samples();
  return sum;
}

std::string Shard::FailureSummary() const {
  std::string text;
  for (int i = 0; i < kFailureKinds; ++i) {
    if (failures[i] == 0) continue;
    if (!text.empty()) text += ", ";
    text += std::string(FailureName(static_cast<Failure>(i))) + " " + std::to_string(failures[i]);
  }
  return text.empty() ? "none" : text;
}

void AsMeasured(const Eigen::VectorXd& encoder_offset, Trajectory* t) {
  t->q.colwise() += encoder_offset;
  t->final_q += encoder_offset;
  t->goal += encoder_offset;
}

Attempt RunRecedingHorizon(MpcController& controller, const StartGoal& draw, int intervals,
                           double goal_tolerance) {
  const int n = controller.num_joints();
  const MotionLimits& limits = controller.limits();
  const model::RobotModel& model = controller.simulator().plant().model();
  const double interval = controller.options().interval_s;
  auto joint = [&model](int i) { return model.joint(i).name; };

  int worst = Outside(draw.goal, limits.position_lower, limits.position_upper);
  if (worst >= 0) return Failed(Failure::kInfeasible, "the goal is outside the limits of " + joint(worst));
  worst = Outside(draw.q, limits.position_lower, limits.position_upper);
  if (worst >= 0) return Failed(Failure::kInfeasible, "the start is outside the limits of " + joint(worst));
  for (const Eigen::VectorXd* pose : {&draw.q, &draw.goal}) {
    Eigen::VectorXd hold;
    if (!std::isfinite(HoldTorque(controller.simulator(), *pose, &hold)))
      return Failed(Failure::kNonFinite, "no acceleration at start or goal");
    worst = Outside(hold, -limits.torque, limits.torque);
    if (worst >= 0)
      return Failed(Failure::kInfeasible, "holding start or goal needs " + std::to_string(hold[worst]) +
                                              " N·m at " + joint(worst) + ", limit " +
                                              std::to_string(limits.torque[worst]));
  }

  Attempt attempt;
  Trajectory& t = attempt.trajectory;
  t.goal = draw.goal;
  t.q.resize(n, intervals);
  t.v.resize(n, intervals);
  t.torque.resize(n, intervals);
  controller.Reset();
  sim::State state = controller.simulator().MakeState(draw.q, draw.v);
  Eigen::VectorXd u(n);
  for (int k = 0; k < intervals; ++k) {
    const MpcStatus status = controller.Solve(state, draw.goal, &u);
    t.iterations += status.iterations;
    if (const auto failure = FailureOf(status))
      return Failed(*failure, "interval " + std::to_string(k) + ": " + status.message);
    t.q.col(k) = state.q;
    t.v.col(k) = state.v;
    t.torque.col(k) = u;
    const sim::Outcome outcome = controller.simulator().Advance(state, u, interval);
    if (!outcome.ok()) return Failed(Failure::kNonFinite, outcome.ToString());
    if (Outside(u, -limits.torque, limits.torque) >= 0) return Failed(Failure::kTorqueBox, "torque box");
    worst = Outside(state.q, limits.position_lower, limits.position_upper);
    if (worst >= 0) return Failed(Failure::kJointBox, "position of " + joint(worst));
    worst = Outside(state.v, -limits.velocity, limits.velocity);
    if (worst >= 0) return Failed(Failure::kJointBox, "velocity of " + joint(worst));
  }
  t.final_q = state.q;
  t.final_v = state.v;
  t.goal_error = (t.final_q - t.goal).lpNorm<Eigen::Infinity>();
  if (!(t.goal_error <= goal_tolerance)) {
    attempt.failure = Failure::kGoalNotReached;
    attempt.message = "goal missed by " + std::to_string(t.goal_error);
    return attempt;
  }
  attempt.good = true;
  return attempt;
}

Result<Shard> GenerateShard(const sim::Plant& plant, const Eigen::VectorXd& values, const ShardSpec& spec,
                            const ProgressFn& progress, const CancelToken* cancel) {
  RG_RETURN_IF_ERROR(CheckSpec(spec));
  if (spec.mpc.time_budget_s > 0.0)
    return InvalidError("shard: mpc.time_budget_s would make trajectories depend on the host");
  RG_ASSIGN_OR_RETURN(auto controller, MpcController::Create(plant, values, spec.mpc));
  RG_ASSIGN_OR_RETURN(auto sampler, StartGoalSampler::Create(plant.model(), controller->limits(),
                                                             spec.duration_s, spec.sampling));
  Shard shard;
  shard.seed = spec.seed;
  shard.first = spec.first;
  shard.count = spec.count;
  shard.interval_s = spec.mpc.interval_s;
  shard.joints = plant.joint_names();
  shard.trajectories.reserve(spec.count);
  SlotFiller filler(spec, *controller, std::move(sampler));
  for (uint32_t i = 0; i < spec.count; ++i) {
    if (!filler.Fill(spec.first + i, cancel, &shard)) return CancelledError("trajectories: cancelled");
    if (shard.trajectories.empty() && shard.unfilled.size() >= kSlotsBeforeGivingUp)
      return FailedPreconditionError("trajectories: none of " + std::to_string(shard.num_failures()) +
                                     " draws succeeded (" + shard.FailureSummary() +
                                     "); last: " + filler.last_message());
    if (progress)
      progress({"trajectories", static_cast<double>(i + 1), static_cast<double>(spec.count),
                "failed draws: " + shard.FailureSummary()});
  }
  return shard;
}

}  // namespace rg::trajectories
