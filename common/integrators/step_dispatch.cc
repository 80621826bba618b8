#include "common/integrators/step_kernel.h"
#include "common/math/isa.h"

namespace rg::integrators {

inline namespace isa_v1 {
void FillStepKernels(StepKernels* small, StepKernels* large);
}
namespace isa_v3 {
void FillStepKernels(StepKernels* small, StepKernels* large);
}
namespace isa_v4 {
void FillStepKernels(StepKernels* small, StepKernels* large);
}

namespace {

struct Table {
  StepKernels small, large;
  Table() {
    switch (math::DetectIsa()) {
      case math::Isa::kV1:
        isa_v1::FillStepKernels(&small, &large);
        break;
      case math::Isa::kV3:
        isa_v3::FillStepKernels(&small, &large);
        break;
      case math::Isa::kV4:
        isa_v4::FillStepKernels(&small, &large);
        break;
    }
  }
};

}  // namespace

const StepKernels& GetStepKernels(int n) {
  static const Table table;
  return n <= 8 ? table.small : table.large;
}

}  // namespace rg::integrators
