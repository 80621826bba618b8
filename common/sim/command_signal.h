// The commanded torque as a function of time, and its average over an interval.
//
//   zero_order   u(t) = values(:, k) for times[k] <= t < times[k+1]    (effort_command)
//   linear       u(t) between the rows                                 (effort_measured)
// Before the first and after the last time the nearest value holds.
//
// The simulator takes averages over a step, shifted by the actuator delay T:
//   ū = 1/h ∫_{t−T}^{t+h−T} u ds ,   dū/dT = (u(t−T) − u(t+h−T)) / h ,
// so that a command that changes inside a step, and the delay itself, act smoothly.
//
// Joints that move as they are told (Plant::prescribed) have their motion beside it; their rows drive
// nothing.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "common/base/status.h"
#include "common/sim/given_motion.h"

namespace rg::sim {

enum class Hold { kZeroOrder, kLinear };

class CommandSignal {
 public:
  CommandSignal() = default;  // no joints, no rows
  // times: K ≥ 1, strictly increasing, s; values: n × K, N·m. Refuses anything not finite.
  static Result<CommandSignal> Create(std::vector<double> times, Eigen::MatrixXd values, Hold hold);
  // u for all times.
  static CommandSignal Constant(const Eigen::VectorXd& u);

  // The same with the motion of prescribed joints (rows of it: joints of the signal), or without: null.
  CommandSignal WithMotion(std::shared_ptr<const GivenMotion> motion) const;
  const std::shared_ptr<const GivenMotion>& motion() const { return motion_; }

  int num_joints() const { return static_cast<int>(values_.rows()); }
  int size() const { return static_cast<int>(times_.size()); }
  Hold hold() const { return hold_; }
  const std::vector<double>& times() const { return times_; }
  const Eigen::MatrixXd& values() const { return values_; }

  double At(int joint, double t) const;
  // ∫ u ds from times()[0] to t.
  double Integral(int joint, double t) const;
  // Average over [begin, end], end > begin. Takes time logarithmic in size().
  double Average(int joint, double begin, double end) const;

 private:
  std::vector<double> times_;
  Eigen::MatrixXd values_;    // n × K
  Eigen::MatrixXd integral_;  // n × K, ∫ from times[0] to times[k]
  Hold hold_ = Hold::kZeroOrder;
  std::shared_ptr<const GivenMotion> motion_;
};

}  // namespace rg::sim
