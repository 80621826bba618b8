// Degrees and radians as types, so that one cannot be handed over for the other: kinova-ros reports joint
// states in radians and takes poses in degrees.
#pragma once

#include <cmath>
#include <cstdint>

namespace rg::robot_agent::kinova {

struct Radians {
  double value = 0.0;
};
struct Degrees {
  double value = 0.0;
};

inline constexpr double kPi = 3.14159265358979323846;

inline int64_t Nanos(double seconds) { return std::llround(1e9 * seconds); }

constexpr Degrees ToDegrees(Radians angle) { return {angle.value * 180.0 / kPi}; }
constexpr Radians ToRadians(Degrees angle) { return {angle.value * kPi / 180.0}; }

}  // namespace rg::robot_agent::kinova
