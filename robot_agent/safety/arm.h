// What the safety code knows of the arm that it stands beside: its gravity and where its end effector is.
// Called in the control cycle: no allocation, no lock, bounded time.
#pragma once

namespace rg::robot_agent {

class ArmModel {
 public:
  virtual ~ArmModel() = default;
  virtual void GravityTorque(const double* q, double* tau) = 0;  // n -> n [N·m], holds the arm at rest
  virtual void Tip(const double* q, double* position) = 0;       // n -> 3 [m], end effector, base frame
};

}  // namespace rg::robot_agent
