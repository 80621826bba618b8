// The arm as the agent's own configuration has it: the URDF named there, with its nominal masses. No job's
// model reaches it, so a bad artefact moves neither the fence nor the gravity that a stop carries.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "robot_agent/safety/arm.h"
#include "robot_agent/safety/capsules.h"

namespace rg::robot_agent {

class OwnArm final : public ArmModel {
 public:
  // gravity: m/s², in the base frame.
  // The links of `parts` are frames of the model (RG_CHECK).
  OwnArm(const model::RobotModel& model, const Eigen::Vector3d& gravity, const CapsuleSet& parts = {});
  void GravityTorque(const double* q, double* tau) override;
  void Tip(const double* q, double* position) override;
  double Clearance(const double* q, int* pair) override;

 private:
  const int n_;
  const model::Frame tip_;
  const CapsuleSet parts_;
  std::vector<model::Frame> frames_;                // of parts_.capsules
  std::vector<Eigen::Vector3d> from_now_, to_now_;  // their ends in the base frame
  dynamics::Mechanism mechanism_;
  dynamics::Workspace workspace_;
};

}  // namespace rg::robot_agent
