#include "common/sim/trajectory.h"

#include <cstdio>

namespace rg::sim {

std::string Outcome::ToString() const {
  const char* what = "ok";
  switch (kind) {
    case Kind::kOk:
      return what;
    case Kind::kNonFinite:
      what = "not finite";
      break;
    case Kind::kMassMatrixNotPositive:
      what = "mass matrix not positive definite";
      break;
    case Kind::kNotConverged:
      what = "joint forces without a solution";
      break;
  }
  char text[96];
  std::snprintf(text, sizeof text, "%s at step %ld (t = %.6g s), ", what, step, time);
  return text + joint;
}

}  // namespace rg::sim
