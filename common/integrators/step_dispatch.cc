#include "common/base/check.h"
#include "common/integrators/step_kernel.h"

namespace rg::integrators {

inline namespace isa_v1 {
void FillStepKernels(StepKernels* small, StepKernels* large, StepKernels* lanes);
}
namespace isa_v3 {
void FillStepKernels(StepKernels* small, StepKernels* large, StepKernels* lanes);
}
namespace isa_v4 {
void FillStepKernels(StepKernels* small, StepKernels* large, StepKernels* lanes);
}

namespace {

struct Table {
  StepKernels small[kSmallCapacity + 1], large, lanes[kSmallCapacity + 1];  // by the number of joints
  explicit Table(void (*fill)(StepKernels*, StepKernels*, StepKernels*)) { fill(small, &large, lanes); }
};

// Filled where they are asked for: only then the processor is sure to have what fills them.
const Table& Kernels(math::Isa isa) {
  RG_CHECK(math::IsaSupported(isa)) << math::IsaName(isa);
  switch (isa) {
    case math::Isa::kV4: {
      static const Table v4(isa_v4::FillStepKernels);
      return v4;
    }
    case math::Isa::kV3: {
      static const Table v3(isa_v3::FillStepKernels);
      return v3;
    }
    case math::Isa::kV1:
      break;
  }
  static const Table v1(isa_v1::FillStepKernels);
  return v1;
}

}  // namespace

const StepKernels& GetStepKernels(const StepProgram& program, math::Isa isa) {
  return program.num_laws() <= kSmallCapacity ? Kernels(isa).small[program.tree.n] : Kernels(isa).large;
}

const StepKernels* GetLaneStepKernels(const StepProgram& program, math::Isa isa) {
  return program.num_laws() <= kSmallCapacity ? &Kernels(isa).lanes[program.tree.n] : nullptr;
}

}  // namespace rg::integrators
