#include "common/integrators/step_kernel.h"
#include "common/math/isa.h"

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
  Table() {
    switch (math::DetectIsa()) {
      case math::Isa::kV1:
        isa_v1::FillStepKernels(small, &large, lanes);
        break;
      case math::Isa::kV3:
        isa_v3::FillStepKernels(small, &large, lanes);
        break;
      case math::Isa::kV4:
        isa_v4::FillStepKernels(small, &large, lanes);
        break;
    }
  }
};

const Table& Kernels() {
  static const Table table;
  return table;
}

}  // namespace

const StepKernels& GetStepKernels(int n) {
  return n <= kSmallCapacity ? Kernels().small[n] : Kernels().large;
}

const StepKernels* GetLaneStepKernels(int n) { return n <= kSmallCapacity ? &Kernels().lanes[n] : nullptr; }

}  // namespace rg::integrators
