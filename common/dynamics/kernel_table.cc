#include "common/dynamics/kernel_table.h"

#include "common/base/check.h"

namespace rg::dynamics {

// One definition per instruction set in double_kernels.cc.
namespace isa_v1 {
extern const KernelTable kDoubleKernels;
}
namespace isa_v3 {
extern const KernelTable kDoubleKernels;
}
namespace isa_v4 {
extern const KernelTable kDoubleKernels;
}

const KernelTable& GetKernels(math::Isa isa) {
  RG_CHECK(math::IsaSupported(isa)) << math::IsaName(isa);
  switch (isa) {
    case math::Isa::kV4:
      return isa_v4::kDoubleKernels;
    case math::Isa::kV3:
      return isa_v3::kDoubleKernels;
    case math::Isa::kV1:
      break;
  }
  return isa_v1::kDoubleKernels;
}

}  // namespace rg::dynamics
