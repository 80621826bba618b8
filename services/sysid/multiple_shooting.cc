#include "services/sysid/multiple_shooting.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "common/base/check.h"
#include "common/base/parallel.h"
#include "services/sysid/boxed_newton_step.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Normal equations of one window at (θ, ξ): Hessian blocks and gradients of ½ Σ ρ + ½ |ξ|².
struct WindowTerms {
  bool finite = false;
  double cost = 0.0;
  MatrixXd H_tt, H_tx, H_xx;
  VectorXd g_t, g_x;
  VectorXd r;
};

// The window's part of the step in θ once ξ is eliminated.
struct Eliminated {
  MatrixXd gain;    // H_xx⁻¹ H_xt
  VectorXd offset;  // H_xx⁻¹ g_x
};

struct Jacobians {
  RowMatrix J_t, J_x;
};

// Of one thread.
struct Scratch {
  std::vector<ShootingModel::Evaluation> windows;
  std::vector<Jacobians> jacobians;
  std::vector<VectorXd> r;
};

// A residual or slope beyond this is a simulation that exploded: as good as not finite. The cost of a broken
// window is that of residuals of this size, so that no step gains by breaking one.
constexpr double kBrokenResidual = 1e6;
constexpr double kBrokenSlope = 1e12, kBrokenGrowth = 1e7;  // by θ, by ξ

template <class Matrix>
bool Within(const Matrix& x, double limit) {
  return x.size() == 0 || (x.allFinite() && x.cwiseAbs().maxCoeff() < limit);
}

double HuberCost(const VectorXd& r, double k) {
  double cost = 0.0;
  for (int i = 0; i < r.size(); ++i) {
    const double a = std::abs(r[i]);
    cost += a <= k ? a * a : 2.0 * k * a - k * k;
  }
  return cost;
}

// Scales the rows of r and the Jacobians by sqrt(weight), weight = min(1, k/|r|).
void ApplyHuberWeights(double k, VectorXd* r, Jacobians* s) {
  for (int i = 0; i < r->size(); ++i) {
    const double a = std::abs((*r)[i]);
    if (a <= k) continue;
    const double w = std::sqrt(k / a);
    (*r)[i] *= w;
    s->J_t.row(i) *= w;
    s->J_x.row(i) *= w;
  }
}

// Windows that go to the model together: enough to fill its lanes, and groups for all threads.
struct Groups {
  Groups(const ShootingModel& model, int threads) : windows(model.num_windows()) {
    const int most = model.side_by_side() > 1 ? 2 * model.side_by_side() : 1;
    threads = std::max(1, threads);
    const int wanted = (windows + most - 1) / most;
    count = most == 1 ? windows : std::min(windows, (wanted + threads - 1) / threads * threads);
  }
  int first(int group) const {
    return static_cast<int>(static_cast<int64_t>(windows) * group / std::max(1, count));
  }
  int windows, count;
};

class Engine {
 public:
  Engine(const ShootingProblem& problem, const ShootingOptions& options, const StopCondition& stop)
      : problem_(problem),
        model_(*problem.model),
        options_(options),
        stop_(stop),
        groups_(model_, options.threads) {
    windows_ = model_.num_windows();
    P_ = model_.num_parameters();
    terms_.resize(windows_);
    scratch_.resize(std::max(1, options.threads));
  }

  // Cost only; +infinity when stopped on the way.
  double Cost(const VectorXd& theta, const std::vector<VectorXd>& xi) {
    std::vector<double> costs(windows_, 0.0);
    ParallelFor(options_.threads, groups_.count, [&](int worker, int g) {
      if (stop_.ShouldStop()) return;
      Scratch& s = scratch_[worker];
      Gather(g, xi, false, &s);
      for (ShootingModel::Evaluation& e : s.windows) {
        s.r[e.window - groups_.first(g)].resize(model_.window_residuals(e.window));
        e.r = &s.r[e.window - groups_.first(g)];
      }
      model_.EvaluateMany(worker, theta, &s.windows);
      for (const ShootingModel::Evaluation& e : s.windows) {
        const bool ok = e.ok && Within(*e.r, kBrokenResidual);
        costs[e.window] =
            0.5 * (ok ? HuberCost(*e.r, options_.huber) + e.xi->squaredNorm() : FailedCost(e.window));
      }
    });
    if (stop_.ShouldStop()) return std::numeric_limits<double>::infinity();
    double sum = PriorCost(theta);
    for (const double c : costs) sum += c;
    return sum;
  }

  // Fills terms(); the cost as above.
  double Linearize(const VectorXd& theta, const std::vector<VectorXd>& xi) {
    ParallelFor(options_.threads, groups_.count, [&](int worker, int g) {
      if (stop_.ShouldStop()) return;
      Scratch& s = scratch_[worker];
      Gather(g, xi, true, &s);
      model_.EvaluateMany(worker, theta, &s.windows);
      for (size_t k = 0; k < s.windows.size(); ++k) FormTerms(s.windows[k], &s.jacobians[k]);
    });
    if (stop_.ShouldStop()) return std::numeric_limits<double>::infinity();
    double sum = PriorCost(theta);
    broken_cost_ = 0.0;
    for (const WindowTerms& t : terms_) {
      sum += t.cost;
      if (!t.finite) broken_cost_ += t.cost;
    }
    return sum;
  }

  // The part of Linearize's cost that stands for broken windows.
  double broken_cost() const { return broken_cost_; }

  std::vector<WindowTerms>& terms() { return terms_; }
  int P() const { return P_; }
  int windows() const { return windows_; }

 private:
  double PriorCost(const VectorXd& theta) const {
    return 0.5 * (problem_.prior_information.array() * (theta - problem_.theta0).array().square()).sum();
  }
  double FailedCost(int w) const {
    return HuberCost(VectorXd::Constant(model_.window_residuals(w), kBrokenResidual), options_.huber);
  }

  // The windows of a group; with Jacobians into s->jacobians and residuals into the terms.
  void Gather(int group, const std::vector<VectorXd>& xi, bool linearize, Scratch* s) {
    const int first = groups_.first(group), count = groups_.first(group + 1) - first;
    s->windows.assign(count, {});
    s->r.resize(count);
    if (linearize) s->jacobians.resize(std::max<size_t>(s->jacobians.size(), count));
    for (int k = 0; k < count; ++k) {
      const int w = first + k;
      s->windows[k] = {.window = w, .xi = &xi[w]};
      if (!linearize) continue;
      terms_[w].r.resize(model_.window_residuals(w));
      s->jacobians[k].J_t.resize(model_.window_residuals(w), P_);
      s->jacobians[k].J_x.resize(model_.window_residuals(w), model_.window_unknowns(w));
      s->windows[k].r = &terms_[w].r;
      s->windows[k].dr_dtheta = &s->jacobians[k].J_t;
      s->windows[k].dr_dxi = &s->jacobians[k].J_x;
    }
  }

  void FormTerms(const ShootingModel::Evaluation& e, Jacobians* jacobians) {
    WindowTerms& t = terms_[e.window];
    Jacobians& s = *jacobians;
    const VectorXd& xi = *e.xi;
    t.finite =
        e.ok && Within(t.r, kBrokenResidual) && Within(s.J_t, kBrokenSlope) && Within(s.J_x, kBrokenGrowth);
    if (!t.finite) {
      t.cost = 0.5 * FailedCost(e.window);
      return;
    }
    t.cost = 0.5 * (HuberCost(t.r, options_.huber) + xi.squaredNorm());
    VectorXd r = t.r;
    ApplyHuberWeights(options_.huber, &r, &s);
    t.H_tt.setZero(P_, P_);
    t.H_tt.selfadjointView<Eigen::Lower>().rankUpdate(s.J_t.transpose());
    t.H_tx.noalias() = s.J_t.transpose() * s.J_x;
    t.H_xx.noalias() = s.J_x.transpose() * s.J_x;
    t.H_xx.diagonal().array() += 1.0;
    t.g_t.noalias() = s.J_t.transpose() * r;
    t.g_x.noalias() = s.J_x.transpose() * r;
    t.g_x += xi;
  }

  const ShootingProblem& problem_;
  ShootingModel& model_;
  const ShootingOptions& options_;
  const StopCondition& stop_;
  Groups groups_;
  int windows_ = 0, P_ = 0;
  double broken_cost_ = 0.0;
  std::vector<WindowTerms> terms_;
  std::vector<Scratch> scratch_;
};

struct Reduced {
  MatrixXd H;  // Schur complement, full symmetric, no priors, no damping on θ
  VectorXd g;
  std::vector<Eliminated> eliminated;
};

// Eliminates every window's ξ, damped by `damping` on its own block, summing in the windows' order.
Reduced Eliminate(const std::vector<WindowTerms>& terms, int P, double damping, int threads) {
  Reduced out{MatrixXd::Zero(P, P), VectorXd::Zero(P), std::vector<Eliminated>(terms.size())};
  const int windows = static_cast<int>(terms.size());
  constexpr int kChunk = 16;  // fixed, so that the order of summation is too
  const int chunks = (windows + kChunk - 1) / kChunk;
  std::vector<MatrixXd> H(chunks);
  std::vector<VectorXd> g(chunks);
  ParallelFor(threads, chunks, [&](int, int c) {
    H[c].setZero(P, P);
    g[c].setZero(P);
    for (int w = c * kChunk; w < std::min(windows, (c + 1) * kChunk); ++w) {
      const WindowTerms& t = terms[w];
      if (!t.finite) continue;
      MatrixXd H_xx = t.H_xx;
      H_xx.diagonal().array() *= 1.0 + damping;
      const Eigen::LLT<MatrixXd> llt(H_xx);
      Eliminated& e = out.eliminated[w];
      e.gain = llt.solve(t.H_tx.transpose());
      e.offset = llt.solve(t.g_x);
      H[c] += t.H_tt;
      H[c].triangularView<Eigen::Lower>() -= t.H_tx * e.gain;
      g[c] += t.g_t - t.H_tx * e.offset;
    }
  });
  for (int c = 0; c < chunks; ++c) {
    out.H += H[c];
    out.g += g[c];
  }
  out.H = MatrixXd(out.H.selfadjointView<Eigen::Lower>());
  return out;
}

// Sandwich: variation of the windows' scores against the information, over the determined directions.
double VarianceInflation(const std::vector<WindowTerms>& terms, const Reduced& reduced,
                         const VectorXd& scale) {
  const int P = static_cast<int>(scale.size());
  if (P == 0) return 1.0;
  const auto D = scale.asDiagonal();
  MatrixXd M = MatrixXd::Zero(P, P);
  int used = 0;
  for (size_t w = 0; w < terms.size(); ++w) {
    if (!terms[w].finite) continue;
    const VectorXd score = D * (terms[w].g_t - terms[w].H_tx * reduced.eliminated[w].offset);
    M.selfadjointView<Eigen::Lower>().rankUpdate(score);
    ++used;
  }
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(D * reduced.H * D);
  double sum = 0.0;
  int rank = 0;
  const double floor = std::max(1.0, 1e-10 * eigen.eigenvalues().maxCoeff());
  for (int k = 0; k < P; ++k) {
    if (eigen.eigenvalues()[k] <= floor) continue;
    const VectorXd v = eigen.eigenvectors().col(k);
    sum += v.dot(M.selfadjointView<Eigen::Lower>() * v) / eigen.eigenvalues()[k];
    ++rank;
  }
  if (rank == 0 || used <= rank) return 1.0;
  return sum / rank * used / (used - rank);  // scores at the optimum lost `rank` degrees of freedom
}

}  // namespace

void ShootingModel::EvaluateMany(int worker, const VectorXd& theta, std::vector<Evaluation>* windows) {
  for (Evaluation& e : *windows) {
    e.ok = Evaluate(worker, e.window, theta, *e.xi, e.r, e.dr_dtheta, e.dr_dxi);
  }
}

ShootingSolution SolveShooting(const ShootingProblem& problem, const VectorXd& theta,
                               const std::vector<VectorXd>& xi, const ShootingOptions& options,
                               const StopCondition& stop, const ShootingProgress& progress) {
  Engine engine(problem, options, stop);
  const int P = engine.P(), windows = engine.windows();
  RG_CHECK(theta.size() == P && problem.theta0.size() == P && problem.scale.size() == P);
  RG_CHECK(problem.lower.size() == P && problem.upper.size() == P && problem.prior_information.size() == P);
  ShootingSolution s;
  s.theta = theta.cwiseMax(problem.lower).cwiseMin(problem.upper);
  s.xi = xi;
  if (s.xi.empty()) {
    for (int w = 0; w < windows; ++w) s.xi.push_back(VectorXd::Zero(problem.model->window_unknowns(w)));
  }
  s.information = MatrixXd::Zero(P, P);
  s.cost = engine.Linearize(s.theta, s.xi);
  if (!std::isfinite(s.cost)) {
    s.termination = stop.ShouldStop() ? Termination::kStopped : Termination::kFailed;
    return s;
  }

  const VectorXd damping_unit = problem.scale.array().square().inverse();
  double damping = options.initial_damping, growth = 2.0;
  int small_steps = 0;
  s.termination = Termination::kMaxIterations;
  bool at_linearisation = true;  // terms belong to (θ, ξ)
  for (; s.iterations < options.max_iterations && !stop.ShouldStop(); ++s.iterations) {
    const Reduced reduced = Eliminate(engine.terms(), P, damping, options.threads);
    MatrixXd H = reduced.H;
    H.diagonal() += problem.prior_information;
    const VectorXd g = reduced.g + problem.prior_information.cwiseProduct(s.theta - problem.theta0);
    H.diagonal() += damping * (H.diagonal() + damping_unit);
    const VectorXd step = BoxedNewtonStep(H, g, problem.lower - s.theta, problem.upper - s.theta);

    const VectorXd trial = (s.theta + step).cwiseMax(problem.lower).cwiseMin(problem.upper);
    std::vector<VectorXd> trial_xi = s.xi;
    for (int w = 0; w < windows; ++w) {
      if (engine.terms()[w].finite) {
        trial_xi[w] -= reduced.eliminated[w].offset + reduced.eliminated[w].gain * step;
      }
    }
    const double trial_cost = engine.Cost(trial, trial_xi);
    if (stop.ShouldStop()) break;
    if (trial_cost < s.cost) {
      const double gain = (s.cost - trial_cost) / std::max(1e-300, s.cost - engine.broken_cost());
      s.theta = trial;
      s.xi = std::move(trial_xi);
      s.cost = trial_cost;
      damping = std::max(damping / 5.0, 1e-12);
      growth = 2.0;
      small_steps = gain < options.relative_tolerance ? small_steps + 1 : 0;
      at_linearisation = std::isfinite(engine.Linearize(s.theta, s.xi));
      if (!at_linearisation) break;
      if (progress) progress(s.iterations + 1, s.cost);
    } else {
      damping *= growth;
      growth *= 2.0;
      // A step that no longer changes anything: the optimum to the precision of the arithmetic.
      if (damping > 1e10 || step.cwiseQuotient(problem.scale).norm() < 1e-12) small_steps = 2;
    }
    if (small_steps >= 2) {
      s.termination = Termination::kConverged;
      ++s.iterations;
      break;
    }
  }
  if (stop.ShouldStop()) s.termination = Termination::kStopped;
  s.residuals.resize(windows);
  if (at_linearisation) {
    const Reduced reduced = Eliminate(engine.terms(), P, 0.0, options.threads);
    s.information = reduced.H;
    s.variance_inflation = VarianceInflation(engine.terms(), reduced, problem.scale);
    for (int w = 0; w < windows; ++w) {
      if (engine.terms()[w].finite) s.residuals[w] = engine.terms()[w].r;
      s.failed_windows += engine.terms()[w].finite ? 0 : 1;
    }
  }
  return s;
}

}  // namespace rg::sysid
