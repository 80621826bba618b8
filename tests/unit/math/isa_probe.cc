#include "tests/unit/math/isa_probe.h"

namespace rg::math {

// One definition per instruction set in isa_probe_kernels.cc. (isa_v1 is this unit's inline one.)
namespace isa_v1 {
extern const IsaProbe kIsaProbe;
}
namespace isa_v3 {
extern const IsaProbe kIsaProbe;
}
namespace isa_v4 {
extern const IsaProbe kIsaProbe;
}

const IsaProbe& GetProbe(Isa isa) {
  switch (isa) {
    case Isa::kV4:
      return isa_v4::kIsaProbe;
    case Isa::kV3:
      return isa_v3::kIsaProbe;
    case Isa::kV1:
      break;
  }
  return isa_v1::kIsaProbe;
}

}  // namespace rg::math
