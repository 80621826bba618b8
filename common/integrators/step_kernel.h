// The integrators as plain functions, a table per instruction set (common/math/isa.h).
#pragma once

#include <cstddef>

#include "common/integrators/step_program.h"
#include "common/math/isa.h"

namespace rg::integrators {

// One step. `scratch` is a workspace that `prepare` has filled; with directions == nullptr no
// sensitivities are computed and direct, from, to are not used. `direct` is 4·columns × capacity × lanes
// numbers, zero at the start, 64-byte aligned, private to the kernels between calls. output may be the
// input's arrays; `to` may be `from` but in rk4.
using StepFunction = StepResult (*)(const StepProgram& program, const StepValues& values,
                                    const StepInput& input, const Directions* directions, double* direct,
                                    const Sensitivity& from, const Sensitivity& to, const StepOutput& output,
                                    void* scratch);

struct StepKernels {
  int lanes;             // windows that a step takes side by side (StepInput)
  int capacity;          // most laws
  size_t scratch_bytes;  // to be aligned to 64
  // Makes a zeroed block of scratch_bytes a workspace, then takes over program and values; again after
  // each change of either.
  void (*prepare)(const StepProgram& program, const StepValues& values, void* scratch);
  StepFunction semi_implicit_euler;
  StepFunction leapfrog;
  // Null in lanes.
  StepFunction rk4;
  // Acceleration a (n) at input.q, input.v under instantaneous forces.
  StepResult (*acceleration)(const StepProgram& program, const StepValues& values, const StepInput& input,
                             double* a, void* scratch);
};

// Plants of up to so many laws (joints and coupled drives) have kernels of this capacity, those of six and seven with the number of
// joints known to the compiler.
inline constexpr int kSmallCapacity = 8;

// For a plant's program on an instruction set that the processor has.
const StepKernels& GetStepKernels(const StepProgram& program, math::Isa isa);
// As many windows side by side as a register of the processor holds; null for plants with too many laws. A
// window's result does not depend, not by a bit, on what the other lanes hold.
const StepKernels* GetLaneStepKernels(const StepProgram& program, math::Isa isa);

}  // namespace rg::integrators
