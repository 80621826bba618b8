// Small control problems with known answers, for the tests of the solver.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <functional>
#include <limits>
#include <string>

#include "services/trajectories/control_problem.h"
#include "services/trajectories/tracking_cost.h"

namespace rg::trajectories {

inline constexpr double kFree = std::numeric_limits<double>::infinity();

// n joints, x = (q, v), a step given as a function with derivatives, tracking cost.
class MechanicalProblem : public ControlProblem {
 public:
  MechanicalProblem(int n, int knots, double interval, TrackingWeights weights)
      : cost_(n, 2 * n, interval, std::move(weights)), n_(n), knots_(knots), interval_(interval) {
    u_lower_ = Eigen::VectorXd::Constant(n, -kFree);
    u_upper_ = Eigen::VectorXd::Constant(n, kFree);
    x_lower_ = Eigen::VectorXd::Constant(2 * n, -kFree);
    x_upper_ = Eigen::VectorXd::Constant(2 * n, kFree);
  }

  int nx() const override { return 2 * n_; }
  int nu() const override { return n_; }
  int knots() const override { return knots_; }
  double StageCost(int, const VecIn& x, const VecIn& u, const VecIn& x_next) override {
    return cost_.Stage(x, u, x_next);
  }
  void StageQuadratic(int, const VecIn& x, const VecIn& u, const VecIn& x_next, const MatIn& A,
                      const MatIn& B, QuadraticCost* out) override {
    cost_.StageQuadratic(x, u, x_next, A, B, out);
  }
  double TerminalCost(const VecIn& x) override { return cost_.Terminal(x); }
  void TerminalQuadratic(const VecIn& x, MatOut Q, VecOut q) override { cost_.TerminalQuadratic(x, Q, q); }
  const Eigen::VectorXd& u_lower() const override { return u_lower_; }
  const Eigen::VectorXd& u_upper() const override { return u_upper_; }
  const Eigen::VectorXd& x_lower() const override { return x_lower_; }
  const Eigen::VectorXd& x_upper() const override { return x_upper_; }

  TrackingCost& cost() { return cost_; }
  double interval() const { return interval_; }
  Eigen::VectorXd u_lower_, u_upper_, x_lower_, x_upper_;

 protected:
  TrackingCost cost_;
  int n_, knots_;
  double interval_;
};

// q⁺ = q + h v + ½ h² u, v⁺ = v + h u for n unit masses.
class DoubleIntegrators : public MechanicalProblem {
 public:
  using MechanicalProblem::MechanicalProblem;
  bool Step(int, const VecIn& x, const VecIn& u, VecOut x_next) override {
    const double h = interval_;
    x_next.head(n_) = x.head(n_) + h * x.tail(n_) + 0.5 * h * h * u;
    x_next.tail(n_) = x.tail(n_) + h * u;
    return true;
  }
  bool StepLinearized(int k, const VecIn& x, const VecIn& u, VecOut x_next, MatOut A, MatOut B) override {
    const double h = interval_;
    A.setIdentity();
    A.topRightCorner(n_, n_).diagonal().setConstant(h);
    B.setZero();
    B.topRows(n_).diagonal().setConstant(0.5 * h * h);
    B.bottomRows(n_).diagonal().setConstant(h);
    return Step(k, x, u, x_next);
  }
};

// Uniform rod: I q̈ = u − m g l sin q, semi-implicit Euler in `substeps`, derivatives chained.
class Pendulum : public MechanicalProblem {
 public:
  Pendulum(int knots, double interval, TrackingWeights weights, int substeps = 5)
      : MechanicalProblem(1, knots, interval, std::move(weights)), substeps_(substeps) {}

  bool Step(int, const VecIn& x, const VecIn& u, VecOut x_next) override {
    Integrate(x, u, x_next, nullptr, nullptr);
    return x_next.allFinite();
  }
  bool StepLinearized(int, const VecIn& x, const VecIn& u, VecOut x_next, MatOut A, MatOut B) override {
    Eigen::Matrix2d a;
    Eigen::Vector2d b;
    Integrate(x, u, x_next, &a, &b);
    A = a;
    B = b;
    ++linearizations;
    return x_next.allFinite();
  }
  std::string StepError() const override { return "pendulum is not finite"; }

  double gravity_torque = 9.81;  // m g l [N·m]
  double inertia = 1.0;
  int linearizations = 0;

 private:
  void Integrate(const VecIn& x, const VecIn& u, VecOut& out, Eigen::Matrix2d* A, Eigen::Vector2d* B) const {
    double q = x[0], v = x[1];
    const double h = interval_ / substeps_;
    Eigen::Matrix2d a = Eigen::Matrix2d::Identity();
    Eigen::Vector2d b = Eigen::Vector2d::Zero();
    for (int i = 0; i < substeps_; ++i) {
      const double da = -gravity_torque * std::cos(q) / inertia;
      v += h * (u[0] - gravity_torque * std::sin(q)) / inertia;
      q += h * v;
      Eigen::Matrix2d step;
      step << 1.0 + h * h * da, h, h * da, 1.0;
      const Eigen::Vector2d input(h * h / inertia, h / inertia);
      a = step * a;
      b = step * b + input;
    }
    out[0] = q;
    out[1] = v;
    if (A) *A = a;
    if (B) *B = b;
  }
  int substeps_;
};

}  // namespace rg::trajectories
