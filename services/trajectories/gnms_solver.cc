#include "services/trajectories/gnms_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "common/base/check.h"

namespace rg::trajectories {
namespace {

using Map = Eigen::Map<Eigen::VectorXd>;
using ConstMap = Eigen::Map<const Eigen::VectorXd>;
using MapMat = Eigen::Map<Eigen::MatrixXd>;

Map Block(std::vector<double>& v, int k, int n) { return Map(v.data() + static_cast<size_t>(k) * n, n); }
ConstMap Block(const std::vector<double>& v, int k, int n) {
  return ConstMap(v.data() + static_cast<size_t>(k) * n, n);
}
MapMat Block(std::vector<double>& v, int k, int rows, int cols) {
  return MapMat(v.data() + static_cast<size_t>(k) * rows * cols, rows, cols);
}

// y − projection of y on [low, high].
double Excess(double y, double low, double high) {
  if (y > high) return y - high;
  if (y < low) return y - low;
  return 0.0;
}

}  // namespace

std::string_view TerminationName(Termination termination) {
  switch (termination) {
    case Termination::kConverged:
      return "converged";
    case Termination::kMaxIterations:
      return "max_iterations";
    case Termination::kTimeBudget:
      return "time_budget";
    case Termination::kStalled:
      return "stalled";
    case Termination::kInfeasible:
      return "infeasible";
    case Termination::kNonFinite:
      return "non_finite";
  }
  return "unknown";
}

GnmsSolver::GnmsSolver(ControlProblem& problem, const GnmsOptions& options, const Clock* clock)
    : problem_(problem),
      options_(options),
      clock_(clock),
      nx_(problem.nx()),
      nu_(problem.nu()),
      n_(problem.knots()),
      lq_(nx_, nu_, n_) {
  RG_CHECK(problem.u_lower().size() == nu_ && problem.u_upper().size() == nu_) << "boxes on u";
  RG_CHECK(problem.x_lower().size() == nx_ && problem.x_upper().size() == nx_) << "boxes on x";
  RG_CHECK(options.time_budget_s <= 0.0 || clock != nullptr) << "a time budget needs a clock";
  for (Shooting* it : {&current_, &trial_}) {
    it->x.assign((n_ + 1) * nx_, 0.0);
    it->u.assign(n_ * nu_, 0.0);
    it->phi.assign(n_ * nx_, 0.0);
    it->a.assign(n_ * nx_ * nx_, 0.0);
    it->b.assign(n_ * nx_ * nu_, 0.0);
  }
  multiplier_.assign((n_ + 1) * nx_, 0.0);
  rho_ = Eigen::VectorXd::Zero(nx_);
  rho_unit_ = Eigen::VectorXd::Zero(nx_);
  merit_weight_ = Eigen::VectorXd::Zero(nx_);
  history_.reserve(std::max(options.max_iterations, 1) + options.extra_iterations + 1);
  SetGuess(Eigen::MatrixXd::Zero(nx_, n_ + 1), Eigen::MatrixXd::Zero(nu_, n_));
}

void GnmsSolver::set_max_iterations(int iterations) {
  options_.max_iterations = iterations;
  history_.reserve(std::max(iterations, 1) + options_.extra_iterations + 1);
}

void GnmsSolver::SetGuess(const MatIn& x, const MatIn& u) {
  RG_CHECK(x.rows() == nx_ && x.cols() == n_ + 1) << x.rows() << " x " << x.cols();
  RG_CHECK(u.rows() == nu_ && u.cols() == n_) << u.rows() << " x " << u.cols();
  for (int k = 0; k <= n_; ++k) Block(current_.x, k, nx_) = x.col(k);
  for (int k = 0; k < n_; ++k)
    Block(current_.u, k, nu_) = u.col(k).cwiseMax(problem_.u_lower()).cwiseMin(problem_.u_upper());
  std::fill(multiplier_.begin(), multiplier_.end(), 0.0);
  rho_unit_.setZero();
  rho_.setZero();
  lq_.problem().rho.setZero();
  merit_weight_.setZero();
  regularization_ = 0.0;
  last_violation_ = std::numeric_limits<double>::infinity();
  lq_.ClearActiveSets();
  ForgetLinearization();
}

void GnmsSolver::ForgetLinearization() { current_.linearized_from = 0; }

void GnmsSolver::Shift() {
  auto shift = [](std::vector<double>& v, int block) { std::copy(v.begin() + block, v.end(), v.begin()); };
  shift(current_.x, nx_);
  shift(current_.u, nu_);
  shift(current_.phi, nx_);
  shift(current_.a, nx_ * nx_);
  shift(current_.b, nx_ * nu_);
  shift(multiplier_, nx_);
  lq_.ShiftActiveSets();
  if (current_.linearized_from > 0) --current_.linearized_from;
}

bool GnmsSolver::Linearize(Shooting& it, int from) {
  it.linearized_from = from;
  for (int k = from; k < n_; ++k) {
    if (!problem_.StepLinearized(k, Block(it.x, k, nx_), Block(it.u, k, nu_), Block(it.phi, k, nx_),
                                 Block(it.a, k, nx_, nx_), Block(it.b, k, nx_, nu_)))
      return false;
    ++it.linearized_from;
  }
  return TerminalAndFinite(it);
}

bool GnmsSolver::Evaluate(Shooting& it) {
  it.linearized_from = 0;
  for (int k = 0; k < n_; ++k)
    if (!problem_.Step(k, Block(it.x, k, nx_), Block(it.u, k, nu_), Block(it.phi, k, nx_))) return false;
  return TerminalAndFinite(it);
}

bool GnmsSolver::TerminalAndFinite(Shooting& it) {
  it.cost = problem_.TerminalCost(Block(it.x, n_, nx_));
  for (int k = 0; k < n_; ++k)
    it.cost += problem_.StageCost(k, Block(it.x, k, nx_), Block(it.u, k, nu_), Block(it.phi, k, nx_));
  return std::isfinite(it.cost);
}

// Affine data of the linear-quadratic problem at the present iterate.
void GnmsSolver::BuildLq(const VecIn& x0) {
  LqProblem& lq = lq_.problem();
  std::copy(current_.a.begin(), current_.a.end(), lq.a.begin());
  std::copy(current_.b.begin(), current_.b.end(), lq.b.begin());
  for (int k = 0; k < n_; ++k) {
    const auto x = Block(current_.x, k, nx_);
    const auto u = Block(current_.u, k, nu_);
    const auto phi = Block(current_.phi, k, nx_);
    QuadraticCost quadratic{lq.Q(k), lq.S(k), lq.R(k), lq.q(k), lq.r(k)};
    problem_.StageQuadratic(k, x, u, phi, lq.A(k), lq.B(k), &quadratic);
    lq.d(k) = phi - Block(current_.x, k + 1, nx_);
    lq.u_lo(k) = problem_.u_lower() - u;
    lq.u_hi(k) = problem_.u_upper() - u;
  }
  problem_.TerminalQuadratic(Block(current_.x, n_, nx_), lq.Q(n_), lq.q(n_));
  lq.dx0 = x0 - Block(current_.x, 0, nx_);
}

// Scales the weight of each bounded state to the curvature of the cost to go without boxes on the
// states, once per guess.
bool GnmsSolver::SetBoxWeights(GnmsSummary* summary) {
  if (rho_unit_.maxCoeff() > 0.0) return true;
  Eigen::VectorXd& r_scale = lq_.problem().regularization_scale;
  r_scale.setConstant(std::numeric_limits<double>::min());
  for (int k = 0; k < n_; ++k) r_scale += lq_.problem().R(k).diagonal() / n_;
  rho_unit_.setConstant(1.0);
  const bool bounded =
      problem_.x_lower().array().isFinite().any() || problem_.x_upper().array().isFinite().any();
  if (!bounded) return true;
  GnmsIteration unused;
  if (!SolveLq(summary, &unused)) return false;
  for (int i = 0; i < nx_; ++i) {
    double curvature = std::numeric_limits<double>::min();
    for (int k = 0; k < n_; ++k) curvature = std::max(curvature, lq_.cost_to_go(k)(i, i));
    rho_unit_[i] = curvature;
    if (std::isfinite(problem_.x_lower()[i]) || std::isfinite(problem_.x_upper()[i]))
      rho_[i] = options_.box_penalty * curvature;
  }
  return true;
}

// Thresholds of the augmented Lagrangian in δx.
void GnmsSolver::BuildBoxes() {
  LqProblem& lq = lq_.problem();
  lq.rho = rho_;
  for (int k = 1; k <= n_; ++k) {
    for (int i = 0; i < nx_; ++i) {
      if (rho_[i] == 0.0) continue;
      const double shifted = current_.x[k * nx_ + i] + multiplier_[k * nx_ + i] / rho_[i];
      lq.x_low[k * nx_ + i] = problem_.x_lower()[i] - shifted;
      lq.x_high[k * nx_ + i] = problem_.x_upper()[i] - shifted;
    }
  }
}

// Raises the regularisation until the Hessian in the controls is positive definite.
bool GnmsSolver::SolveLq(GnmsSummary* summary, GnmsIteration* record) {
  LqOptions lq_options;
  while (true) {
    lq_options.regularization = regularization_;
    const LqSummary lq_summary = lq_.Solve(lq_options);
    summary->sweeps += lq_summary.sweeps;
    record->sweeps += lq_summary.sweeps;
    record->regularization = regularization_;
    record->exact = lq_summary.exact;
    if (lq_summary.ok) return true;
    if (regularization_ >= options_.regularization_max) return false;
    RaiseRegularization();
  }
}

void GnmsSolver::RaiseRegularization() {
  regularization_ = std::max(10.0 * regularization_, options_.regularization_first);
}

// A full step says that the model is good, a short one that it is not (Levenberg-Marquardt).
void GnmsSolver::AdaptRegularization(double step_length) {
  if (step_length == 1.0)
    regularization_ = regularization_ <= options_.regularization_first ? 0.0 : 0.2 * regularization_;
  else if (step_length <= options_.short_step && regularization_ < options_.regularization_max)
    RaiseRegularization();
}

// μ_i above the largest costate, so that the ℓ1 term is exact. Returns the slope of the merit along
// the step, which the model predicts: ∇J·δ + (augmented Lagrangian) − Σ μ|d|.
double GnmsSolver::UpdateMeritWeights(const VecIn& x0) {
  constexpr double kSafety = 1.5;
  for (int k = 0; k <= n_; ++k) merit_weight_ = merit_weight_.cwiseMax(kSafety * lq_.costate(k).cwiseAbs());
  LqProblem& lq = lq_.problem();
  double slope = lq.q(n_).dot(lq_.dx(n_));
  for (int k = 0; k < n_; ++k) {
    slope += lq.q(k).dot(lq_.dx(k)) + lq.r(k).dot(lq_.du(k));
    slope -= merit_weight_.dot(lq.d(k).cwiseAbs());
  }
  slope -= merit_weight_.dot((x0 - Block(current_.x, 0, nx_)).cwiseAbs());
  for (int k = 1; k <= n_; ++k)
    for (int i = 0; i < nx_; ++i)
      if (rho_[i] > 0.0)
        slope += rho_[i] * Excess(0.0, lq.x_low[k * nx_ + i], lq.x_high[k * nx_ + i]) * lq_.dx(k)[i];
  return slope;
}

double GnmsSolver::BoxTerm(const Shooting& it) const {
  double term = 0.0;
  for (int i = 0; i < nx_; ++i) {
    if (rho_[i] == 0.0) continue;
    for (int k = 1; k <= n_; ++k) {
      const double y = it.x[k * nx_ + i] + multiplier_[k * nx_ + i] / rho_[i];
      const double excess = Excess(y, problem_.x_lower()[i], problem_.x_upper()[i]);
      term += 0.5 * rho_[i] * excess * excess;
    }
  }
  return term;
}

double GnmsSolver::Merit(const Shooting& it, const VecIn& x0) const {
  double merit = it.cost + BoxTerm(it) + merit_weight_.dot((x0 - Block(it.x, 0, nx_)).cwiseAbs());
  for (int k = 0; k < n_; ++k)
    merit += merit_weight_.dot((Block(it.phi, k, nx_) - Block(it.x, k + 1, nx_)).cwiseAbs());
  return merit;
}

void GnmsSolver::MeasureStep(GnmsIteration* record) const {
  record->step_x = record->step_u = 0.0;
  for (int k = 0; k <= n_; ++k)
    record->step_x = std::max(record->step_x, lq_.dx(k).lpNorm<Eigen::Infinity>());
  for (int k = 0; k < n_; ++k) record->step_u = std::max(record->step_u, lq_.du(k).lpNorm<Eigen::Infinity>());
}

bool GnmsSolver::StepIsSmall(const GnmsIteration& record, double slope, double merit) const {
  if (!record.exact || record.max_defect > options_.defect_tolerance) return false;
  const double u_scale = 1.0 + ConstMap(current_.u.data(), current_.u.size()).lpNorm<Eigen::Infinity>();
  if (record.step_x <= options_.step_tolerance && record.step_u <= options_.step_tolerance * u_scale)
    return true;
  return -slope <= options_.decrease_tolerance * std::abs(merit) &&
         record.max_violation <= options_.box_tolerance;
}

// Convex combination of points inside the box of u; clamped against rounding.
void GnmsSolver::MakeTrial(double step_length) {
  for (int k = 0; k <= n_; ++k) Block(trial_.x, k, nx_) = Block(current_.x, k, nx_) + step_length * lq_.dx(k);
  for (int k = 0; k < n_; ++k)
    Block(trial_.u, k, nu_) = (Block(current_.u, k, nu_) + step_length * lq_.du(k))
                                  .cwiseMax(problem_.u_lower())
                                  .cwiseMin(problem_.u_upper());
}

GnmsSolver::Search GnmsSolver::LineSearch(const VecIn& x0, double slope, double merit, GnmsSummary* summary,
                                          GnmsIteration* record) {
  const double rounding = 1e-13 * (std::abs(merit) + std::abs(current_.cost));
  bool any_finite = false;
  for (double length = 1.0; length >= options_.min_step; length *= options_.shrink) {
    MakeTrial(length);
    ++summary->passes;
    const bool finite = length == 1.0 ? Linearize(trial_, 0) : Evaluate(trial_);
    if (!finite) continue;
    any_finite = true;
    const double trial_merit = Merit(trial_, x0);
    if (!(trial_merit <= merit + options_.armijo * length * slope + rounding)) continue;
    if (length < 1.0) {
      ++summary->passes;
      if (!Linearize(trial_, 0)) continue;
    }
    record->step_length = length;
    record->merit = trial_merit;
    return Search::kAccepted;
  }
  return any_finite ? Search::kFailed : Search::kNonFinite;
}

void GnmsSolver::UpdateMultipliers() {
  for (int i = 0; i < nx_; ++i) {
    if (rho_[i] == 0.0) continue;
    for (int k = 1; k <= n_; ++k) {
      double& multiplier = multiplier_[k * nx_ + i];
      const double y = current_.x[k * nx_ + i] + multiplier / rho_[i];
      multiplier = rho_[i] * Excess(y, problem_.x_lower()[i], problem_.x_upper()[i]);
    }
  }
}

// Multiplier step of the augmented Lagrangian; a larger weight when the violation fell by less than
// half since the last stationary point. False when the weight is at its limit and nothing more helps.
bool GnmsSolver::TightenBoxes(bool stationary) {
  GnmsSummary now;
  MeasureViolation(&now);
  UpdateMultipliers();
  if (!stationary) return true;
  const bool slow = now.max_violation > 0.5 * last_violation_;
  last_violation_ = now.max_violation;
  if (!slow) return true;
  const Eigen::VectorXd limit = options_.box_penalty_max * rho_unit_;
  if ((rho_.array() >= limit.array() || rho_.array() == 0.0).all()) return false;
  rho_ = (rho_ * options_.box_penalty_growth).cwiseMin(limit);
  return true;
}

void GnmsSolver::MeasureDefects(const VecIn& x0, GnmsSummary* summary) const {
  summary->max_defect = (x0 - Block(current_.x, 0, nx_)).lpNorm<Eigen::Infinity>();
  for (int k = 0; k < n_; ++k)
    summary->max_defect =
        std::max(summary->max_defect,
                 (Block(current_.phi, k, nx_) - Block(current_.x, k + 1, nx_)).lpNorm<Eigen::Infinity>());
}

void GnmsSolver::MeasureViolation(GnmsSummary* summary) const {
  summary->max_violation = 0.0;
  for (int k = 1; k <= n_; ++k) {
    for (int i = 0; i < nx_; ++i) {
      const double excess =
          std::abs(Excess(current_.x[k * nx_ + i], problem_.x_lower()[i], problem_.x_upper()[i]));
      if (excess <= summary->max_violation) continue;
      summary->max_violation = excess;
      summary->worst_knot = k;
      summary->worst_state = i;
    }
  }
}

bool GnmsSolver::IterationsLeft(const VecIn& x0, const GnmsSummary& summary) const {
  if (summary.iterations < options_.max_iterations) return true;
  if (summary.iterations >= options_.max_iterations + options_.extra_iterations) return false;
  GnmsSummary now;
  MeasureDefects(x0, &now);
  return now.max_defect > options_.usable_defect;
}

bool GnmsSolver::OutOfTime(double started, double slowest) const {
  return options_.time_budget_s > 0.0 && clock_->SteadySeconds() - started + slowest > options_.time_budget_s;
}

void GnmsSolver::Finish(Termination termination, const VecIn& x0, std::string message,
                        GnmsSummary* summary) const {
  summary->termination = termination;
  summary->cost = current_.cost;
  summary->message = std::move(message);
  if (termination == Termination::kNonFinite) return;
  MeasureDefects(x0, summary);
  MeasureViolation(summary);
}

double GnmsSolver::Now() const { return options_.time_budget_s > 0.0 ? clock_->SteadySeconds() : 0.0; }

GnmsSummary GnmsSolver::Solve(const VecIn& x0) {
  RG_CHECK(x0.size() == nx_) << x0.size();
  GnmsSummary summary;
  history_.clear();
  merit_weight_.setZero();
  const double started = Now();
  double slowest = 0.0;
  if (!LinearizeGuess(x0, &summary)) return summary;
  while (IterationsLeft(x0, summary)) {
    if (OutOfTime(started, slowest)) {
      Finish(Termination::kTimeBudget, x0, "time budget used up", &summary);
      return summary;
    }
    const double iteration_started = Now();
    if (!Iterate(x0, &summary)) return summary;
    slowest = std::max(slowest, Now() - iteration_started);
  }
  Finish(Termination::kMaxIterations, x0, "iteration limit", &summary);
  return summary;
}

bool GnmsSolver::LinearizeGuess(const VecIn& x0, GnmsSummary* summary) {
  if (!x0.allFinite()) {
    Finish(Termination::kNonFinite, x0, "the initial state is not finite", summary);
    return false;
  }
  if (current_.linearized_from == 0) ++summary->passes;
  if (Linearize(current_, current_.linearized_from)) return true;
  summary->worst_knot = current_.linearized_from;
  Finish(Termination::kNonFinite, x0,
         "knot " + std::to_string(current_.linearized_from) + " of the guess: " + problem_.StepError(),
         summary);
  return false;
}

// Linear-quadratic problem, then convergence or a step. False when the search has ended.
bool GnmsSolver::Iterate(const VecIn& x0, GnmsSummary* summary) {
  ++summary->iterations;
  GnmsIteration record;
  if (!SolveModel(x0, summary, &record)) {
    Finish(Termination::kStalled, x0, "the Hessian in the controls is not positive definite", summary);
    return false;
  }
  const double slope = std::min(UpdateMeritWeights(x0), 0.0);
  const double merit = Merit(current_, x0);
  if (StepIsSmall(record, slope, merit)) {
    history_.push_back(record);
    return !FinishOrTighten(x0, summary);
  }
  const Search search = LineSearch(x0, slope, merit, summary, &record);
  history_.push_back(record);
  if (search == Search::kAccepted) {
    std::swap(current_, trial_);
    AdaptRegularization(record.step_length);
    if (record.step_length == 1.0) TightenBoxes(false);
    return true;
  }
  if (regularization_ < options_.regularization_max) {
    RaiseRegularization();
    return true;
  }
  if (search == Search::kNonFinite)
    Finish(Termination::kNonFinite, x0, "every trial step: " + problem_.StepError(), summary);
  else
    Finish(Termination::kStalled, x0, "no step decreases the merit", summary);
  return false;
}

bool GnmsSolver::SolveModel(const VecIn& x0, GnmsSummary* summary, GnmsIteration* record) {
  BuildLq(x0);
  if (!SetBoxWeights(summary)) return false;
  BuildBoxes();
  if (!SolveLq(summary, record)) return false;
  MeasureDefects(x0, summary);
  MeasureViolation(summary);
  record->cost = current_.cost;
  record->max_defect = summary->max_defect;
  record->max_violation = summary->max_violation;
  MeasureStep(record);
  return true;
}

// At a stationary point of the augmented Lagrangian: true when that is the end.
bool GnmsSolver::FinishOrTighten(const VecIn& x0, GnmsSummary* summary) {
  if (summary->max_violation <= options_.box_tolerance) {
    Finish(Termination::kConverged, x0, "", summary);
    return true;
  }
  if (TightenBoxes(true)) return false;
  Finish(Termination::kInfeasible, x0, "a state box cannot be held", summary);
  return true;
}

}  // namespace rg::trajectories
