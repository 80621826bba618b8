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
        return isa_v1::FillStepKernels(&small, &large);
      case math::Isa::kV3:
        return isa_v3::FillStepKernels(&small, &large);
      case math::Isa::kV4:
        return isa_v4::FillStepKernels(&small, &large);
    }
  }
};

}  // namespace

const StepKernels& GetStepKernels(int n) {
  static const Table table;
  return n <= 8 ? table.small : table.large;
}

}  // namespace rg::integrators
