#include "services/trajectories/lq_solver.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/check.h"

namespace rg::trajectories {
namespace {
constexpr double kInfinity = std::numeric_limits<double>::infinity();
}

LqProblem::LqProblem(int nx, int nu, int knots) : nx_(nx), nu_(nu), knots_(knots) {
  RG_CHECK(nx > 0 && nu > 0 && knots > 0) << nx << " states, " << nu << " controls, " << knots << " knots";
  a.assign(knots * nx * nx, 0.0);
  b.assign(knots * nx * nu, 0.0);
  defect.assign(knots * nx, 0.0);
  q_mat.assign((knots + 1) * nx * nx, 0.0);
  s_mat.assign(knots * nu * nx, 0.0);
  r_mat.assign(knots * nu * nu, 0.0);
  q_vec.assign((knots + 1) * nx, 0.0);
  r_vec.assign(knots * nu, 0.0);
  u_low.assign(knots * nu, -kInfinity);
  u_high.assign(knots * nu, kInfinity);
  x_low.assign((knots + 1) * nx, -kInfinity);
  x_high.assign((knots + 1) * nx, kInfinity);
  rho = Eigen::VectorXd::Zero(nx);
  dx0 = Eigen::VectorXd::Zero(nx);
  regularization_scale = Eigen::VectorXd::Ones(nu);
}

// One knot of the backward and of the forward recursion for sizes known at compile time (or
// Eigen::Dynamic).
template <int NX, int NU>
struct LqKernel {
  using MatXX = Eigen::Matrix<double, NX, NX>;
  using MatXU = Eigen::Matrix<double, NX, NU>;
  using MatUX = Eigen::Matrix<double, NU, NX>;
  using MatUU = Eigen::Matrix<double, NU, NU>;
  using VecX = Eigen::Matrix<double, NX, 1>;
  using VecU = Eigen::Matrix<double, NU, 1>;
  template <class M>
  static Eigen::Map<M> At(std::vector<double>& v, int k, int rows, int cols) {
    return Eigen::Map<M>(v.data() + static_cast<size_t>(k) * rows * cols, rows, cols);
  }

  static void AddStateTerms(LqSolver& s, int k, Eigen::Map<MatXX> P, Eigen::Map<VecX> p) {
    if (k == 0) return;  // δx_0 is given
    const int nx = s.problem_.nx();
    P.diagonal() += At<VecX>(s.x_diagonal_, k, nx, 1);
    p += At<VecX>(s.x_shift_, k, nx, 1);
  }

  static void Terminal(LqSolver& s) {
    LqProblem& lq = s.problem_;
    const int nx = lq.nx(), n = lq.knots();
    auto P = At<MatXX>(s.p_mat_, n, nx, nx);
    auto p = At<VecX>(s.p_vec_, n, nx, 1);
    P = At<MatXX>(lq.q_mat, n, nx, nx);
    p = At<VecX>(lq.q_vec, n, nx, 1);
    AddStateTerms(s, n, P, p);
  }

  // out += lhs · rhs, column by column with the column of `out` held in registers.
  template <class Out, class Lhs, class Rhs>
  static void AddProduct(const Lhs& lhs, const Rhs& rhs, Out& out) {
    if constexpr (NX == Eigen::Dynamic) {
      out.noalias() += lhs * rhs;
    } else {
      for (int j = 0; j < rhs.cols(); ++j) {
        Eigen::Matrix<double, Out::RowsAtCompileTime, 1> column = out.col(j);
        for (int i = 0; i < lhs.cols(); ++i) column += lhs.col(i) * rhs(i, j);
        out.col(j) = column;
      }
    }
  }

  // Eliminates the free controls of a knot: gain and feedforward; active ones are pinned to a bound.
  static bool EliminateControls(LqSolver& s, int k) {
    const int nx = s.problem_.nx(), nu = s.problem_.nu();
    auto hessian = At<MatUU>(s.scratch_uu_, 0, nu, nu);
    auto K = At<MatUX>(s.gain_, k, nu, nx);
    auto kff = At<VecU>(s.feedforward_, k, nu, 1);
    hessian = At<MatUU>(s.h_uu_, k, nu, nu);
    hessian.diagonal() += At<VecU>(s.u_diagonal_, k, nu, 1);
    K = -At<MatUX>(s.h_ux_, k, nu, nx);
    kff = -At<VecU>(s.h_u_, k, nu, 1) - At<VecU>(s.u_shift_, k, nu, 1);
    for (int i = 0; i < nu; ++i) {
      const int set = s.u_set_[k * nu + i];
      if (set == 0) continue;
      const double bound = set > 0 ? s.problem_.u_high[k * nu + i] : s.problem_.u_low[k * nu + i];
      kff -= hessian.col(i) * bound;
      hessian.col(i).setZero();
    }
    for (int i = 0; i < nu; ++i) {
      const int set = s.u_set_[k * nu + i];
      if (set == 0) continue;
      hessian.row(i).setZero();
      hessian(i, i) = 1.0;
      K.row(i).setZero();
      kff(i) = set > 0 ? s.problem_.u_high[k * nu + i] : s.problem_.u_low[k * nu + i];
    }
    Eigen::LLT<Eigen::Ref<MatUU>> llt(hessian);  // in place
    if (llt.info() != Eigen::Success) return false;
    llt.solveInPlace(K);
    llt.solveInPlace(kff);
    return true;
  }

  // P_k, p_k, gain and feedforward of knots `from` … 0, given P_{from+1}.
  static bool Backward(LqSolver& s, int from) {
    LqProblem& lq = s.problem_;
    const int nx = lq.nx(), nu = lq.nu();
    auto pa = At<MatXX>(s.scratch_xx_, 0, nx, nx);
    auto at = At<MatXX>(s.scratch_xx_, 1, nx, nx);
    auto pb = At<MatXU>(s.scratch_xu_, 0, nx, nu);
    auto bt = At<MatUX>(s.scratch_xu_, 1, nu, nx);
    auto w = At<VecX>(s.scratch_x_, 0, nx, 1);
    for (int k = from; k >= 0; --k) {
      const auto A = At<MatXX>(lq.a, k, nx, nx);
      const auto B = At<MatXU>(lq.b, k, nx, nu);
      const auto P_next = At<MatXX>(s.p_mat_, k + 1, nx, nx);
      auto P = At<MatXX>(s.p_mat_, k, nx, nx);
      auto p = At<VecX>(s.p_vec_, k, nx, 1);
      auto huu = At<MatUU>(s.h_uu_, k, nu, nu);
      auto hux = At<MatUX>(s.h_ux_, k, nu, nx);
      auto hu = At<VecU>(s.h_u_, k, nu, 1);

      w = At<VecX>(s.p_vec_, k + 1, nx, 1);
      w.noalias() += P_next * At<VecX>(lq.defect, k, nx, 1);
      pa.setZero();
      AddProduct(P_next, A, pa);
      pb.setZero();
      AddProduct(P_next, B, pb);
      at = A.transpose();
      bt = B.transpose();
      P = At<MatXX>(lq.q_mat, k, nx, nx);
      AddProduct(at, pa, P);
      hux = At<MatUX>(lq.s_mat, k, nu, nx);
      AddProduct(bt, pa, hux);
      huu = At<MatUU>(lq.r_mat, k, nu, nu);
      AddProduct(bt, pb, huu);
      p = At<VecX>(lq.q_vec, k, nx, 1);
      p.noalias() += at * w;
      hu = At<VecU>(lq.r_vec, k, nu, 1);
      hu.noalias() += bt * w;

      if (!EliminateControls(s, k)) {
        s.failed_knot_ = k;
        return false;
      }
      const auto K = At<MatUX>(s.gain_, k, nu, nx);
      const auto kff = At<VecU>(s.feedforward_, k, nu, 1);
      pb = hux.transpose();
      AddProduct(pb, K, P);
      p.noalias() += pb * kff;
      Symmetrize(P);
      AddStateTerms(s, k, P, p);
    }
    return true;
  }

  static void Symmetrize(Eigen::Map<MatXX> P) {
    for (int j = 1; j < P.cols(); ++j)
      for (int i = 0; i < j; ++i) P(i, j) = P(j, i) = 0.5 * (P(i, j) + P(j, i));
  }

  static void Forward(LqSolver& s) {
    LqProblem& lq = s.problem_;
    const int nx = lq.nx(), nu = lq.nu(), n = lq.knots();
    At<VecX>(s.dx_, 0, nx, 1) = lq.dx0;
    for (int k = 0; k < n; ++k) {
      const auto x = At<VecX>(s.dx_, k, nx, 1);
      auto u = At<VecU>(s.du_, k, nu, 1);
      auto x_next = At<VecX>(s.dx_, k + 1, nx, 1);
      auto grad = At<VecU>(s.u_grad_, k, nu, 1);
      u = At<VecU>(s.feedforward_, k, nu, 1);
      u.noalias() += At<MatUX>(s.gain_, k, nu, nx) * x;
      grad = At<VecU>(s.h_u_, k, nu, 1);
      grad.noalias() += At<MatUX>(s.h_ux_, k, nu, nx) * x;
      grad.noalias() += At<MatUU>(s.h_uu_, k, nu, nu) * u;
      x_next = At<VecX>(lq.defect, k, nx, 1);
      x_next.noalias() += At<MatXX>(lq.a, k, nx, nx) * x;
      x_next.noalias() += At<MatXU>(lq.b, k, nx, nu) * u;
    }
    for (int k = 0; k <= n; ++k) {
      auto costate = At<VecX>(s.costate_, k, nx, 1);
      costate = At<VecX>(s.p_vec_, k, nx, 1);
      costate.noalias() += At<MatXX>(s.p_mat_, k, nx, nx) * At<VecX>(s.dx_, k, nx, 1);
    }
  }
};

struct LqSolver::Kernels {
  void (*terminal)(LqSolver&);
  bool (*backward)(LqSolver&, int);
  void (*forward)(LqSolver&);

  template <int NX, int NU>
  static const Kernels* Get() {
    static constexpr Kernels kernels{LqKernel<NX, NU>::Terminal, LqKernel<NX, NU>::Backward,
                                     LqKernel<NX, NU>::Forward};
    return &kernels;
  }
  static const Kernels* Select(int nx, int nu) {
    if (nx == 2 && nu == 1) return Get<2, 1>();
    if (nx == 4 && nu == 2) return Get<4, 2>();
    if (nx == 12 && nu == 6) return Get<12, 6>();
    if (nx == 14 && nu == 7) return Get<14, 7>();
    return Get<Eigen::Dynamic, Eigen::Dynamic>();
  }
};

LqSolver::LqSolver(int nx, int nu, int knots) : problem_(nx, nu, knots), kernels_(Kernels::Select(nx, nu)) {
  p_mat_.assign((knots + 1) * nx * nx, 0.0);
  p_vec_.assign((knots + 1) * nx, 0.0);
  gain_.assign(knots * nu * nx, 0.0);
  feedforward_.assign(knots * nu, 0.0);
  h_uu_.assign(knots * nu * nu, 0.0);
  h_ux_.assign(knots * nu * nx, 0.0);
  h_u_.assign(knots * nu, 0.0);
  dx_.assign((knots + 1) * nx, 0.0);
  du_.assign(knots * nu, 0.0);
  costate_.assign((knots + 1) * nx, 0.0);
  u_grad_.assign(knots * nu, 0.0);
  scratch_xx_.assign(2 * nx * nx, 0.0);
  scratch_xu_.assign(2 * nx * nu, 0.0);
  scratch_uu_.assign(nu * nu, 0.0);
  scratch_x_.assign(nx, 0.0);
  for (auto* v : {&u_diagonal_, &u_shift_, &ip_u_, &ip_low_, &ip_high_}) v->assign(knots * nu, 0.0);
  for (auto* v : {&x_diagonal_, &x_shift_, &ip_x_}) v->assign((knots + 1) * nx, 0.0);
  u_set_.assign(knots * nu, 0);
  x_set_.assign((knots + 1) * nx, 0);
}

void LqSolver::ClearActiveSets() {
  std::fill(u_set_.begin(), u_set_.end(), int8_t{0});
  std::fill(x_set_.begin(), x_set_.end(), int8_t{0});
}

void LqSolver::ShiftActiveSets() {
  const int nx = problem_.nx(), nu = problem_.nu();
  std::copy(u_set_.begin() + nu, u_set_.end(), u_set_.begin());
  std::copy(x_set_.begin() + nx, x_set_.end(), x_set_.begin());
}

int LqSolver::UpdateControlSet(double tolerance) {
  const int nu = problem_.nu(), count = nu * problem_.knots();
  int last_changed = -1;
  for (int i = 0; i < count; ++i) {
    int8_t set = u_set_[i];
    if (set == 0) {
      if (du_[i] > problem_.u_high[i] + tolerance) set = 1;
      if (du_[i] < problem_.u_low[i] - tolerance) set = -1;
    } else if (set * u_grad_[i] > tolerance) {
      set = 0;  // the cost falls when the control leaves its bound inwards
    }
    if (set != u_set_[i]) last_changed = i / nu;
    u_set_[i] = set;
  }
  return last_changed;
}

int LqSolver::UpdateStateSet(double tolerance) {
  const int nx = problem_.nx(), count = nx * (problem_.knots() + 1);
  int last_changed = -1;
  for (int i = nx; i < count; ++i) {
    if (problem_.rho[i % nx] == 0.0) continue;
    // A set is left with the same slack with which it is entered, or rounding would toggle it.
    const double slack = tolerance * (1.0 + std::abs(dx_[i]));
    int8_t set = 0;
    if (dx_[i] > problem_.x_high[i] + (x_set_[i] > 0 ? -slack : slack)) set = 1;
    if (dx_[i] < problem_.x_low[i] - (x_set_[i] < 0 ? -slack : slack)) set = -1;
    if (set != x_set_[i]) last_changed = i / nx;
    x_set_[i] = set;
  }
  return last_changed;
}

bool LqSolver::Sweep(int from, LqSummary* summary) {
  const int n = problem_.knots();
  if (from == n) kernels_->terminal(*this);
  ++summary->sweeps;
  if (!kernels_->backward(*this, std::min(from, n - 1))) {
    summary->knot = failed_knot_;
    return false;
  }
  kernels_->forward(*this);
  return true;
}

// Diagonal terms of a sweep in which x_set_ says which penalties are on.
void LqSolver::TermsFromSets(double regularization) {
  for (size_t i = 0; i < u_diagonal_.size(); ++i)
    u_diagonal_[i] = regularization * problem_.regularization_scale[i % problem_.nu()];
  std::fill(u_shift_.begin(), u_shift_.end(), 0.0);
  const int nx = problem_.nx();
  for (size_t i = nx; i < x_set_.size(); ++i) {
    const double rho = x_set_[i] == 0 ? 0.0 : problem_.rho[i % nx];
    const double threshold = x_set_[i] > 0 ? problem_.x_high[i] : problem_.x_low[i];
    x_diagonal_[i] = rho;
    x_shift_[i] = rho == 0.0 ? 0.0 : -rho * threshold;
  }
}

// Primal-dual active set: false when a Hessian is not positive definite.
bool LqSolver::SettleSets(const LqOptions& options, LqSummary* summary) {
  int changed = problem_.knots();
  for (int sweep = 0; sweep < options.max_set_sweeps && !summary->exact; ++sweep) {
    TermsFromSets(options.regularization);
    if (!Sweep(changed, summary)) return false;
    for (size_t i = 0; i < du_.size(); ++i) u_grad_[i] += u_diagonal_[i] * du_[i];
    const int control_changed = UpdateControlSet(options.tolerance);
    changed = std::max(control_changed, UpdateStateSet(options.tolerance));
    summary->exact = changed < 0;
  }
  return true;
}

LqSummary LqSolver::Solve(const LqOptions& options) {
  LqSummary summary;
  if (!SettleSets(options, &summary)) return summary;
  if (!summary.exact) {
    if (!InteriorPoint(options, &summary) || !SettleSets(options, &summary)) return summary;
    if (!summary.exact) {
      du_ = ip_u_;
      Rollout();
      summary.exact = summary.interior_converged;
    }
  }
  ClampControls();
  summary.ok = true;
  for (int8_t set : u_set_) summary.active_controls += set != 0;
  for (int8_t set : x_set_) summary.active_states += set != 0;
  return summary;
}

// dx_ from du_.
void LqSolver::Rollout() {
  const int nx = problem_.nx(), nu = problem_.nu();
  using Map = Eigen::Map<Eigen::VectorXd>;
  Map(dx_.data(), nx) = problem_.dx0;
  for (int k = 0; k < problem_.knots(); ++k) {
    Map next(&dx_[(k + 1) * nx], nx);
    next = problem_.d(k);
    next.noalias() += problem_.A(k) * dx(k);
    next.noalias() += problem_.B(k) * ConstVec(&du_[k * nu], nu);
  }
}

// Removes what rounding leaves outside a box after an exact solution.
void LqSolver::ClampControls() {
  for (size_t i = 0; i < du_.size(); ++i) du_[i] = std::clamp(du_[i], problem_.u_low[i], problem_.u_high[i]);
}

}  // namespace rg::trajectories
