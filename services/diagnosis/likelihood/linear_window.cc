#include "services/diagnosis/likelihood/linear_window.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <string>

namespace rg::diagnosis {

namespace {

constexpr double kLoose = 10.0;        // prior stddev over RMS
constexpr double kLeastMotion = 1e-6;  // least prior stddev: rad, m, or per second

}  // namespace

std::vector<ArrivalCost> ArrivalCosts(const sim::Plant& plant, const NodeStates& carried) {
  const long nx = plant.num_states(), first = 2L * plant.num_joints();
  VectorXd precision = VectorXd::Zero(nx);
  for (long i = first; i < nx; ++i) {
    const std::string& name = plant.internal_state_names()[static_cast<size_t>(i - first)];
    if (name.rfind("position.", 0) != 0 && name.rfind("velocity.", 0) != 0) continue;
    double squares = 0, count = 0;
    for (const MatrixXd& states : carried) {
      squares += states.row(i).squaredNorm();
      count += static_cast<double>(states.cols());
    }
    const double stddev = std::max(kLeastMotion, kLoose * std::sqrt(squares / std::max(1.0, count)));
    if (std::isfinite(stddev)) precision[i] = 1.0 / (stddev * stddev);
  }
  std::vector<ArrivalCost> out;
  for (const MatrixXd& states : carried) out.push_back({states.col(0), precision});
  return out;
}

RowMatrixXd BasisOf(const Rows& J_e) {
  // Columns of very different size (a state that is forgotten at once) are scaled first.
  MatrixXd scaled = J_e;
  for (int c = 0; c < scaled.cols(); ++c) {
    const double norm = scaled.col(c).norm();
    if (norm > 0) scaled.col(c) /= norm;
  }
  const Eigen::ColPivHouseholderQR<MatrixXd> qr(scaled);
  return qr.householderQ() * MatrixXd::Identity(scaled.rows(), qr.rank());
}

void TakeOut(const RowMatrixXd& basis, RowMatrixXd* columns) {
  RowMatrixXd along = RowMatrixXd::Zero(basis.cols(), columns->cols());
  AddTransposedProduct(basis, *columns, 1.0, along);
  AddProduct(basis, along, -1.0, *columns);
}

int ProjectOut(const Rows& J_e, RowMatrixXd* columns) {
  const RowMatrixXd basis = BasisOf(J_e);
  TakeOut(basis, columns);
  return static_cast<int>(basis.cols());
}

BestStart::BestStart(const Linear& l, const ArrivalCost& loose) : l_(&l), loose_(&loose) {
  RowMatrixXd gram = RowMatrixXd::Zero(l.nx, l.nx);
  AddGram(l.J_e(), 1.0, gram);
  MatrixXd JJ = gram.selfadjointView<Eigen::Lower>();
  JJ.diagonal().array() += 1e-9 * JJ.diagonal().maxCoeff() + 1e-12;
  JJ.diagonal() += loose.precision;
  scale_ = JJ.diagonal().cwiseSqrt().cwiseInverse();
  MatrixXd S = scale_.asDiagonal() * JJ * scale_.asDiagonal();
  S.diagonal().array() += 1e-10;
  factor_.compute(S);
}

VectorXd BestStart::After(const VectorXd& step, const VectorXd& at) const {
  const VectorXd rest = l_->r() - l_->J() * step;
  const VectorXd b =
      scale_.cwiseProduct(l_->J_e().transpose() * rest + loose_->precision.cwiseProduct(loose_->middle - at));
  return scale_.cwiseProduct(factor_.solve(b));
}

void RobustWeights(const ArrivalCost& loose, const VectorXd& at, Linear* l) {
  const BestStart best(*l, loose);
  const VectorXd rest = l->r() - l->J_e() * best.After(VectorXd::Zero(l->J().cols()), at);
  const VectorXd weight = (1.0 + rest.array().square() / (kSoft * kSoft)).rsqrt();
  l->rows.array().colwise() *= weight.array();
}

}  // namespace rg::diagnosis
