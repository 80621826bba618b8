#include "services/trajectories/aggregation.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/check.h"

namespace rg::trajectories {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

int Intervals(const ShardSpec& spec) {
  return std::max(1, static_cast<int>(std::lround(spec.duration_s / spec.mpc.interval_s)));
}

double GoalError(const sim::State& state, const Eigen::VectorXd& goal) {
  const double error = (state.q - goal).lpNorm<Eigen::Infinity>();
  return std::isfinite(error) ? error : kNaN;
}

// Largest excess over a limit as a share of that limit's range.
double Excess(const sim::State& state, const MotionLimits& limits) {
  double most = 0;
  for (Eigen::Index i = 0; i < state.q.size(); ++i) {
    const double range = limits.position_upper[i] - limits.position_lower[i];
    if (std::isfinite(range)) {
      most = std::max({most, (limits.position_lower[i] - state.q[i]) / range,
                       (state.q[i] - limits.position_upper[i]) / range});
    }
    most = std::max(most, std::abs(state.v[i]) / limits.velocity[i] - 1.0);
  }
  return most;
}

bool Drive(const Learner& learner, const MotionLimits& limits, const Eigen::VectorXd& goal, double interval,
           sim::Simulator& simulator, sim::State* state, Eigen::VectorXd* u) {
  if (!learner(state->q, state->v, goal, u) || !u->allFinite()) return false;
  *u = u->cwiseMin(limits.torque).cwiseMax(-limits.torque);
  return simulator.Advance(*state, *u, interval).ok();
}

// The learner is told what encoders say; the loop runs in true positions.
Learner Measured(const MpcController& controller, const Learner& learner) {
  return [&learner, offset = controller.encoder_offset(), q_read = Eigen::VectorXd(),
          goal_read = Eigen::VectorXd()](const Eigen::VectorXd& q, const Eigen::VectorXd& v,
                                         const Eigen::VectorXd& goal, Eigen::VectorXd* effort) mutable {
    q_read = q + offset;
    goal_read = goal + offset;
    return learner(q_read, v, goal_read, effort);
  };
}

class Loop {
 public:
  Loop(MpcController& controller, const ShardSpec& spec, const Learner& learner)
      : controller_(controller), learner_(Measured(controller, learner)), intervals_(Intervals(spec)) {}

  // The learner alone.
  double LearnerError(const StartGoal& pair) {
    sim::Simulator& simulator = controller_.simulator();
    sim::State state = simulator.MakeState(pair.q, pair.v);
    Eigen::VectorXd u(pair.q.size());
    for (int k = 0; k < intervals_; ++k) {
      if (!Drive(learner_, controller_.limits(), pair.goal, controller_.options().interval_s, simulator,
                 &state, &u))
        return kNaN;
    }
    return GoalError(state, pair.goal);
  }

  double MpcError(const StartGoal& pair) {
    const Attempt attempt =
        RunRecedingHorizon(controller_, pair, intervals_, std::numeric_limits<double>::infinity());
    return attempt.good ? attempt.trajectory.goal_error : kNaN;
  }

  // Labelled states; `failure` is set when the loop ended early.
  Trajectory Label(const StartGoal& pair, const AggregationSpec& spec, Rng rng,
                   std::optional<Failure>* failure) {
    const int n = static_cast<int>(pair.q.size());
    Trajectory t;
    t.goal = pair.goal;
    const int intervals = intervals_ + static_cast<int>(std::lround(spec.hold_s / controller_.options().interval_s));
    t.q.resize(n, intervals), t.v.resize(n, intervals), t.torque.resize(n, intervals);
    t.goal_error = kNaN;
    controller_.Reset();
    sim::State state = controller_.simulator().MakeState(pair.q, pair.v);
    Eigen::VectorXd expert(n), u(n);
    const Learner told = [&expert](const auto&, const auto&, const auto&, Eigen::VectorXd* effort) {
      *effort = expert;
      return true;
    };
    int k = 0;
    for (; k < intervals; ++k) {
      const MpcStatus status = controller_.Solve(state, pair.goal, &expert);
      t.iterations += static_cast<uint32_t>(status.iterations);
      if (!status.ok) {
        *failure = status.termination == Termination::kInfeasible  ? Failure::kInfeasible
                   : status.termination == Termination::kNonFinite ? Failure::kNonFinite
                                                                   : Failure::kSolver;
        break;
      }
      t.q.col(k) = state.q, t.v.col(k) = state.v, t.torque.col(k) = expert;
      const bool by_expert = rng.Uniform() < spec.expert_share;
      if (!Drive(by_expert ? told : learner_, controller_.limits(), pair.goal,
                 controller_.options().interval_s, controller_.simulator(), &state, &u)) {
        *failure = Failure::kNonFinite;
        ++k;
        break;
      }
      if (Excess(state, controller_.limits()) > spec.tolerated_excess) {
        *failure = Failure::kJointBox;
        ++k;
        break;
      }
    }
    t.q.conservativeResize(n, k), t.v.conservativeResize(n, k), t.torque.conservativeResize(n, k);
    t.final_q = state.q, t.final_v = state.v;
    if (!*failure) t.goal_error = GoalError(state, pair.goal);
    return t;
  }

 private:
  MpcController& controller_;
  const Learner learner_;
  int intervals_;
};

struct Setup {
  std::unique_ptr<MpcController> controller;
  std::optional<StartGoalSampler> sampler;
};

Result<Setup> MakeSetup(const sim::Plant& plant, const Eigen::VectorXd& values, const ShardSpec& spec) {
  if (spec.count == 0) return InvalidError("shard: count is 0");
  if (!(spec.duration_s > 0.0)) return InvalidError("shard: duration_s must be > 0");
  Setup setup;
  RG_ASSIGN_OR_RETURN(setup.controller, MpcController::Create(plant, values, spec.mpc));
  RG_ASSIGN_OR_RETURN(auto sampler, StartGoalSampler::Create(plant.model(), setup.controller->limits(),
                                                             spec.duration_s, spec.sampling));
  setup.sampler.emplace(std::move(sampler));
  return setup;
}

std::optional<StartGoal> DrawPair(Setup& setup, const ShardSpec& spec, uint32_t i) {
  Rng rng = Rng(spec.seed).Split(spec.first + i).Split(0);
  return setup.sampler->Draw(rng);
}

}  // namespace

Result<Shard> AggregateShard(const sim::Plant& plant, const Eigen::VectorXd& values,
                             const AggregationSpec& aggregation, const Learner& learner,
                             const ProgressFn& progress, const CancelToken* cancel) {
  const ShardSpec& spec = aggregation.shard;
  RG_ASSIGN_OR_RETURN(Setup setup, MakeSetup(plant, values, spec));
  Loop loop(*setup.controller, spec, learner);
  Shard shard;
  shard.seed = spec.seed, shard.first = spec.first, shard.count = spec.count;
  shard.interval_s = spec.mpc.interval_s;
  shard.joints = plant.joint_names();
  for (uint32_t i = 0; i < spec.count; ++i) {
    if (cancel != nullptr && cancel->cancelled()) return CancelledError("aggregation: cancelled");
    std::optional<Failure> failure;
    Trajectory t;
    if (const auto pair = DrawPair(setup, spec, i)) {
      t = loop.Label(*pair, aggregation, Rng(spec.seed).Split(spec.first + i).Split(1), &failure);
    } else {
      failure = Failure::kSampling;
    }
    if (failure) ++shard.failures[static_cast<size_t>(*failure)];
    t.slot = spec.first + i;
    if (t.num_samples() > 0) {
      AsMeasured(setup.controller->encoder_offset(), &t);
      shard.trajectories.push_back(std::move(t));
    } else {
      shard.unfilled.push_back(spec.first + i);
    }
    if (progress) {
      progress({"aggregation", static_cast<double>(i + 1), static_cast<double>(spec.count),
                "ended early: " + shard.FailureSummary()});
    }
  }
  return shard;
}

Result<Examination> Examine(const sim::Plant& plant, const Eigen::VectorXd& values, const ShardSpec& spec,
                            const Learner& learner, const ProgressFn& progress, const CancelToken* cancel) {
  RG_ASSIGN_OR_RETURN(Setup setup, MakeSetup(plant, values, spec));
  Loop loop(*setup.controller, spec, learner);
  Examination out;
  for (uint32_t i = 0; i < spec.count; ++i) {
    if (cancel != nullptr && cancel->cancelled()) return CancelledError("examination: cancelled");
    const auto pair = DrawPair(setup, spec, i);
    if (!pair) continue;
    out.learner.push_back(loop.LearnerError(*pair));
    out.mpc.push_back(loop.MpcError(*pair));
    if (progress) progress({"examination", static_cast<double>(i + 1), static_cast<double>(spec.count), ""});
  }
  return out;
}

int Examination::Diverged(const std::vector<double>& errors) {
  return static_cast<int>(std::ranges::count_if(errors, [](double e) { return !(std::abs(e) < kDivergedError); }));
}

bool Examination::Passed() const {
  if (pairs() == 0 || diverged() > 0) return false;
  const auto good = [this](double share) {
    return Quantile(learner, share) <= kGoodOverMpc * Quantile(mpc, share);
  };
  return good(0.5) && good(0.9);
}

double Quantile(std::vector<double> errors, double share) {
  RG_CHECK(!errors.empty());
  for (double& e : errors) e = std::isnan(e) ? std::numeric_limits<double>::infinity() : std::abs(e);
  std::sort(errors.begin(), errors.end());
  const double at = share * static_cast<double>(errors.size() - 1);
  const auto low = static_cast<size_t>(at);
  const size_t high = std::min(low + 1, errors.size() - 1);
  return errors[low] == errors[high]
             ? errors[low]
             : errors[low] + (at - static_cast<double>(low)) * (errors[high] - errors[low]);
}

}  // namespace rg::trajectories
