#include "common/dynamics/tree.h"

#include "common/model/robot_model.h"

namespace rg::dynamics {

static_assert(kMaxBodies == model::kMaxBodies);

Tree MakeTree(const model::RobotModel& model) {
  Tree tree;
  tree.n = model.num_joints();
  tree.chain = true;
  for (int k = 0; k < tree.n; ++k) {
    const model::Joint& joint = model.joint(k);
    tree.parent[k] = joint.parent;
    tree.chain = tree.chain && joint.parent == k - 1;
    Eigen::Map<Eigen::Matrix3d>(tree.rotation[k]) = joint.X_PB.rotation;
    Eigen::Map<Eigen::Vector3d>(tree.translation[k]) = joint.X_PB.translation;
    (joint.is_revolute() ? tree.revolute : tree.prismatic)[k] = 1.0;
    tree.path[k] = (joint.parent < 0 ? 0u : tree.path[joint.parent]) | (1u << k);
  }
  for (int k = 0; k < tree.n; ++k) {
    for (int j = 0; j < tree.n; ++j) {
      if (j != k && (tree.path[j] >> k & 1u)) tree.below[k] |= 1u << j;
      tree.path_mask[k][j] = tree.path[k] >> j & 1u;
      tree.below_mask[k][j] = tree.below[k] >> j & 1u;
    }
  }
  return tree;
}

}  // namespace rg::dynamics
