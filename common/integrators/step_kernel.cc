// Compiled once per instruction set; includes kernel headers only.
#include "common/integrators/step_kernel.h"

#include "common/integrators/leapfrog.h"
#include "common/integrators/rk4.h"
#include "common/integrators/semi_implicit_euler.h"

namespace rg::integrators {
inline namespace RG_ISA {
namespace {

template <class T, int C>
StepWorkspace<T, C>& In(void* scratch) {
  return *static_cast<StepWorkspace<T, C>*>(scratch);
}

template <class T, int C>
StepKernels MakeKernels() {
  StepKernels k{};
  k.lanes = static_cast<int>(sizeof(T) / sizeof(double));
  k.capacity = C;
  k.scratch_bytes = sizeof(StepWorkspace<T, C>);
  k.prepare = [](const StepProgram& program, const StepValues& values, void* scratch) {
    Prepare(program, values, In<T, C>(scratch));
  };
  k.semi_implicit_euler = [](const StepProgram& program, const StepValues& values, const StepInput& input,
                             const Directions* directions, double* direct, const Sensitivity& from,
                             const Sensitivity& to, const StepOutput& output, void* scratch) {
    return SemiImplicitEulerStep(program, values, input, directions, direct, from, to, output,
                                 In<T, C>(scratch));
  };
  k.leapfrog = [](const StepProgram& program, const StepValues& values, const StepInput& input,
                  const Directions* directions, double* direct, const Sensitivity& from,
                  const Sensitivity& to, const StepOutput& output, void* scratch) {
    return LeapfrogStep(program, values, input, directions, direct, from, to, output, In<T, C>(scratch));
  };
  if constexpr (sizeof(T) == sizeof(double)) {
    k.rk4 = [](const StepProgram& program, const StepValues& values, const StepInput& input,
               const Directions* directions, double* direct, const Sensitivity& from, const Sensitivity& to,
               const StepOutput& output, void* scratch) {
      return Rk4Step(program, values, input, directions, direct, from, to, output, In<T, C>(scratch));
    };
    k.acceleration = [](const StepProgram& program, const StepValues& values, const StepInput& input,
                        double* a, void* scratch) {
      StepWorkspace<T, C>& s = In<T, C>(scratch);
      s.input.Load(input, program.tree.n);
      const LawContext<T, C> c{&program, &values, &s.input, {false, true}, s.mass, &s.laws};
      Acceleration(c, false, s);
      for (int i = 0; i < program.tree.n; ++i) a[i] = s.v1[i];
      return s.failure.Result();
    };
  }
  return k;
}

}  // namespace

void FillStepKernels(StepKernels* small, StepKernels* large, StepKernels* lanes) {
  *small = MakeKernels<double, 8>();
  *large = MakeKernels<double, 16>();
  *lanes = MakeKernels<math::Lanes<math::kNativeLanes>, 8>();
}

}  // namespace RG_ISA
}  // namespace rg::integrators
