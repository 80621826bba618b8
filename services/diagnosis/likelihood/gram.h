// G += s·AᵀB for tall, row-major matrices: where a screen spends its time.
#pragma once

#include <Eigen/Core>

namespace rg::diagnosis {

using RowMatrixXd = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// A: M × a, B: M × b, G: a × b. Compiled for several instruction sets, the processor's best is taken;
// allocates nothing.
void AddTransposedProduct(const RowMatrixXd& A, const RowMatrixXd& B, double s, RowMatrixXd* G);
// The same with A = B; only blocks that touch the lower triangle are computed.
void AddGram(const RowMatrixXd& A, double s, RowMatrixXd* G);

}  // namespace rg::diagnosis
