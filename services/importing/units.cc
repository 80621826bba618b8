#include "services/importing/units.h"

#include <numbers>

#include "services/importing/log.h"

namespace rg::importing {
namespace {

const std::vector<Unit>& Units() {
  constexpr double kTurn = 2.0 * std::numbers::pi;
  constexpr double kDegree = std::numbers::pi / 180.0;
  using Q = Quantity;
  static const std::vector<Unit> units = {
      {"rad", Q::kAngle, 1.0},
      {"mrad", Q::kAngle, 1e-3},
      {"deg", Q::kAngle, kDegree},
      {"turn", Q::kAngle, kTurn},
      {"m", Q::kLength, 1.0},
      {"mm", Q::kLength, 1e-3},
      {"cm", Q::kLength, 1e-2},
      {"rad/s", Q::kAngularVelocity, 1.0},
      {"mrad/s", Q::kAngularVelocity, 1e-3},
      {"deg/s", Q::kAngularVelocity, kDegree},
      {"rpm", Q::kAngularVelocity, kTurn / 60.0},
      {"turn/s", Q::kAngularVelocity, kTurn},
      {"m/s", Q::kVelocity, 1.0},
      {"mm/s", Q::kVelocity, 1e-3},
      {"cm/s", Q::kVelocity, 1e-2},
      {"N*m", Q::kTorque, 1.0},
      {"Nm", Q::kTorque, 1.0},
      {"N·m", Q::kTorque, 1.0},
      {"mN*m", Q::kTorque, 1e-3},
      {"N", Q::kForce, 1.0},
      {"mN", Q::kForce, 1e-3},
      {"kN", Q::kForce, 1e3},
      {"A", Q::kOther, 1.0},
      {"mA", Q::kOther, 1e-3},
      {"V", Q::kOther, 1.0},
      {"degC", Q::kOther, 1.0},
      {"1", Q::kOther, 1.0},
  };
  return units;
}

}  // namespace

Result<Unit> ParseUnit(std::string_view name) {
  std::string known;
  for (const Unit& unit : Units()) {
    if (unit.name == name) return unit;
    known += (known.empty() ? "" : ", ") + unit.name;
  }
  return InvalidError("unit " + Shown(name) + " is not known (" + known + ")");
}

std::string SiName(Quantity quantity) {
  switch (quantity) {
    case Quantity::kAngle:
      return "rad";
    case Quantity::kLength:
      return "m";
    case Quantity::kAngularVelocity:
      return "rad/s";
    case Quantity::kVelocity:
      return "m/s";
    case Quantity::kTorque:
      return "N*m";
    case Quantity::kForce:
      return "N";
    default:
      return "";
  }
}

}  // namespace rg::importing
