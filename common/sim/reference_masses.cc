// The constants of a plant that tell its laws what inertia they see (effects/joint_law.h).
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <vector>

#include "common/base/rng.h"
#include "common/dynamics/dynamics.h"
#include "common/sim/plant_builder.h"

namespace rg::sim::internal {

// What such a joint's rotor is taken for: its nominal value, or a small part of what others carry.
double PlantBuilder::RotorOf(int joint, const Eigen::MatrixXd& M) const {
  constexpr double kSmall = 0.01;
  const double nominal = data_->table[data_->table.Find("armature." + data_->joint_names[joint])].nominal;
  return nominal > 0 ? nominal : std::max(1e-9, kSmall * M.diagonal().maxCoeff());
}

// Rᵀ M⁻¹ R of coupled drive k (coupled_drives.h); inverse: M⁻¹ of the tree's model.
double PlantBuilder::DriveMobility(int k, const ParameterValues& values,
                                   const Eigen::MatrixXd& inverse) const {
  const integrators::StepProgram& program = data_->program;
  const integrators::CoupledDrive& drive = program.drives[k];
  const int joint = program.tree.body[drive.joint], other = program.tree.body[drive.other];
  const int law = program.joints[program.tree.n + k].first_parameter;
  const double ratio = values.joint_parameters()[static_cast<size_t>(law + drive.ratio)];
  return inverse(joint, joint) + ratio * (2 * inverse(joint, other) + ratio * inverse(other, other));
}

// The median over a fixed set of poses of the inertia each law's force sees, at nominal parameters.
void PlantBuilder::SetReferenceMasses() {
  PlantData& d = *data_;
  const int n = d.tree_model->num_joints();
  d.reference_mass.assign(d.program.num_laws(), 1.0);
  ParameterValues values(d);
  values.Set(d.table.Nominal());
  dynamics::Mechanism mechanism(*d.tree_model);
  mechanism.SetBodyParameters(values.phi());
  dynamics::Workspace workspace;
  constexpr int kPoses = 33;
  std::vector<std::vector<double>> seen(n + d.program.num_drives);
  Rng rng(0x5eedULL);
  Eigen::VectorXd q(n);
  Eigen::MatrixXd M(n, n);
  for (int pose = 0; pose < kPoses; ++pose) {
    for (int j = 0; j < n; ++j) {
      const model::Joint& joint = d.tree_model->joint(j);
      const bool extra = std::count(d.extra_joints.begin(), d.extra_joints.end(), d.PlaceOf(j)) > 0;
      const double low = std::isfinite(joint.lower) ? joint.lower : -3.14;
      const double high = std::isfinite(joint.upper) ? joint.upper : 3.14;
      q[j] = extra ? 0.0 : rng.Uniform(low, high);
    }
    dynamics::Crba(mechanism, workspace, q, M);
    for (const int j : d.model->joints_without_inertia())
      M(d.first_joint + j, d.first_joint + j) += RotorOf(j, M);
    const Eigen::MatrixXd inverse = M.inverse();
    for (int j = 0; j < n; ++j) {
      const double mass = 1.0 / inverse(j, j);
      if (std::isfinite(mass) && mass > 0) seen[j].push_back(mass);
    }
    for (int k = 0; k < d.program.num_drives; ++k) {
      const double mass = 1.0 / DriveMobility(k, values, inverse);
      if (std::isfinite(mass) && mass > 0) seen[n + k].push_back(mass);
    }
  }
  for (size_t j = 0; j < seen.size(); ++j) {
    if (seen[j].empty()) continue;
    std::nth_element(seen[j].begin(), seen[j].begin() + seen[j].size() / 2, seen[j].end());
    const int own = static_cast<int>(j);
    d.reference_mass[own < n ? d.PlaceOf(own) : d.program.tree.n + own - n] = seen[j][seen[j].size() / 2];
  }
  for (int i = 0; i < d.program.tree.num_ties; ++i) {
    const dynamics::Tie& tie = d.program.tree.ties[i];
    d.reference_mass[tie.follower] = d.reference_mass[tie.driver] / (tie.ratio * tie.ratio);
  }
}

}  // namespace rg::sim::internal
