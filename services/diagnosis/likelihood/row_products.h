// Products of row-major matrices, added to what is there: where fits and screens spend their time. Compiled
// for several instruction sets, the processor's best is taken; they allocate nothing.
#pragma once

#include <Eigen/Core>

namespace rg::diagnosis {

using RowMatrixXd = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
// A row-major matrix or a block of one.
using Rows = Eigen::Ref<const RowMatrixXd, 0, Eigen::OuterStride<>>;
using MutableRows = Eigen::Ref<RowMatrixXd, 0, Eigen::OuterStride<>>;

// G += s·A·B. A: a × M, B: M × b, G: a × b, which is none of the others.
void AddProduct(const Rows& A, const Rows& B, double s, MutableRows G);
// G += s·AᵀB. A: M × a, B: M × b, G: a × b.
void AddTransposedProduct(const Rows& A, const Rows& B, double s, MutableRows G);
// The same with A = B; only blocks that touch the lower triangle are computed.
void AddGram(const Rows& A, double s, MutableRows G);

}  // namespace rg::diagnosis
