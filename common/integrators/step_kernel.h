// The integrators as plain functions, chosen once for the processor at hand (common/math/isa.h).
#pragma once

#include <cstddef>

#include "common/integrators/step_program.h"

namespace rg::integrators {

// One step. `scratch` is a workspace that `prepare` has filled; with directions == nullptr no
// sensitivities are computed and direct, from, to are not used. `direct` is 4·n × stride, zero at the
// start, 64-byte aligned, private to the kernels between calls. output may be the input's arrays; `from` and
// `to` must differ.
using StepFunction = StepResult (*)(const StepProgram& program, const StepValues& values,
                                    const StepInput& input, const Directions* directions, double* direct,
                                    const Sensitivity& from, const Sensitivity& to, const StepOutput& output,
                                    void* scratch);

struct StepKernels {
  size_t scratch_bytes;  // to be aligned to 64
  // Makes a zeroed block of scratch_bytes a workspace, then takes over program and values; again after
  // each change of either.
  void (*prepare)(const StepProgram& program, const StepValues& values, void* scratch);
  StepFunction semi_implicit_euler;
  StepFunction leapfrog;
  StepFunction rk4;
  // Acceleration a (n) at input.q, input.v under instantaneous forces.
  StepResult (*acceleration)(const StepProgram& program, const StepValues& values, const StepInput& input,
                             double* a, void* scratch);
  // Mass matrix at q (n × n, row-major, without rotor inertia).
  void (*mass_matrix)(const StepProgram& program, const double* q, double* M, void* scratch);
};

// For plants of up to n joints.
const StepKernels& GetStepKernels(int n);

}  // namespace rg::integrators
