// What the expert would do where the learner goes: closed loops of a learner, answered by the MPC.
//
// A policy regressed on the expert's own trajectories sees only states that the expert visits; its errors
// carry it elsewhere and add up. Here the learner drives (in the simulator, under the planning model) and the
// MPC says at every state what it would have done; training on both is dataset aggregation (Ross, Gordon &
// Bagnell 2011). The same loop without labels is the examination of a policy: its goal error beside MPC's.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "services/trajectories/shard.h"

namespace rg::trajectories {

// Effort (n) for a state and a goal (n each); false: no answer, the loop ends there. Efforts are clipped to
// the torque box.
using Learner = std::function<bool(const Eigen::VectorXd& q, const Eigen::VectorXd& v,
                                   const Eigen::VectorXd& goal, Eigen::VectorXd* effort)>;

// Slots as GenerateShard has them, one draw each, driven by `learner` for duration_s and hold_s. A trajectory holds
// the states visited and the MPC's efforts there; it ends early where MPC has no usable plan, where the
// learner or the model fails, or where the arm is further outside a position or velocity limit than
// `tolerated_excess` of that limit's range (the expert cannot show the way back from there). goal_error is
// what the learner reached; NaN if it did not come to the end. Failures are counted by reason, slots without
// a single sample are `unfilled`. Deterministic as GenerateShard is.
struct AggregationSpec {
  ShardSpec shard;
  double tolerated_excess = 1.0;
  double expert_share = 0.0;  // of the intervals (drawn by seed) in which the expert's answer is applied
  double hold_s = 0.0;        // beyond shard.duration_s: a policy has to hold the goal too, longer than it moves
};
Result<Shard> AggregateShard(const sim::Plant& plant, const Eigen::VectorXd& values,
                             const AggregationSpec& spec, const Learner& learner,
                             const ProgressFn& progress = {}, const CancelToken* cancel = nullptr);

// Farther from its goal than this [rad or m], more than pairs at the default reach are apart, a loop diverged.
inline constexpr double kDivergedError = 1.0;
// Median and 90th percentile of a good learner's errors, over MPC's.
inline constexpr double kGoodOverMpc = 2.0;

// max_i |q_i(T) − goal_i| of learner and MPC from the same starts to the same goals [rad or m]; NaN: did not
// come to the end (left the finite numbers, no plan).
struct Examination {
  std::vector<double> learner, mpc;
  int pairs() const { return static_cast<int>(learner.size()); }
  int diverged() const { return Diverged(learner); }
  // Nothing diverged, median and 90th percentile are at most kGoodOverMpc times MPC's.
  bool Passed() const;
  // Not passed, and at least half of the loops hold, so that more data from where the learner goes can help.
  bool WorthTrainingOn() const { return pairs() > 0 && !Passed() && 2 * diverged() <= pairs(); }

  static int Diverged(const std::vector<double>& errors);
};
Result<Examination> Examine(const sim::Plant& plant, const Eigen::VectorXd& values, const ShardSpec& spec,
                            const Learner& learner, const ProgressFn& progress = {},
                            const CancelToken* cancel = nullptr);

// Of the absolute errors; what did not come to the end counts as infinite.
double Quantile(std::vector<double> errors, double share);

}  // namespace rg::trajectories
