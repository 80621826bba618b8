// A move in position mode, homing above all, with every state on the way judged by the monitor and a stop
// that is heard at once. Ends like everything else: at rest and seen to be, or by StopArm.
#pragma once

#include <functional>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/safety/arm.h"
#include "robot_agent/safety/limits.h"
#include "robot_agent/safety/monitor.h"
#include "robot_agent/safety/stop.h"

namespace rg::robot_agent {

struct MoveOptions {
  double tolerance = 0.05;  // rad (m), per joint
  double timeout_s = 60.0;
  double settle_s = 0.3;  // watched at rest after it arrived
  double stall_s = 3.0;   // the arm says that it does not move, and is not there
  StopOptions stop;
  std::function<void(const RobotState&)> on_state;  // may be empty
};

struct MoveOutcome {
  // Ok: there, and at rest. kCancelled: stopped by the operator; kDeadlineExceeded: not there in time;
  // kFailedPrecondition: the monitor tripped, in words, or the arm stopped short by itself; else the driver's
  // own error.
  Status status;
  Trip trip;
  StopReport stop;  // of a move that did not arrive
};

// q: n. The arm is in position mode, at rest.
MoveOutcome MoveUnderWatch(Driver& driver, ArmModel& arm, const SafetyLimits& limits, const double* q,
                           const MoveOptions& options, const CancelToken& operator_stop);

}  // namespace rg::robot_agent
