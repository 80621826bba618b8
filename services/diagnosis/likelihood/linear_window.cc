#include "services/diagnosis/likelihood/linear_window.h"

#include <Eigen/QR>

namespace rg::diagnosis {

int ProjectOut(const Rows& J_e, RowMatrixXd* columns) {
  // Columns of very different size (a state that is forgotten at once) are scaled first.
  MatrixXd scaled = J_e;
  for (int c = 0; c < scaled.cols(); ++c) {
    const double norm = scaled.col(c).norm();
    if (norm > 0) scaled.col(c) /= norm;
  }
  const Eigen::ColPivHouseholderQR<MatrixXd> qr(scaled);
  const RowMatrixXd Q = qr.householderQ() * MatrixXd::Identity(scaled.rows(), qr.rank());
  RowMatrixXd along = RowMatrixXd::Zero(Q.cols(), columns->cols());
  AddTransposedProduct(Q, *columns, 1.0, along);
  AddProduct(Q, along, -1.0, *columns);
  return static_cast<int>(qr.rank());
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
