// The dynamics of a simulation step with one window per SIMD lane, for the benchmark.
#pragma once

#include "common/dynamics/tree.h"

namespace rg::dynamics {

struct LaneBenchmark {
  int lanes;
  // State of all lanes in a buffer of its own; phi: 10 × n nominal body parameters.
  void* (*make)(const Tree& tree, const double* phi);
  void (*run)(const Tree& tree, void* state);
  void (*destroy)(void* state);
};

}  // namespace rg::dynamics
