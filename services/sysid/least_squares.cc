#include "services/sysid/least_squares.h"

#include <ceres/ceres.h>
#include <glog/logging.h>

#include <cmath>
#include <limits>
#include <mutex>
#include <vector>

#include "common/base/check.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

// Which parameters the solver may move, and the map y -> p = reference + scale ∘ y.
struct FreeParameters {
  std::vector<int> index;
  VectorXd reference;  // all parameters, at y = 0
  const LeastSquaresProblem* problem;

  VectorXd ToFull(const double* y) const {
    VectorXd p = reference;
    for (size_t k = 0; k < index.size(); ++k) p[index[k]] += problem->scale[index[k]] * y[k];
    return p;
  }
};

FreeParameters ChooseFree(const LeastSquaresProblem& problem, const VectorXd& start, bool bounded) {
  FreeParameters free{{}, start, &problem};
  for (int i = 0; i < start.size(); ++i) {
    if (bounded) free.reference[i] = std::clamp(start[i], problem.lower[i], problem.upper[i]);
    if (problem.lower[i] < problem.upper[i]) free.index.push_back(i);
  }
  return free;
}

// Residuals and regulariser as one Ceres cost of one block, and the best point that passed by.
class TrackingCost final : public ceres::CostFunction {
 public:
  TrackingCost(const FreeParameters& free, const StopCondition& stop)
      : free_(free), problem_(*free.problem), stop_(stop) {
    const int m = problem_.residuals->num_residuals();
    const int n = problem_.residuals->num_parameters();
    r_.resize(m);
    dr_dp_.resize(m, n);
    set_num_residuals(m + static_cast<int>(free_.index.size()));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(free_.index.size()));
    best_.p = free_.reference;
    best_.cost = std::numeric_limits<double>::infinity();
    best_.residual = best_.cost;
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    if (stop_.ShouldStop()) return false;
    const bool with_jacobian = jacobians != nullptr && jacobians[0] != nullptr;
    const VectorXd p = free_.ToFull(parameters[0]);
    if (!EvaluateAt(p, with_jacobian)) return false;
    WriteResiduals(p, residuals);
    if (with_jacobian && !WriteJacobian(jacobians[0])) return false;
    Track(p, residuals);
    return true;
  }

  SolveSummary& best() const { return best_; }

 private:
  // r_ and, if asked for, dr_dp_ at p. The bounded solver asks up to three times at each point: in its search
  // along the projected step, whether the step is good, and for the next one's Jacobian.
  bool EvaluateAt(const VectorXd& p, bool with_jacobian) const {
    if (known_ && p == at_ && (has_jacobian_ || !with_jacobian)) return true;
    ++best_.evaluations;
    best_.jacobians += with_jacobian ? 1 : 0;
    at_ = p;
    has_jacobian_ = with_jacobian;
    known_ = problem_.residuals->Evaluate(p, stop_, &r_, with_jacobian ? &dr_dp_ : nullptr) && r_.allFinite();
    return known_;
  }

  void WriteResiduals(const VectorXd& p, double* out) const {
    const int m = static_cast<int>(r_.size());
    Eigen::Map<VectorXd>(out, m) = r_;
    for (size_t k = 0; k < free_.index.size(); ++k) {
      const int i = free_.index[k];
      out[m + k] = std::sqrt(problem_.alpha[i]) * (p[i] - problem_.initial[i]);
    }
  }

  bool WriteJacobian(double* out) const {
    const int m = static_cast<int>(r_.size());
    const int f = static_cast<int>(free_.index.size());
    Eigen::Map<RowMatrix> J(out, m + f, f);
    for (int k = 0; k < f; ++k)
      J.col(k).head(m) = dr_dp_.col(free_.index[k]) * problem_.scale[free_.index[k]];
    J.bottomRows(f).setZero();
    for (int k = 0; k < f; ++k) {
      J(m + k, k) = std::sqrt(problem_.alpha[free_.index[k]]) * problem_.scale[free_.index[k]];
    }
    return J.allFinite();
  }

  void Track(const VectorXd& p, const double* residuals) const {
    const double cost = Eigen::Map<const VectorXd>(residuals, num_residuals()).squaredNorm();
    if (best_.cost == std::numeric_limits<double>::infinity()) best_.start_cost = cost;
    if (cost >= best_.cost) return;
    best_.p = p;
    best_.cost = cost;
    best_.residual = r_.squaredNorm();
  }

  const FreeParameters& free_;
  const LeastSquaresProblem& problem_;
  const StopCondition& stop_;
  mutable VectorXd r_, at_;
  mutable bool known_ = false, has_jacobian_ = false;  // r_ and dr_dp_ are those at at_
  mutable RowMatrix dr_dp_;
  mutable SolveSummary best_;
};

class StopCallback final : public ceres::IterationCallback {
 public:
  explicit StopCallback(const StopCondition& stop) : stop_(stop) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    return stop_.ShouldStop() ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

 private:
  const StopCondition& stop_;
};

void SetBounds(const FreeParameters& free, double* y, ceres::Problem* ceres_problem) {
  const LeastSquaresProblem& problem = *free.problem;
  for (size_t k = 0; k < free.index.size(); ++k) {
    const int i = free.index[k];
    const double low = (problem.lower[i] - free.reference[i]) / problem.scale[i];
    const double high = (problem.upper[i] - free.reference[i]) / problem.scale[i];
    if (std::isfinite(low)) ceres_problem->SetParameterLowerBound(y, static_cast<int>(k), low);
    if (std::isfinite(high)) ceres_problem->SetParameterUpperBound(y, static_cast<int>(k), high);
  }
}

// Ceres reports evaluations that fail on stderr; here they are outcomes, which the summary carries.
void SilenceCeres() {
  static std::once_flag once;
  std::call_once(once, [] { FLAGS_minloglevel = google::GLOG_FATAL; });
}

ceres::Solver::Options CeresOptions(const SolveOptions& options) {
  ceres::Solver::Options ceres_options;
  if (options.solver == Solver::kBoundedLevenbergMarquardt) {
    ceres_options.minimizer_type = ceres::TRUST_REGION;
    ceres_options.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
    ceres_options.linear_solver_type = ceres::DENSE_QR;
  } else {
    ceres_options.minimizer_type = ceres::LINE_SEARCH;
    ceres_options.line_search_direction_type = ceres::LBFGS;
    ceres_options.line_search_type = ceres::WOLFE;
  }
  ceres_options.max_num_iterations = options.max_iterations;
  ceres_options.function_tolerance = options.function_tolerance;
  ceres_options.gradient_tolerance = options.gradient_tolerance;
  ceres_options.parameter_tolerance = options.parameter_tolerance;
  ceres_options.num_threads = 1;
  ceres_options.logging_type = ceres::SILENT;
  return ceres_options;
}

Termination ToTermination(const ceres::Solver::Summary& summary, bool stopped, bool any_point) {
  if (!any_point) return stopped ? Termination::kStopped : Termination::kFailed;
  if (stopped) return Termination::kStopped;
  switch (summary.termination_type) {
    case ceres::CONVERGENCE:
      return Termination::kConverged;
    case ceres::NO_CONVERGENCE:
      return Termination::kMaxIterations;
    case ceres::USER_SUCCESS:
      return Termination::kStopped;
    default:
      return Termination::kFailed;
  }
}

// Nothing may move: the start is the answer.
SolveSummary SolveWithoutUnknowns(const LeastSquaresProblem& problem, const VectorXd& p,
                                  const StopCondition& stop) {
  SolveSummary summary;
  summary.p = p;
  summary.evaluations = 1;
  const bool ok = EvaluateCost(problem, p, stop, &summary.cost);
  summary.start_cost = summary.cost;
  summary.residual = summary.cost - (problem.alpha.array() * (p - problem.initial).array().square()).sum();
  summary.termination = ok ? Termination::kConverged : Termination::kFailed;
  summary.message = "no parameter is free";
  return summary;
}

}  // namespace

std::string_view TerminationName(Termination termination) {
  switch (termination) {
    case Termination::kConverged:
      return "converged";
    case Termination::kMaxIterations:
      return "max_iterations";
    case Termination::kStopped:
      return "stopped";
    case Termination::kFailed:
      return "failed";
  }
  return "failed";
}

void CheckProblem(const LeastSquaresProblem& problem) {
  RG_CHECK(problem.residuals != nullptr);
  const int n = problem.residuals->num_parameters();
  for (const VectorXd* v : {&problem.initial, &problem.lower, &problem.upper, &problem.alpha, &problem.scale,
                            &problem.search_lower, &problem.search_upper}) {
    RG_CHECK(v->size() == n) << "a vector of " << v->size() << " entries for " << n << " parameters";
  }
  for (int i = 0; i < n; ++i) {
    RG_CHECK(problem.lower[i] <= problem.upper[i]) << "parameter " << i << ": lower bound above upper";
    RG_CHECK(problem.alpha[i] >= 0.0) << "parameter " << i << ": negative regulariser";
    RG_CHECK(problem.scale[i] > 0.0 && std::isfinite(problem.scale[i])) << "parameter " << i << ": scale";
    RG_CHECK(std::isfinite(problem.initial[i])) << "parameter " << i << ": initial value";
    RG_CHECK(std::isfinite(problem.search_lower[i]) && std::isfinite(problem.search_upper[i]) &&
             problem.search_lower[i] <= problem.search_upper[i])
        << "parameter " << i << ": search range";
  }
}

SolveSummary Solve(const LeastSquaresProblem& problem, const VectorXd& start, const SolveOptions& options,
                   const StopCondition& stop) {
  CheckProblem(problem);
  RG_CHECK(start.size() == problem.initial.size());
  const bool bounded = options.solver == Solver::kBoundedLevenbergMarquardt;
  const FreeParameters free = ChooseFree(problem, start, bounded);
  if (free.index.empty()) return SolveWithoutUnknowns(problem, free.reference, stop);

  std::vector<double> y(free.index.size(), 0.0);
  TrackingCost cost(free, stop);
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem ceres_problem(problem_options);
  ceres_problem.AddResidualBlock(&cost, nullptr, y.data());
  if (bounded) SetBounds(free, y.data(), &ceres_problem);

  SilenceCeres();
  ceres::Solver::Options ceres_options = CeresOptions(options);
  StopCallback callback(stop);
  ceres_options.callbacks.push_back(&callback);
  ceres::Solver::Summary ceres_summary;
  ceres::Solve(ceres_options, &ceres_problem, &ceres_summary);

  SolveSummary summary = std::move(cost.best());
  summary.termination = ToTermination(ceres_summary, stop.ShouldStop(), std::isfinite(summary.cost));
  summary.message = ceres_summary.message;
  summary.iterations = std::max(0, static_cast<int>(ceres_summary.iterations.size()) - 1);
  return summary;
}

bool EvaluateCost(const LeastSquaresProblem& problem, const VectorXd& p, const StopCondition& stop,
                  double* cost) {
  VectorXd r(problem.residuals->num_residuals());
  *cost = std::numeric_limits<double>::infinity();
  if (!problem.residuals->Evaluate(p, stop, &r, nullptr) || !r.allFinite()) return false;
  *cost = r.squaredNorm() + (problem.alpha.array() * (p - problem.initial).array().square()).sum();
  return true;
}

}  // namespace rg::sysid
