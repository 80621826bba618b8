// The believed rigid body at a plant's parameter values, for what the control cycle needs of it.
#pragma once

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "common/sim/plant.h"
#include "robot_agent/safety/arm.h"

namespace rg::robot_agent {

// Masses, centres of mass, inertias and gravity of `values` (plant.parameters().size()); effects of
// the plant (payload, tilt, springs) are not part of it.
dynamics::Mechanism MechanismAt(const sim::Plant& plant, const Eigen::VectorXd& values);

class PlantArmModel final : public ArmModel {
 public:
  PlantArmModel(const sim::Plant& plant, const Eigen::VectorXd& values);
  void GravityTorque(const double* q, double* tau) override;
  void Tip(const double* q, double* position) override;

 private:
  const int n_;
  const model::Frame tip_;
  dynamics::Mechanism mechanism_;
  dynamics::Workspace workspace_;
};

}  // namespace rg::robot_agent
