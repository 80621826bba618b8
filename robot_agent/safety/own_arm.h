// The arm as the agent's own configuration has it: the URDF named there, with its nominal masses. No job's
// model reaches it, so a bad artefact moves neither the fence nor the gravity that a stop carries.
#pragma once

#include <Eigen/Core>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "robot_agent/safety/arm.h"

namespace rg::robot_agent {

class OwnArm final : public ArmModel {
 public:
  // gravity: m/s², in the base frame.
  OwnArm(const model::RobotModel& model, const Eigen::Vector3d& gravity);
  void GravityTorque(const double* q, double* tau) override;
  void Tip(const double* q, double* position) override;

 private:
  const int n_;
  const model::Frame tip_;
  dynamics::Mechanism mechanism_;
  dynamics::Workspace workspace_;
};

}  // namespace rg::robot_agent
