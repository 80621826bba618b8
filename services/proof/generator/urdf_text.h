// Edits of a URDF's text: the inertial of a link, the damping and friction of a joint.
#pragma once

#include <Eigen/Core>
#include <string>

namespace rg::proof {

struct Inertial {
  double mass = 0;
  Eigen::Vector3d com = Eigen::Vector3d::Zero();          // link frame, m
  Eigen::Matrix3d inertia = Eigen::Matrix3d::Identity();  // about the centre of mass, link axes, kg·m²
};

std::string InertialText(const Inertial& inertial);

// The text with another inertial (damping, friction) of that link (joint); unchanged if it has none of that
// name.
std::string WithInertial(const std::string& urdf, const std::string& link, const Inertial& inertial);
std::string WithLosses(const std::string& urdf, const std::string& joint, double damping, double friction);

}  // namespace rg::proof
