#include "services/sysid/multiple_shooting.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include <cmath>
#include <limits>

#include "common/base/rng.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

// An exponential decay y = x0·exp(−a t) + b, seen in windows with noise; θ = (a, b, unseen), ξ the
// initial value in units of 0.1 around its measurement.
class Decay final : public ShootingModel {
 public:
  Decay(int windows, double noise, uint64_t seed, int steps = 20) : noise_(noise) {
    Rng rng(seed);
    for (int w = 0; w < windows; ++w) {
      Window window;
      const double x0 = rng.Uniform(0.5, 2.0);
      window.measured_x0 = x0 + 0.1 * rng.Normal();
      for (int k = 1; k <= steps; ++k) {
        window.y.push_back(x0 * std::exp(-1.3 * 0.1 * k) + 0.2 + noise * rng.Normal());
      }
      windows_.push_back(window);
    }
  }
  int num_parameters() const override { return 3; }
  int num_windows() const override { return static_cast<int>(windows_.size()); }
  int window_unknowns(int) const override { return 1; }
  int window_residuals(int w) const override { return static_cast<int>(windows_[w].y.size()); }
  bool Evaluate(int, int w, const VectorXd& theta, const VectorXd& xi, VectorXd* r, RowMatrix* dr_dtheta,
                RowMatrix* dr_dxi) override {
    const double x0 = windows_[w].measured_x0 + 0.1 * xi[0];
    if (w == broken_window) return false;
    for (int k = 0; k < r->size(); ++k) {
      const double t = 0.1 * (k + 1), e = std::exp(-theta[0] * t);
      (*r)[k] = (x0 * e + theta[1] - windows_[w].y[k]) / noise_;
      if (dr_dtheta != nullptr) {
        dr_dtheta->row(k) << -x0 * t * e / noise_, 1.0 / noise_, 0.0;
        (*dr_dxi)(k, 0) = 0.1 * e / noise_;
      }
    }
    return true;
  }

  int broken_window = -1;
  struct Window {
    double measured_x0;
    std::vector<double> y;
  };
  std::vector<Window> windows_;

 private:
  double noise_;
};

ShootingProblem ProblemFor(ShootingModel* model) {
  const double inf = std::numeric_limits<double>::infinity();
  ShootingProblem p;
  p.model = model;
  p.theta0 = Eigen::Vector3d(0.5, 0.0, 4.0);
  p.prior_information = Eigen::Vector3d(1e-4, 1e-4, 1.0);
  p.scale = Eigen::Vector3d::Ones();
  p.lower = VectorXd::Constant(3, -inf);
  p.upper = VectorXd::Constant(3, inf);
  return p;
}

TEST(MultipleShooting, RecoversSharedParametersWithUnknownInitialStates) {
  Decay model(40, 0.02, 1);
  const auto problem = ProblemFor(&model);
  const auto s = SolveShooting(problem, problem.theta0, {}, {}, {});
  EXPECT_EQ(s.termination, Termination::kConverged);
  EXPECT_NEAR(s.theta[0], 1.3, 0.05);
  EXPECT_NEAR(s.theta[1], 0.2, 0.01);
  EXPECT_DOUBLE_EQ(s.theta[2], 4.0) << "a parameter without effect stays at its prior";
}

// Decay with θ held: only initial values are unknown.
class KnownDecay final : public ShootingModel {
 public:
  explicit KnownDecay(Decay* decay) : decay_(*decay) {}
  int num_parameters() const override { return 0; }
  int num_windows() const override { return decay_.num_windows(); }
  int window_unknowns(int w) const override { return decay_.window_unknowns(w); }
  int window_residuals(int w) const override { return decay_.window_residuals(w); }
  bool Evaluate(int worker, int w, const VectorXd&, const VectorXd& xi, VectorXd* r, RowMatrix* dr_dtheta,
                RowMatrix* dr_dxi) override {
    RowMatrix unused(r->size(), 3);
    return decay_.Evaluate(worker, w, Eigen::Vector3d(1.3, 0.2, 4.0), xi, r,
                           dr_dtheta != nullptr ? &unused : nullptr, dr_dxi);
  }

 private:
  Decay& decay_;
};

TEST(MultipleShooting, SettlesInitialStatesWhereNoParameterIsUnknown) {
  Decay decay(5, 0.001, 3);
  KnownDecay model(&decay);
  const ShootingProblem problem{&model, {}, {}, {}, {}, {}};
  const auto s = SolveShooting(problem, {}, {}, {}, {});
  EXPECT_EQ(s.termination, Termination::kConverged);
  EXPECT_EQ(s.information.size(), 0);
  EXPECT_EQ(s.variance_inflation, 1.0);
  for (int w = 0; w < 5; ++w) {
    const double x0 = decay.windows_[w].measured_x0 + 0.1 * s.xi[w][0];
    EXPECT_NEAR(x0 * std::exp(-0.13) + 0.2, decay.windows_[w].y[0], 0.005) << w;
  }
}

TEST(MultipleShooting, StatedUncertaintyCoversTheTruth) {
  int covered = 0;
  const int trials = 200;
  for (int trial = 0; trial < trials; ++trial) {
    Decay model(10, 0.02, 100 + trial);
    const auto problem = ProblemFor(&model);
    ShootingOptions options;
    options.huber = std::numeric_limits<double>::infinity();
    const auto s = SolveShooting(problem, problem.theta0, {}, options, {});
    Eigen::MatrixXd H = s.information;
    H.diagonal() += problem.prior_information;
    const double stddev = std::sqrt(H.inverse()(0, 0));
    covered += std::abs(s.theta[0] - 1.3) < 1.96 * stddev ? 1 : 0;
  }
  // 95 % ± four standard errors of 200 trials.
  EXPECT_GE(covered, 178);
  EXPECT_LE(covered, 200);
}

TEST(MultipleShooting, InflationIsOneForWhiteNoiseAndSeesModelError) {
  Decay good(60, 0.02, 3);
  auto problem = ProblemFor(&good);
  EXPECT_NEAR(SolveShooting(problem, problem.theta0, {}, {}, {}).variance_inflation, 1.0, 0.6);
  Decay bad(60, 0.02, 3);
  Rng rng(9);
  for (auto& window : bad.windows_) {  // an offset of its own in every window
    const double offset = 0.1 * rng.Normal();
    for (double& y : window.y) y += offset;
  }
  problem = ProblemFor(&bad);
  EXPECT_GT(SolveShooting(problem, problem.theta0, {}, {}, {}).variance_inflation, 5.0);
}

TEST(MultipleShooting, ResultDoesNotDependOnTheNumberOfThreads) {
  Decay model(40, 0.02, 1);
  const auto problem = ProblemFor(&model);
  ShootingOptions one, four;
  four.threads = 4;
  const auto a = SolveShooting(problem, problem.theta0, {}, one, {});
  const auto b = SolveShooting(problem, problem.theta0, {}, four, {});
  EXPECT_EQ(a.theta, b.theta);
  EXPECT_EQ(a.cost, b.cost);
}

TEST(MultipleShooting, HoldsBoundsAndFindsTheConstrainedOptimum) {
  Decay model(40, 0.02, 1);
  auto problem = ProblemFor(&model);
  problem.upper[0] = 1.0;
  const auto s = SolveShooting(problem, problem.theta0, {}, {}, {});
  EXPECT_DOUBLE_EQ(s.theta[0], 1.0);
  // The rest is optimal given the bound: moving b either way costs.
  for (const double db : {-1e-3, 1e-3}) {
    auto fixed = problem;
    fixed.lower[0] = 1.0;
    fixed.lower[1] = fixed.upper[1] = s.theta[1] + db;
    VectorXd start = s.theta;
    start[1] += db;
    EXPECT_GT(SolveShooting(fixed, start, {}, {}, {}).cost, s.cost);
  }
}

TEST(MultipleShooting, HuberWithstandsOutliers) {
  Decay model(40, 0.02, 1);
  for (int w = 0; w < 40; w += 4) model.windows_[w].y[5] += 3.0;
  const auto problem = ProblemFor(&model);
  ShootingOptions plain, robust;
  plain.huber = std::numeric_limits<double>::infinity();
  robust.huber = 2.0;
  const double plain_error = std::abs(SolveShooting(problem, problem.theta0, {}, plain, {}).theta[1] - 0.2);
  const double robust_error = std::abs(SolveShooting(problem, problem.theta0, {}, robust, {}).theta[1] - 0.2);
  EXPECT_LT(robust_error, 0.2 * plain_error);
}

TEST(MultipleShooting, OneExplodingWindowDoesNotStopTheOthers) {
  Decay model(40, 0.02, 1);
  model.broken_window = 7;
  const auto problem = ProblemFor(&model);
  const auto s = SolveShooting(problem, problem.theta0, {}, {}, {});
  EXPECT_EQ(s.failed_windows, 1);
  EXPECT_EQ(s.residuals[7].size(), 0);
  EXPECT_NEAR(s.theta[0], 1.3, 0.05);
}

TEST(MultipleShooting, StopsOnCancelWithAPoint) {
  Decay model(40, 0.02, 1);
  const auto problem = ProblemFor(&model);
  CancelToken cancel;
  const auto s = SolveShooting(problem, problem.theta0, {}, {}, StopCondition(&cancel),
                               [&](int, double) { cancel.Cancel(); });
  EXPECT_EQ(s.termination, Termination::kStopped);
  EXPECT_TRUE(s.theta.allFinite());
}

}  // namespace
}  // namespace rg::sysid
