// Compiled once per instruction set; includes kernel headers only.
#include "common/integrators/step_kernel.h"

#include "common/integrators/leapfrog.h"
#include "common/integrators/rk4.h"
#include "common/integrators/semi_implicit_euler.h"

namespace rg::integrators {
inline namespace RG_ISA {
namespace {

template <int C>
StepWorkspace<C>& In(void* scratch) {
  return *static_cast<StepWorkspace<C>*>(scratch);
}

template <int C>
StepKernels MakeKernels() {
  StepKernels k;
  k.scratch_bytes = sizeof(StepWorkspace<C>);
  k.prepare = [](const StepProgram& program, const StepValues& values, void* scratch) {
    Prepare(program, values, In<C>(scratch));
  };
  k.semi_implicit_euler = [](const StepProgram& program, const StepValues& values, const StepInput& input,
                             const Directions* directions, double* direct, const Sensitivity& from,
                             const Sensitivity& to, const StepOutput& output, void* scratch) {
    return SemiImplicitEulerStep(program, values, input, directions, direct, from, to, output,
                                 In<C>(scratch));
  };
  k.leapfrog = [](const StepProgram& program, const StepValues& values, const StepInput& input,
                  const Directions* directions, double* direct, const Sensitivity& from,
                  const Sensitivity& to, const StepOutput& output, void* scratch) {
    return LeapfrogStep(program, values, input, directions, direct, from, to, output, In<C>(scratch));
  };
  k.rk4 = [](const StepProgram& program, const StepValues& values, const StepInput& input,
             const Directions* directions, double* direct, const Sensitivity& from, const Sensitivity& to,
             const StepOutput& output, void* scratch) {
    return Rk4Step(program, values, input, directions, direct, from, to, output, In<C>(scratch));
  };
  k.acceleration = [](const StepProgram& program, const StepValues& values, const StepInput& input, double* a,
                      void* scratch) {
    StepWorkspace<C>& s = In<C>(scratch);
    const LawContext c{&program, &values, &input, {false, true}, s.mass, s.rough};
    const StepResult result = Acceleration(c, input.q, input.v, false, s);
    for (int i = 0; i < program.tree.n; ++i) a[i] = s.v1[i];
    return result;
  };
  k.mass_matrix = [](const StepProgram& program, const double* q, double* M, void* scratch) {
    StepWorkspace<C>& s = In<C>(scratch);
    dynamics::CompositeRigidBody(program.tree, s.inertias, q, s.w);
    const int n = program.tree.n;
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) M[i * n + j] = s.w.M[j][i];
    }
  };
  return k;
}

}  // namespace

void FillStepKernels(StepKernels* small, StepKernels* large) {
  *small = MakeKernels<8>();
  *large = MakeKernels<16>();
}

}  // namespace RG_ISA
}  // namespace rg::integrators
