#include "services/trajectories/motion_limits.h"

#include "common/base/check.h"

namespace rg::trajectories {

MotionLimits MotionLimits::FromModel(const model::RobotModel& model, const Eigen::VectorXd& peak_torque) {
  MotionLimits limits{model.EffortLimits(), model.VelocityLimits(), model.LowerLimits(), model.UpperLimits()};
  if (peak_torque.size() > 0) {
    RG_CHECK(peak_torque.size() == limits.torque.size()) << peak_torque.size() << " peak torques";
    limits.torque = limits.torque.cwiseMin(peak_torque);
  }
  return limits;
}

MotionLimits MotionLimits::Tightened(double position, double velocity) const {
  MotionLimits limits = *this;
  limits.position_lower.array() += position;
  limits.position_upper.array() -= position;
  limits.velocity *= 1.0 - velocity;
  return limits;
}

Eigen::VectorXd KnownPeakTorques(const model::RobotModel& model) {
  if (model.name() != "mico2" || model.num_joints() != 6) return {};
  // Three large actuators (KA-75+), three small ones (KA-58) of the maker's sheet AS-ACT-KA58-KA75.
  return (Eigen::VectorXd(6) << 30.5, 30.5, 30.5, 6.8, 6.8, 6.8).finished();
}

}  // namespace rg::trajectories
