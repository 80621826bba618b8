// Where an entry of the kernels' sensitivities lies (integrators/step_program.h). Private to this folder.
#pragma once

#include <cstddef>

#include "common/integrators/step_kernel.h"

namespace rg::sim::internal {

// Rows: 0: q, 1: v, 2 + k: internal state k of the joint. Columns: directions. With lanes, each entry is one
// number per window.
struct SensitivityLayout {
  int capacity = 0, lanes = 1, rows = 0;

  SensitivityLayout() = default;
  SensitivityLayout(const integrators::StepProgram& program, const integrators::StepKernels& kernels)
      : capacity(kernels.capacity), lanes(kernels.lanes), rows(2 + program.max_states) {}

  size_t column_size() const { return static_cast<size_t>(rows) * capacity * lanes; }
  // From a column's first number.
  size_t Offset(int row, int joint, int lane) const {
    return (static_cast<size_t>(row) * capacity + joint) * lanes + lane;
  }
};

// One row of the sensitivities in one lane.
struct SensitivityRow {
  const double* first;
  size_t step;  // from column to column

  double operator[](int column) const { return first[column * step]; }
};

}  // namespace rg::sim::internal
