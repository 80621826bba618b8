#include "robot_agent/drivers/kinova/unwrapping.h"

#include <cmath>

namespace rg::robot_agent::kinova {

Radians Unwrapper::Unwrap(Radians raw) {
  if (!continuous_ || !std::isfinite(raw.value)) return raw;
  // The last angle is the reference of the next: what is further away than half a turn is another turn.
  turns_ = static_cast<int>(std::lround((raw.value - reference_.value) / kTurn));
  reference_ = {raw.value - turns_ * kTurn};
  return reference_;
}

}  // namespace rg::robot_agent::kinova
