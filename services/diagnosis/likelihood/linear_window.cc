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

}  // namespace rg::diagnosis
