#include "robot_agent/arm_model.h"

#include <algorithm>

namespace rg::robot_agent {
namespace {

bool IsInertial(sim::ParameterKind kind) {
  return kind == sim::ParameterKind::kMass || kind == sim::ParameterKind::kCenterOfMass ||
         kind == sim::ParameterKind::kInertia;
}

}  // namespace

dynamics::Mechanism MechanismAt(const sim::Plant& plant, const Eigen::VectorXd& values) {
  const auto& model = plant.model();
  const auto& table = plant.parameters();
  const auto& names = model::kLinkParameterNames;
  dynamics::LinkParametersMatrix links = model.NominalLinkParameters();
  Eigen::Vector3d gravity = plant.options().gravity;
  for (int i = 0; i < table.size(); ++i) {
    if (table[i].kind == sim::ParameterKind::kGravity) gravity[table[i].field[0] - 'x'] = values[i];
    if (!IsInertial(table[i].kind)) continue;
    const auto field = std::find(names.begin(), names.end(), table[i].field) - names.begin();
    links(field, model.FindLink(table[i].owner)) = values[i];
  }
  dynamics::Mechanism mechanism(model);
  mechanism.SetGravity(gravity);
  mechanism.SetLinkParameters(model, links);
  return mechanism;
}

PlantArmModel::PlantArmModel(const sim::Plant& plant, const Eigen::VectorXd& values)
    : n_(plant.num_joints()),
      tip_(*plant.model().FindFrame(plant.model().end_effector().name)),
      mechanism_(MechanismAt(plant, values)) {}

void PlantArmModel::GravityTorque(const double* q, double* tau) {
  Eigen::Map<Eigen::VectorXd> out(tau, n_);
  dynamics::GravityTorque(mechanism_, workspace_, Eigen::Map<const Eigen::VectorXd>(q, n_), out);
}

void PlantArmModel::Tip(const double* q, double* position) {
  const model::Pose pose =
      dynamics::FramePose(mechanism_, workspace_, Eigen::Map<const Eigen::VectorXd>(q, n_), tip_);
  Eigen::Map<Eigen::Vector3d>{position} = pose.translation;
}

}  // namespace rg::robot_agent
