// The arm behind kinova-ros, without ROS: base firmware, drives and joints as its programming interface
// shows them, in degrees. The physics are the simulated robot's (simulated_robot/robot_world.h).
//
// Pure function of calls and their times; deterministic by seed. Time starts at zero. One thread at a time.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "robot_agent/drivers/kinova/units.h"
#include "robot_agent/stand_in/stand_in_config.h"

namespace rg::robot_agent::stand_in {

class KinovaBase {
 public:
  static Result<std::unique_ptr<KinovaBase>> Create(const StandInConfig& config, uint64_t seed);
  ~KinovaBase();

  int joints() const;
  void AdvanceTo(int64_t time_ns);

  // Measured. Angles count turns; velocities are wrong by the truth's factors; torques (N·m) by the sensors'
  // offsets, until ZeroTorques.
  std::vector<kinova::Degrees> Angles();
  std::vector<kinova::Degrees> Velocities();  // per second
  std::vector<double> Torques();
  bool in_torque_mode() const;

  // A refusal says nothing.
  void SetTorqueMode(bool on);
  // N·m, added to the base's gravity compensation; without one for 250 ms: zero.
  void SendTorque(const std::vector<double>& tau);
  // What every sensor reads now is zero from now on.
  void ZeroTorques();
  void MoveTo(const std::vector<kinova::Degrees>& pose);
  void Stop();  // position mode, here

  // For tests and logs: times torque mode was asked for and refused; time of the present one, s.
  int refusals() const;
  double seconds_in_torque_mode() const;
  // What went wrong with the physics; empty: nothing.
  const std::string& failure() const;

 private:
  struct Parts;
  explicit KinovaBase(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace rg::robot_agent::stand_in
