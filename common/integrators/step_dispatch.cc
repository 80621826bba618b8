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
  StepKernels small, large, lanes;
  Table() {
    switch (math::DetectIsa()) {
      case math::Isa::kV1:
        isa_v1::FillStepKernels(&small, &large, &lanes);
        break;
      case math::Isa::kV3:
        isa_v3::FillStepKernels(&small, &large, &lanes);
        break;
      case math::Isa::kV4:
        isa_v4::FillStepKernels(&small, &large, &lanes);
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
  return n <= Kernels().small.capacity ? Kernels().small : Kernels().large;
}

const StepKernels* GetLaneStepKernels(int n) {
  return n <= Kernels().lanes.capacity ? &Kernels().lanes : nullptr;
}

}  // namespace rg::integrators
