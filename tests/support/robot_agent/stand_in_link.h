// The stand-in without ROS, in a given time: its arm (robot_agent/stand_in/kinova_base.h) behind the driver's own
// interface, with the manners of kinova-ros: one thread serves ticks, torques and services, a tick makes nine
// calls and stamps after the first, what is sent first is lost, an error of the interface takes all away. Faults
// that the node cannot be asked for come on top.
#pragma once

#include <atomic>
#include <memory>
#include <string>

#include "common/base/rng.h"
#include "robot_agent/drivers/driver_time.h"
#include "robot_agent/drivers/kinova/arm_link.h"
#include "robot_agent/stand_in/kinova_base.h"

namespace rg::robot_agent::stand_in {

struct LinkFaults {
  double lost_states = 0.0;        // share of the messages
  double freeze_after_s = 0.0;     // in torque mode: from then on positions stay, stamps advance (0: never)
  double hang_after_s = 0.0;       // in torque mode: from then on services do not answer in time (0: never)
  int ignored_position_modes = 0;  // position mode is asked for so often in vain, while in torque mode
  int failing_torque_modes = 0;    // the service answers so often that it failed
  double creeps_s = 0.0;           // joint 6, after torque mode
  bool away = false;               // sends no states and offers nothing
};

// The arm and what is seen of it from outside; outlives the links to it.
struct StandInArm {
  StandInArm(const StandInConfig& config, const LinkFaults& faults, uint64_t seed,
             std::shared_ptr<DriverTime> time);

  const StandInConfig config;
  LinkFaults faults;
  const std::shared_ptr<DriverTime> time;
  const int64_t epoch_ns;
  Rng random;
  std::unique_ptr<KinovaBase> base;
  double interval_s = 0.04;
  int run = 1;          // of the arm's driver
  uint32_t number = 0;  // of its next state
  bool outage_done = false;
  std::atomic<bool> outage_wanted{false}, fall_back_wanted{false}, stop_published{false};
  // What reached it.
  double most_torque_nm = 0.0, torque_mode_s = 0.0;
  int torque_modes = 0, torques = 0, outages = 0, zeroed = 0;
};

std::unique_ptr<kinova::ArmLink> LinkTo(StandInArm& arm);

}  // namespace rg::robot_agent::stand_in
