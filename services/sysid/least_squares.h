// The paper's least-squares problem (its equation 2) and its two solvers, on any residual function.
//
//   cost(p) = Σ_k r_k(p)²  +  Σ_i α_i (p_i − p_init,i)²
//
// Solvers, both through Ceres: bounded trust-region Levenberg-Marquardt, unbounded line-search L-BFGS.
// Parameters that have no effect on r, and parameters whose lower bound equals their upper (a link
// without inertia, ±20 % of zero), stay where they are and break nothing.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>
#include <string_view>

#include "services/sysid/stop_condition.h"

namespace rg::sysid {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// r(p) and its Jacobian. Not thread-safe: one per chain.
class ResidualFunction {
 public:
  virtual ~ResidualFunction() = default;
  virtual int num_parameters() const = 0;
  virtual int num_residuals() const = 0;
  // r: num_residuals; J (or null): num_residuals × num_parameters, dr_dp. Both have their size on
  // entry. False: not finite at p, or `stop` struck on the way; r and J are then undefined.
  virtual bool Evaluate(const Eigen::VectorXd& p, const StopCondition& stop, Eigen::VectorXd* r,
                        RowMatrix* dr_dp) = 0;
};

// All vectors have num_parameters entries.
struct LeastSquaresProblem {
  ResidualFunction* residuals = nullptr;  // not owned
  Eigen::VectorXd initial;                // p_init, centre of the regulariser
  Eigen::VectorXd lower, upper;           // box of the bounded solver; ±infinity where there is none
  Eigen::VectorXd alpha;                  // α ≥ 0
  Eigen::VectorXd scale;                  // > 0, a typical change of each parameter: the solvers' unit
  // Where global search draws starts from and how far it steps (the paper: "within user-set ranges").
  Eigen::VectorXd search_lower, search_upper;
};

// Sizes agree, lower ≤ upper, α ≥ 0, scale > 0, everything finite that must be. A bug otherwise.
void CheckProblem(const LeastSquaresProblem& problem);

enum class Solver { kBoundedLevenbergMarquardt, kUnboundedLbfgs };

struct SolveOptions {
  Solver solver = Solver::kBoundedLevenbergMarquardt;
  int max_iterations = 100;
  double function_tolerance = 1e-9;    // |Δcost| < function_tolerance · cost
  double gradient_tolerance = 1e-12;   // max |gradient| in scaled units
  double parameter_tolerance = 1e-10;  // |Δy| < parameter_tolerance · (|y| + parameter_tolerance)
};

enum class Termination { kConverged, kMaxIterations, kStopped, kFailed };
std::string_view TerminationName(Termination termination);

struct SolveSummary {
  Eigen::VectorXd p;      // the best point seen, also when stopped early
  double cost = 0.0;      // at p, with the regulariser
  double residual = 0.0;  // Σ r² at p
  double start_cost = std::numeric_limits<double>::infinity();  // at the start; infinite: not finite there
  Termination termination = Termination::kFailed;
  std::string message;
  int iterations = 0;
  int evaluations = 0;  // of r, with or without its Jacobian
  int jacobians = 0;    // of these, with
};

// Solves from `start` (clamped into the box by the bounded solver). `stop` is asked in every iteration
// and handed down into every evaluation.
SolveSummary Solve(const LeastSquaresProblem& problem, const Eigen::VectorXd& start,
                   const SolveOptions& options, const StopCondition& stop);

// cost(p); false when r is not finite there.
bool EvaluateCost(const LeastSquaresProblem& problem, const Eigen::VectorXd& p, const StopCondition& stop,
                  double* cost);

}  // namespace rg::sysid
