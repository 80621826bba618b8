// Gauss-Newton multiple shooting (GNMS).
//
// States and controls of all knots are the unknowns; one iteration is
//   1. linearise  Φ_k and the cost at every knot, with the defects d_k = Φ_k(x_k, u_k) − x_{k+1};
//   2. solve      the linear-quadratic problem by a Riccati recursion, defects in its affine term,
//                 boxes on u exact, boxes on x through an augmented Lagrangian (lq_solver.h);
//   3. search     along the step with the merit J + augmented Lagrangian + Σ μ·|d|, where μ exceeds the
//                 costates; the full step is tried together with its linearisation, so that an
//                 iteration usually costs one pass over the knots;
//   4. update     the multipliers of the state boxes after full steps; raise their weight while a
//                 violation does not fall.
// The initial condition is one more defect: after Shift() the old linearisation is used again and only
// the last knot is new, which makes one warm iteration of a receding horizon as cheap as step 2 + 3.
//
// Controls satisfy their box in every iterate (a step ends inside, and the box is convex). Boxes on the
// states hold to `box_tolerance`; a caller that needs them exactly gives the problem tighter ones.
//
// Ref: Giftthaler, Neunert, Stäuble, Buchli, Diehl, "A Family of Iterative Gauss-Newton Shooting Methods
// for Nonlinear Optimal Control", IROS 2018; Tassa, Mansard, Todorov, ICRA 2014 (control limits);
// Nocedal & Wright, 2nd ed., sections 17.4 (augmented Lagrangian), 18.3 (exact ℓ1 merit).
// One solver per thread. Memory is allocated by the constructor only, but for the text of a failure.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/clock.h"
#include "services/trajectories/control_problem.h"
#include "services/trajectories/lq_solver.h"

namespace rg::trajectories {

struct GnmsOptions {
  int max_iterations = 60;
  // So many more while a defect is above `usable_defect`: a receding horizon with few iterations per
  // interval then takes its time where the plan is not yet a motion (at kinks of Φ).
  int extra_iterations = 0;
  double usable_defect = 1e-2;
  // Converged when max|δx|, max|δu|/(1 + max|u|) and every defect are below these; x in its units.
  double step_tolerance = 1e-6;
  double defect_tolerance = 1e-7;
  // Also converged, with closed defects and boxes, when the merit's predicted decrease is below this share
  // of the merit; at a kink of Φ (dry friction) steps do not vanish. 0: never.
  double decrease_tolerance = 0.0;
  double box_tolerance = 1e-4;

  // Sufficient decrease, as in Nocedal & Wright 3.4; step lengths are shrink^i ≥ min_step.
  double armijo = 1e-4;
  double shrink = 0.5;
  double min_step = 1.0 / 128;

  // Weight of the state boxes: `box_penalty` × the largest curvature of the cost to go in that state
  // (Nocedal & Wright 17.4 only ask for "large"; with 100 a multiplier step leaves about 1 % of a
  // violation, and on the Mico² more gains nothing), raised by `box_penalty_growth` up to
  // `box_penalty_max` × the same.
  double box_penalty = 100.0;
  double box_penalty_growth = 10.0;
  double box_penalty_max = 1e6;

  // Levenberg-Marquardt term on δu, relative to the mean diagonal of the cost's R; used only after a failed
  // search or a step not longer than `short_step`.
  double short_step = 0.5;
  double regularization_first = 1e-3;
  double regularization_max = 1e6;

  // 0: none. Otherwise no iteration is started that would end later, judged by the slowest so far.
  double time_budget_s = 0.0;
};

enum class Termination {
  kConverged,
  kMaxIterations,  // the iterate is usable, its defects are in the summary
  kTimeBudget,     // the same
  kStalled,        // no step decreases the merit
  kInfeasible,     // stationary, but a state box or the dynamics cannot be met
  kNonFinite,      // the guess or every trial step leaves the finite numbers
};
std::string_view TerminationName(Termination termination);

struct GnmsIteration {
  double cost = 0.0;
  double merit = 0.0;
  double max_defect = 0.0;
  double max_violation = 0.0;
  double step_x = 0.0;  // max |δx|
  double step_u = 0.0;  // max |δu|
  double step_length = 0.0;
  double regularization = 0.0;
  int sweeps = 0;
  bool exact = false;  // the linear-quadratic problem was solved exactly
};

struct GnmsSummary {
  Termination termination = Termination::kMaxIterations;
  int iterations = 0;  // linear-quadratic problems solved
  int passes = 0;      // passes over all knots, with or without derivatives
  int sweeps = 0;      // Riccati sweeps
  double cost = 0.0;
  double max_defect = 0.0;     // max |Φ_k(x_k, u_k) − x_{k+1}|, initial condition included
  double max_violation = 0.0;  // of the state boxes, knots 1 … N
  int worst_knot = -1;         // of the violation, or where a step was not finite
  int worst_state = -1;
  std::string message;  // empty when converged

  bool converged() const { return termination == Termination::kConverged; }
};

class GnmsSolver {
 public:
  // `problem` must outlive the solver. `clock` is read only when options.time_budget_s > 0.
  GnmsSolver(ControlProblem& problem, const GnmsOptions& options, const Clock* clock = nullptr);

  const GnmsOptions& options() const { return options_; }
  // The only option that a receding horizon changes between calls.
  void set_max_iterations(int iterations);

  // x: nx × (knots + 1), u: nu × knots (clamped into its box). The states need not satisfy the dynamics.
  // Forgets multipliers, active sets and linearisation.
  void SetGuess(const MatIn& x, const MatIn& u);
  // The solution moves one knot ahead, the last control is repeated. For problems whose Φ_k and costs do
  // not depend on k. Keeps multipliers, active sets and the linearisation of knots that stay.
  void Shift();
  // The problem's cost may change at any time; after a change of Φ call this.
  void ForgetLinearization();

  // From x0 (nx × 1) and the present guess or solution.
  GnmsSummary Solve(const VecIn& x0);

  using ConstVec = Eigen::Map<const Eigen::VectorXd>;
  ConstVec x(int k) const { return ConstVec(&current_.x[static_cast<size_t>(k) * nx_], nx_); }
  ConstVec u(int k) const { return ConstVec(&current_.u[static_cast<size_t>(k) * nu_], nu_); }
  // Φ_0 at the plan's first knot, and ∂Φ_0/∂u of its last linearisation, nx × nu.
  ConstVec predicted() const { return ConstVec(current_.phi.data(), nx_); }
  LqSolver::ConstMat input_matrix() const { return LqSolver::ConstMat(current_.b.data(), nx_, nu_); }
  // Feedback gain of the last linear-quadratic problem, nu × nx.
  LqSolver::ConstMat gain(int k) const { return lq_.gain(k); }
  const std::vector<GnmsIteration>& history() const { return history_; }

 private:
  // States, controls and what a pass over the knots makes of them.
  struct Shooting {
    std::vector<double> x, u, phi, a, b;
    double cost = 0.0;
    int linearized_from = 0;  // knots below this one have valid phi, a, b
  };
  enum class Search { kAccepted, kFailed, kNonFinite };

  bool LinearizeGuess(const VecIn& x0, GnmsSummary* summary);
  bool Iterate(const VecIn& x0, GnmsSummary* summary);
  bool SolveModel(const VecIn& x0, GnmsSummary* summary, GnmsIteration* record);
  bool FinishOrTighten(const VecIn& x0, GnmsSummary* summary);
  bool Linearize(Shooting& it, int from);
  bool Evaluate(Shooting& it);
  bool TerminalAndFinite(Shooting& it);
  void BuildLq(const VecIn& x0);
  bool SetBoxWeights(GnmsSummary* summary);
  void BuildBoxes();
  bool SolveLq(GnmsSummary* summary, GnmsIteration* record);
  double UpdateMeritWeights(const VecIn& x0);
  double Merit(const Shooting& it, const VecIn& x0) const;
  double BoxTerm(const Shooting& it) const;
  void MeasureStep(GnmsIteration* record) const;
  bool StepIsSmall(const GnmsIteration& record, double slope, double merit) const;
  void MakeTrial(double step_length);
  Search LineSearch(const VecIn& x0, double slope, double merit, GnmsSummary* summary, GnmsIteration* record);
  void RaiseRegularization();
  void AdaptRegularization(double step_length);
  bool TightenBoxes(bool stationary);
  void UpdateMultipliers();
  void MeasureDefects(const VecIn& x0, GnmsSummary* summary) const;
  void MeasureViolation(GnmsSummary* summary) const;
  bool IterationsLeft(const VecIn& x0, const GnmsSummary& summary) const;
  bool OutOfTime(double started, double slowest) const;
  double Now() const;
  void Finish(Termination termination, const VecIn& x0, std::string message, GnmsSummary* summary) const;

  ControlProblem& problem_;
  GnmsOptions options_;
  const Clock* clock_;
  int nx_, nu_, n_;
  Shooting current_, trial_;
  LqSolver lq_;
  std::vector<double> multiplier_;  // (knots + 1) × nx of the state boxes
  Eigen::VectorXd rho_;             // nx
  Eigen::VectorXd rho_unit_;        // nx: weight for box_penalty = 1; empty until known
  Eigen::VectorXd merit_weight_;    // nx: μ
  double regularization_ = 0.0;
  double last_violation_ = 0.0;
  std::vector<GnmsIteration> history_;
};

}  // namespace rg::trajectories
