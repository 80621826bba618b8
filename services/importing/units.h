// Units that a mapping may name, as factors to SI.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"

namespace rg::importing {

enum class Quantity { kAngle, kLength, kAngularVelocity, kVelocity, kTorque, kForce, kOther };

struct Unit {
  std::string name;
  Quantity quantity = Quantity::kOther;
  double to_si = 1.0;
};

// Error: not known; names those that are.
Result<Unit> ParseUnit(std::string_view name);

// "rad", "N*m", …; empty for kOther.
std::string SiName(Quantity quantity);

}  // namespace rg::importing
