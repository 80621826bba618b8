// What a vector of parameter values means to the step kernels: gravity, body inertias, constants of the
// joint laws; and how these move with each parameter. Private to this folder.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "common/dynamics/dynamics.h"
#include "common/sim/plant_data.h"

namespace rg::sim::internal {

class ParameterValues {
 public:
  explicit ParameterValues(const PlantData& plant);
  void Set(const Eigen::VectorXd& values);

  const Eigen::VectorXd& values() const { return values_; }
  const dynamics::BodyParameters& phi() const { return phi_; }  // 10 × bodies of the tree's model
  const Eigen::Vector3d& gravity() const { return gravity_; }
  const std::vector<double>& joint_parameters() const { return joint_; }
  const std::vector<double>& point_parameters() const { return point_; }

  // d gravity / d parameter.
  Eigen::Vector3d GravityDirection(int parameter) const;
  // Body of the tree's model whose φ moves with the parameter, −1 if none does; d φ / d parameter.
  int InertiaDirection(int parameter, Eigen::Matrix<double, 10, 1>* direction) const;

 private:
  void SetInertias();
  void SetRodInertia();
  void SetGravity();

  const PlantData& plant_;
  Eigen::VectorXd values_;
  Eigen::Matrix<double, model::kLinkParameters, Eigen::Dynamic> links_;  // of the tree's model
  dynamics::BodyParameters phi_;
  Eigen::Vector3d gravity_;
  Eigen::Matrix3d gravity_by_axes_;
  Eigen::Matrix<double, 3, 2> gravity_by_turn_;
  int payload_body_ = -1;
  model::Pose payload_frame_;  // of the last joint's child link in its body
  Eigen::Matrix<double, 10, 4> phi_by_payload_;
  Eigen::Matrix<double, 10, 3> phi_by_rod_;
  std::vector<double> joint_;
  std::vector<double> point_;
};

}  // namespace rg::sim::internal
