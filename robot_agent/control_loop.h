// The control loop: at a fixed rate read, judge, compute, limit, send, record.
//
// The cycle allocates nothing and takes no lock; disk and log belong to the recorder's thread. Ticks
// are at start + k·period in the driver's time. A wake-up later than half a period is a missed
// deadline; ticks that passed meanwhile are left out, counted, and not caught up.
//
// Gravity. The controller asks for whole torques. If the arm's base adds its own gravity compensation
// (DriverInfo::adds_gravity_compensation) the arm is handed command - g(q) with the g of the agent's own arm
// (safety/own_arm.h) at the measured q; otherwise the command itself. "Zero added torque", which every stop
// begins with, is g(q) in the convention of commands, so in the first case the arm is handed exactly zero.
// Both are in the recording: `command` (effort_command of the set: drives the model as it is) and `sent`.
#pragma once

#include <string>

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "robot_agent/controller.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/jitter.h"
#include "robot_agent/recorder.h"
#include "robot_agent/safety/arm.h"
#include "robot_agent/safety/monitor.h"
#include "robot_agent/safety/stop.h"

namespace rg::robot_agent {

enum class VelocitySource {
  kMeasured,
  kDifferenced,  // the monitor's own, see SafetyMonitor::Velocity; zero before there are two positions
};

// Somebody who looks on, in the control cycle: no allocation, no lock, bounded time.
class LoopObserver {
 public:
  virtual ~LoopObserver() = default;
  virtual void OnState(const RobotState& state) = 0;  // in a move
  virtual void OnSample(const Sample& sample, const JitterReport& jitter) = 0;
};

struct ControlLoopOptions {
  double rate_hz = 25.0;
  double duration_s = 6.0;
  VelocitySource velocity_source = VelocitySource::kMeasured;
  StopOptions stop;
  LoopObserver* observer = nullptr;
};

struct ControlLoopResult {
  Trip trip;  // reason is never kNone
  JitterReport jitter;
  uint64_t saturated_samples = 0;
  uint64_t commands = 0;    // of the controller, sent
  double duration_s = 0.0;  // from the first command to the trip
  bool entered = false;     // torque mode was asked for: the arm may have been under torque
  // The controller was asked for its first torque. Not before: what the arm did was its preparation.
  bool began = false;
  Status refusal;  // the driver's, if it did not enter torque mode
  StopReport stop;
};

// The arm is at rest in position mode. Judges its state and the first torque (gravity of `arm`, the agent's
// own), enters torque mode, runs for duration_s or until something trips, and always ends with StopArm.
// `operator_stop` may be set from any thread or a signal handler. `clock` measures how long cycles take.
ControlLoopResult RunControlLoop(Driver& driver, Controller& controller, ArmModel& arm,
                                 const SafetyLimits& limits, const ControlLoopOptions& options,
                                 Recorder& recorder, const CancelToken& operator_stop, const Clock& clock);

}  // namespace rg::robot_agent
