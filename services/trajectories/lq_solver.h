// Riccati recursion over the knots of a linear-quadratic problem with boxes.
//
//   minimise   Σ_{k<N} ½ δx_kᵀ Q δx_k + δu_kᵀ S δx_k + ½ δu_kᵀ R δu_k + qᵀδx_k + rᵀδu_k
//              + ½ δx_Nᵀ Q_N δx_N + q_Nᵀ δx_N  +  Σ_{k≥1} ½ ρ · dist²(δx_k, [x_lo_k, x_hi_k])
//   subject to δx_{k+1} = A_k δx_k + B_k δu_k + d_k,   δx_0 given,   u_lo_k ≤ δu_k ≤ u_hi_k
//
// Boxes on δu are exact; boxes on δx are the piecewise quadratic term of an augmented Lagrangian
// (ρ per state, 0 where free; the multipliers are in the thresholds x_lo, x_hi).
//
// Both are found by a primal-dual active set over the *whole* horizon (a semismooth Newton method,
// Hintermüller, Ito, Kunisch, SIAM J. Optim. 13(3), 2002): sweep with the present sets, read from the
// forward pass which controls leave their box, which multipliers have the wrong sign and which states
// cross a threshold, repeat until the sets stand still, when the solution is the exact minimiser.
// Sets are kept from one call to the next, so that a warm problem needs one or two sweeps; a repeated
// sweep starts at the latest knot whose set changed. Where the sets cycle (bang-bang solutions do that)
// a primal-dual interior point on the same sweeps finds them.
//
// Sizes are fixed at construction; no allocation afterwards. Kernels with compile-time sizes for one,
// two, six and seven joints, run-time sizes otherwise. Not thread-safe.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace rg::trajectories {

// Data of the problem, blocks in contiguous column-major arrays.
class LqProblem {
 public:
  LqProblem(int nx, int nu, int knots);

  int nx() const { return nx_; }
  int nu() const { return nu_; }
  int knots() const { return knots_; }

  using MatMap = Eigen::Map<Eigen::MatrixXd>;
  using VecMap = Eigen::Map<Eigen::VectorXd>;
  MatMap A(int k) { return MatMap(&a[k * nx_ * nx_], nx_, nx_); }
  MatMap B(int k) { return MatMap(&b[k * nx_ * nu_], nx_, nu_); }
  VecMap d(int k) { return VecMap(&defect[k * nx_], nx_); }
  MatMap Q(int k) { return MatMap(&q_mat[k * nx_ * nx_], nx_, nx_); }  // k = 0 … knots
  MatMap S(int k) { return MatMap(&s_mat[k * nu_ * nx_], nu_, nx_); }
  MatMap R(int k) { return MatMap(&r_mat[k * nu_ * nu_], nu_, nu_); }
  VecMap q(int k) { return VecMap(&q_vec[k * nx_], nx_); }  // k = 0 … knots
  VecMap r(int k) { return VecMap(&r_vec[k * nu_], nu_); }
  VecMap u_lo(int k) { return VecMap(&u_low[k * nu_], nu_); }
  VecMap u_hi(int k) { return VecMap(&u_high[k * nu_], nu_); }
  VecMap x_lo(int k) { return VecMap(&x_low[k * nx_], nx_); }  // k = 1 … knots
  VecMap x_hi(int k) { return VecMap(&x_high[k * nx_], nx_); }

  std::vector<double> a, b, defect, q_mat, s_mat, r_mat, q_vec, r_vec, u_low, u_high, x_low, x_high;
  Eigen::VectorXd rho;                   // nx, ≥ 0
  Eigen::VectorXd dx0;                   // nx
  Eigen::VectorXd regularization_scale;  // nu, > 0; ones at first

 private:
  int nx_, nu_, knots_;
};

struct LqOptions {
  // × LqProblem::regularization_scale is added to the diagonal of R: shortens the step when the
  // quadratic model is not trusted.
  double regularization = 0.0;
  // Sweeps of the active-set method before the interior point takes over, and again from its end.
  int max_set_sweeps = 6;
  int max_interior_sweeps = 50;
  // Slack of the set changes, in units of the variable.
  double tolerance = 1e-10;
};

struct LqSummary {
  bool ok = false;     // false: the Hessian in the free controls is not positive definite at `knot`
  bool exact = false;  // the active set stood still: δu, δx minimise the problem
  int knot = -1;
  bool interior_converged = false;  // the interior point was needed, and ended at its tolerance
  int sweeps = 0;
  int active_controls = 0;  // bounds that hold with equality
  int active_states = 0;
};

class LqSolver {
 public:
  LqSolver(int nx, int nu, int knots);

  LqProblem& problem() { return problem_; }

  LqSummary Solve(const LqOptions& options);

  using ConstVec = Eigen::Map<const Eigen::VectorXd>;
  using ConstMat = Eigen::Map<const Eigen::MatrixXd>;
  ConstVec dx(int k) const { return ConstVec(&dx_[k * problem_.nx()], problem_.nx()); }  // k = 0 … knots
  ConstVec du(int k) const { return ConstVec(&du_[k * problem_.nu()], problem_.nu()); }
  // Gradient of the cost to go at δx_k, the multiplier of the k-th dynamics constraint (k ≥ 1).
  ConstVec costate(int k) const { return ConstVec(&costate_[k * problem_.nx()], problem_.nx()); }
  // Feedback: δu_k = gain(k) δx_k + feedforward, nu × nx.
  ConstMat gain(int k) const {
    return ConstMat(&gain_[k * problem_.nu() * problem_.nx()], problem_.nu(), problem_.nx());
  }
  // Hessian of the cost to go at knot k, nx × nx.
  ConstMat cost_to_go(int k) const {
    return ConstMat(&p_mat_[k * problem_.nx() * problem_.nx()], problem_.nx(), problem_.nx());
  }

  void ClearActiveSets();
  // Sets of knot k+1 become those of knot k (receding horizon).
  void ShiftActiveSets();

 private:
  template <int NX, int NU>
  friend struct LqKernel;
  struct Kernels;

  // The latest knot whose set changed, −1 when none did.
  int UpdateControlSet(double tolerance);
  int UpdateStateSet(double tolerance);
  bool Sweep(int from, LqSummary* summary);
  void TermsFromSets(double regularization);
  bool SettleSets(const LqOptions& options, LqSummary* summary);
  void Rollout();

  // lq_interior_point.cc
  bool InteriorPoint(const LqOptions& options, LqSummary* summary);
  void StartInteriorPoint();
  void TermsFromInteriorPoint(double regularization, double mu);
  double InteriorStepLength(double mu) const;
  void TakeInteriorStep(double length, double mu);
  double Complementarity() const;
  void SetsFromInteriorPoint();
  void ClampControls();

  LqProblem problem_;
  std::vector<double> p_mat_, p_vec_;               // (knots + 1): cost to go
  std::vector<double> gain_, feedforward_;          // knots
  std::vector<double> h_uu_, h_ux_, h_u_;           // knots: Hamiltonian in u, kept for multipliers
  std::vector<double> dx_, du_, costate_, u_grad_;  // solution; u_grad: dH/du at the solution
  std::vector<int8_t> u_set_, x_set_;               // −1 lower, 0 free, +1 upper
  int failed_knot_ = -1;

  std::vector<double> scratch_xx_, scratch_xu_, scratch_uu_, scratch_x_;
  std::vector<double> u_diagonal_, u_shift_, x_diagonal_, x_shift_;  // terms of a sweep beside the problem's
  std::vector<double> ip_u_, ip_x_, ip_low_, ip_high_;  // interior point, and the multipliers of its bounds
  const Kernels* kernels_;
};

}  // namespace rg::trajectories
