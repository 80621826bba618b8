// The one way in which an arm is stopped. Every end comes here: a rollout that completed, a limit, an
// operator, a cancelled job, a lost driver, a signal, a drain. In torque mode the caller has sent zero added
// torque before (SafetyMonitor); here the arm goes to position mode, and that is believed only when it can be
// seen: the call returned, and the differenced speed of every joint stays below at_rest for at_rest_s.
// Otherwise the call is repeated; what is not confirmed in the end is for the caller to latch (latch.h). An arm
// that is away (a driver that starts again) is asked until it is back, attempts · attempt_s at the least.
//
// Nothing interrupts it. Waits in the driver's time, by the machine's clock where the driver is lost.
#pragma once

#include <string>

#include "robot_agent/drivers/driver.h"

namespace rg::robot_agent {

struct StopOptions {
  double at_rest = 0.02;    // rad/s (m/s)
  double at_rest_s = 0.3;   // without a break
  double baseline_s = 0.1;  // positions so far apart are differenced
  double attempt_s = 1.5;   // each attempt: for the arm to take the call, then to come to rest
  int attempts = 3;
  double call_s = kLongestCall;  // the longest that one call of the driver takes
};

struct StopReport {
  bool confirmed = false;
  int attempts = 0;
  double took_s = 0.0;     // until confirmed or given up, driver's time
  double worst_speed = 0;  // of the last look, rad/s; negative: none was possible
  std::string why;         // not confirmed: what was seen
};

StopReport StopArm(Driver& driver, const StopOptions& options = {});

// The longest that StopArm takes, s.
constexpr double LongestStop(const StopOptions& options = {}) {
  constexpr double kLastLooks = 0.1;
  return options.attempts * (2 * options.attempt_s + options.call_s + kLastLooks);
}

// The longest from the word that ends a rollout to the end of its task, s: an entry into torque mode whose guard does
// not answer is given up, the arm is stopped, the recording is finished. Whoever could end the task's process meanwhile (the
// worker after a cancel, the agent after a second signal) waits for this.
constexpr double LongestEnd(const StopOptions& options = {}) {
  constexpr double kRecording = 10.0;
  return kLongestEntry + LongestStop(options) + kRecording;
}

}  // namespace rg::robot_agent
