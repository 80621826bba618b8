// What the safety code knows of the arm that it stands beside: its gravity and where its end effector is.
// Called in the control cycle: no allocation, no lock, bounded time.
#pragma once

#include <limits>

namespace rg::robot_agent {

class ArmModel {
 public:
  virtual ~ArmModel() = default;
  virtual void GravityTorque(const double* q, double* tau) = 0;  // n -> n [N·m], holds the arm at rest
  virtual void Tip(const double* q, double* position) = 0;       // n -> 3 [m], end effector, base frame
  // m between the two parts of the arm that have to stay apart and are nearest to each other; negative: they
  // overlap. `pair`: which two, by their place in the configuration. Infinite: nothing is known of parts.
  virtual double Clearance(const double* q, int* pair) {
    (void)q;
    *pair = -1;
    return std::numeric_limits<double>::infinity();
  }
};

}  // namespace rg::robot_agent
