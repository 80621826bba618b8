// A window of a recording, linearised, and what its rows say of its start.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "services/diagnosis/likelihood/lifted_fit.h"
#include "services/diagnosis/likelihood/row_products.h"

namespace rg::diagnosis {

// Arrival cost of a window: a prior on the start of the bodies that effects add (a mount, a swinging mass),
// about where a simulation along the recorded motion leaves them. In directions without excitation, as across
// the plane of a planar arm, rows inform them to second order only, and a start that fits the noise diverges.
struct ArrivalCost {
  VectorXd middle;     // nx: mean
  VectorXd precision;  // nx: zero for states that only the rows inform
};

// Of every window. The stddev of a state is ten times its RMS along all windows.
std::vector<ArrivalCost> ArrivalCosts(const sim::Plant& plant, const NodeStates& carried);

// Robust cost of a residual r [stddev]: c²·log(1 + r²/c²), c = kSoft. About r² near the model; a window that
// diverges does not outweigh the others.
inline constexpr double kSoft = 20.0;

// One window, linearised in nx corrections of its start, P parameters and C features: D = nx + P + C + 1
// columns e_0 | δθ | features | what is left at e_0 = 0, δθ = 0.
struct Linear {
  RowMatrixXd rows;  // M × D, whitened; the last column is the residual
  RowMatrixXd E;     // nx rows of every node one below another, or of the last two; the last column is d
  int nx = 0;
  bool ok = true;

  auto J_e() const { return rows.leftCols(nx); }
  auto J() const { return rows.middleCols(nx, rows.cols() - nx - 1); }
  auto r() const { return rows.rightCols<1>(); }
  auto Node(long k) { return E.middleRows(k * nx, nx); }
  auto Node(long k) const { return E.middleRows(k * nx, nx); }
  long nodes() const { return E.rows() / nx; }
};

// An orthonormal basis of the columns of J_e.
RowMatrixXd BasisOf(const Rows& J_e);
// Takes from the columns what lies in those of an orthonormal basis.
void TakeOut(const RowMatrixXd& basis, RowMatrixXd* columns);
// Takes from the columns what lies in those of J_e. Returns the rank of J_e.
int ProjectOut(const Rows& J_e, RowMatrixXd* columns);

// The start of a window's states that fits best, for as many steps of the parameters as are tried: J_eᵀJ_e is
// formed and factored once.
class BestStart {
 public:
  BestStart() = default;
  BestStart(const Linear& l, const ArrivalCost& loose);  // both outlive it, the rows stay as they are
  // After a step of the parameters, relative to what the start is, `at`.
  VectorXd After(const VectorXd& step, const VectorXd& at) const;

 private:
  const Linear* l_ = nullptr;
  const ArrivalCost* loose_ = nullptr;
  VectorXd scale_;
  Eigen::LDLT<MatrixXd> factor_;
};

// Rows that lie far off weigh as they count in the costs that are compared, or windows that explode would
// lead where no cost falls: d(c²·log(1 + r²/c²))/d(r²). `at`: the window's start.
void RobustWeights(const ArrivalCost& loose, const VectorXd& at, Linear* l);

}  // namespace rg::diagnosis
