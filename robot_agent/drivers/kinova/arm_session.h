// What a preparation proved, on disk for the rollouts after it: which torque each joint answered to, when, on
// which arm. The next process that holds the arm then checks its sensors and tests no torques again.
//
// It ends by age (KinovaOptions::prepare_every_s), with the machine's boot, with another arm or another run of
// the arm's driver; whoever finds the arm other than it left it forgets it: the driver itself (an outage, a
// refused or lost torque mode, sensors off), and the agent whenever a person arms, disarms or clears the arm.
// A file that cannot be read is none.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::robot_agent::kinova {

inline constexpr char kSessionFile[] = "arm_session.json";  // in the agent's folder

// What a joint's test torque showed.
struct JointResponse {
  double torque_nm = 0.0;  // at which it moved, above gravity
  double drift_rad_per_s = 0.0;
};

struct ArmSession {
  int64_t prepared_ns = 0;  // steady clock, of this boot
  std::string arm;          // names the arm and the run of its driver
  uint32_t number = 0;      // of the last state then: a driver that begins anew counts from zero
  std::vector<JointResponse> responses;
};

class SessionFile {
 public:
  // Empty path: there is none, ever.
  explicit SessionFile(std::string path) : path_(std::move(path)) {}
  // Of this boot of the machine.
  std::optional<ArmSession> Read() const;
  Status Write(const ArmSession& session) const;
  void Forget() const;

 private:
  const std::string path_;
};

// Whether `session` still holds for `arm` at `now_ns`, whose newest state has `number`.
bool Holds(const ArmSession& session, const std::string& arm, uint32_t number, int64_t now_ns,
           double at_most_s);

}  // namespace rg::robot_agent::kinova
