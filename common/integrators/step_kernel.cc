// Compiled once per instruction set; includes kernel headers only.
#include "common/integrators/step_kernel.h"

#include "common/integrators/leapfrog.h"
#include "common/integrators/rk4.h"
#include "common/integrators/semi_implicit_euler.h"

namespace rg::integrators {
inline namespace RG_ISA {
namespace {

template <class T, int C, int N>
StepWorkspace<T, C, N>& In(void* scratch) {
  return *static_cast<StepWorkspace<T, C, N>*>(scratch);
}

template <class T, int C, int N>
StepKernels MakeKernels() {
  StepKernels k{};
  k.lanes = static_cast<int>(sizeof(T) / sizeof(double));
  k.capacity = C;
  k.scratch_bytes = sizeof(StepWorkspace<T, C, N>);
  k.prepare = [](const StepProgram& program, const StepValues& values, void* scratch) {
    Prepare(program, values, In<T, C, N>(scratch));
  };
  k.semi_implicit_euler = [](const StepProgram& program, const StepValues& values, const StepInput& input,
                             const Directions* directions, double* direct, const Sensitivity& from,
                             const Sensitivity& to, const StepOutput& output, void* scratch) {
    return SemiImplicitEulerStep(program, values, input, directions, direct, from, to, output,
                                 In<T, C, N>(scratch));
  };
  k.leapfrog = [](const StepProgram& program, const StepValues& values, const StepInput& input,
                  const Directions* directions, double* direct, const Sensitivity& from,
                  const Sensitivity& to, const StepOutput& output, void* scratch) {
    return LeapfrogStep(program, values, input, directions, direct, from, to, output, In<T, C, N>(scratch));
  };
  if constexpr (sizeof(T) == sizeof(double)) {
    k.rk4 = [](const StepProgram& program, const StepValues& values, const StepInput& input,
               const Directions* directions, double* direct, const Sensitivity& from, const Sensitivity& to,
               const StepOutput& output, void* scratch) {
      return Rk4Step(program, values, input, directions, direct, from, to, output, In<T, C, N>(scratch));
    };
    k.acceleration = [](const StepProgram& program, const StepValues& values, const StepInput& input,
                        double* a, void* scratch) {
      StepWorkspace<T, C, N>& s = In<T, C, N>(scratch);
      s.input.Load(program, values, input, program.tree.n);
      const LawContext<T, C> c{&program, &values, &s.input, {false, true}, s.mass, &s.laws};
      Acceleration(c, false, s);
      for (int i = 0; i < program.tree.n; ++i) a[i] = s.v1[i];
      return s.failure.Result();
    };
  }
  return k;
}

// The usual arms with their number of joints known to the compiler.
template <class T>
void FillSmall(StepKernels* kernels) {
  constexpr int C = kSmallCapacity;
  for (int n = 0; n <= C; ++n) kernels[n] = MakeKernels<T, C, 0>();
  kernels[6] = MakeKernels<T, C, 6>();
  kernels[7] = MakeKernels<T, C, 7>();
}

}  // namespace

void FillStepKernels(StepKernels* small, StepKernels* large, StepKernels* lanes) {
  FillSmall<double>(small);
  *large = MakeKernels<double, 16, 0>();
  FillSmall<math::Lanes<math::kNativeLanes>>(lanes);
}

}  // namespace RG_ISA
}  // namespace rg::integrators
