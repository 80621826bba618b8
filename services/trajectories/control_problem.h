// A discrete-time optimal control problem with boxes, as the solver sees it.
//
//   minimise   Σ_{k<N} l_k(x_k, u_k, x_{k+1})  +  l_N(x_N)
//   subject to x_{k+1} = Φ_k(x_k, u_k),   x_0 given,
//              u_lower ≤ u_k ≤ u_upper,   x_lower ≤ x_k ≤ x_upper (k ≥ 1; ±infinity where free)
//
// x: nx × 1, u: nu × 1, N = knots() intervals. Costs are Gauss-Newton: the matrices returned are
// positive semidefinite approximations of the Hessian, gradients are exact.
//
// Called from one thread at a time; not const, because an implementation owns a workspace.
#pragma once

#include <Eigen/Core>
#include <string>

namespace rg::trajectories {

using VecIn = Eigen::Ref<const Eigen::VectorXd>;
using VecOut = Eigen::Ref<Eigen::VectorXd>;
using MatIn = Eigen::Ref<const Eigen::MatrixXd>;
using MatOut = Eigen::Ref<Eigen::MatrixXd>;

// Second-order model of l_k along x_{k+1} = Φ_k(x_k, u_k), with the linearised Φ_k substituted:
//   l ≈ value + qᵀδx + rᵀδu + ½ (δxᵀ Q δx + 2 δuᵀ S δx + δuᵀ R δu)
struct QuadraticCost {
  MatOut Q;  // nx × nx
  MatOut S;  // nu × nx
  MatOut R;  // nu × nu
  VecOut q;  // nx
  VecOut r;  // nu
};

class ControlProblem {
 public:
  virtual ~ControlProblem() = default;

  virtual int nx() const = 0;
  virtual int nu() const = 0;
  virtual int knots() const = 0;

  // x_next = Φ_k(x, u). Returns false when the result is not finite; StepError() then says where.
  virtual bool Step(int k, const VecIn& x, const VecIn& u, VecOut x_next) = 0;
  // The same with A = ∂Φ/∂x (nx × nx) and B = ∂Φ/∂u (nx × nu).
  virtual bool StepLinearized(int k, const VecIn& x, const VecIn& u, VecOut x_next, MatOut A, MatOut B) = 0;
  virtual std::string StepError() const { return "non-finite state"; }

  // `x_next` is Φ_k(x, u), not the next knot, so that the cost does not see an open defect.
  virtual double StageCost(int k, const VecIn& x, const VecIn& u, const VecIn& x_next) = 0;
  virtual void StageQuadratic(int k, const VecIn& x, const VecIn& u, const VecIn& x_next, const MatIn& A,
                              const MatIn& B, QuadraticCost* out) = 0;
  virtual double TerminalCost(const VecIn& x) = 0;
  virtual void TerminalQuadratic(const VecIn& x, MatOut Q, VecOut q) = 0;

  // Constant while a solver is attached.
  virtual const Eigen::VectorXd& u_lower() const = 0;
  virtual const Eigen::VectorXd& u_upper() const = 0;
  virtual const Eigen::VectorXd& x_lower() const = 0;
  virtual const Eigen::VectorXd& x_upper() const = 0;
};

}  // namespace rg::trajectories
