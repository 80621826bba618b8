// The arm's topics, services and action as the driver uses them, without ROS's types: the driver's
// sequence knows nothing of roscpp, and roscpp nothing of the sequence.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "robot_agent/drivers/kinova/joint_report.h"
#include "robot_agent/drivers/kinova/kinova_options.h"
#include "robot_agent/drivers/kinova/units.h"

namespace rg::robot_agent::kinova {

enum class ArmService { kTorqueMode, kPositionMode, kZeroTorques, kTorqueParameters };

class ArmLink {
 public:
  // A report, or why a message was none.
  using Listener = std::function<void(const Result<JointReport>&)>;

  virtual ~ArmLink() = default;  // the listener is not called after it

  // Fails at once if there is no master (kUnavailable). The listener is called from the link's thread. Again: what
  // was open is given up, as a master that was started again knows nothing of it.
  virtual Status Open(Listener listener) = 0;
  // Whether the arm's driver listens to torques: what is sent earlier is lost.
  virtual bool TorquesAreHeard() const = 0;
  // Does not wait. Any thread.
  virtual void PublishTorque(const JointArray& tau) = 0;
  // kUnavailable: there is no master. kNotFound: it is not offered. kFailedPrecondition: it answered that it failed,
  // or its driver went away meanwhile. kDeadlineExceeded: no answer within `timeout_s`. One thread at a time.
  virtual Status Call(ArmService service, double timeout_s) = 0;
  // Raw angles, all joints; kNotFound: it is not offered; kAborted: the arm's driver gave up on the way, or it was
  // cancelled; kDeadlineExceeded: not there in time. Once `stop` is set no way begins any more, and it returns within
  // half a second, whether the arm's driver answers or not.
  virtual Status MoveTo(const std::vector<Degrees>& pose, double timeout_s, const std::atomic<bool>& stop) = 0;
  // Ends the way of a MoveTo that another thread waits in, whose `stop` is set already. Any thread.
  virtual void CancelMove() = 0;
  // Something was published on KinovaOptions::stop_topic since Open. Any thread.
  virtual bool StopAsked() const = 0;
  // Names the arm's driver as long as it runs, and is another when it was started again; empty: unknown.
  virtual std::string RunOfDriver() const = 0;
  // The arm's driver's parameter status_interval_seconds, s.
  virtual std::optional<double> StatusInterval() const = 0;
};

}  // namespace rg::robot_agent::kinova
