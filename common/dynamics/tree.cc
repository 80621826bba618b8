#include "common/dynamics/tree.h"

#include "common/base/check.h"
#include "common/model/robot_model.h"

namespace rg::dynamics {

static_assert(kMaxBodies == model::kMaxBodies);

namespace {

// Every body as soon as its parent is there, in RobotModel's order.
void OrderBodies(const model::RobotModel& model, Tree* tree) {
  bool placed[kMaxBodies] = {};
  for (int next = 0; next < tree->n;) {
    const int before = next;
    for (int body = 0; body < tree->n; ++body) {
      const int parent = model.body_joint(body).parent;
      if (placed[body] || (parent >= 0 && !placed[parent])) continue;
      placed[body] = true;
      tree->body[next] = body;
      tree->place[body] = next++;
      break;
    }
    RG_CHECK(next > before) << model.name() << ": bodies hang on each other in a circle";
  }
}

}  // namespace

Tree MakeTree(const model::RobotModel& model) {
  Tree tree;
  tree.n = model.num_bodies();
  tree.chain = true;
  OrderBodies(model, &tree);
  for (int k = 0; k < tree.n; ++k) {
    const model::Joint& joint = model.body_joint(tree.body[k]);
    tree.parent[k] = joint.parent < 0 ? -1 : tree.place[joint.parent];
    tree.chain = tree.chain && tree.parent[k] == k - 1;
    Eigen::Map<Eigen::Matrix3d>(tree.rotation[k]) = joint.X_PB.rotation;
    Eigen::Map<Eigen::Vector3d>(tree.translation[k]) = joint.X_PB.translation;
    (joint.is_revolute() ? tree.revolute : tree.prismatic)[k] = 1.0;
    tree.path[k] = (tree.parent[k] < 0 ? 0u : tree.path[tree.parent[k]]) | (1u << k);
  }
  for (int k = 0; k < tree.n; ++k) {
    for (int j = 0; j < tree.n; ++j) {
      if (j != k && (tree.path[j] >> k & 1u)) tree.below[k] |= 1u << j;
      tree.path_mask[k][j] = tree.path[k] >> j & 1u;
      tree.below_mask[k][j] = tree.below[k] >> j & 1u;
    }
  }
  for (size_t i = 0; i < model.followers().size(); ++i) {
    const model::Follower& f = model.followers()[i];
    tree.ties[tree.num_ties++] = {tree.place[static_cast<size_t>(model.num_joints()) + i],
                                  tree.place[f.driver], f.multiplier, f.offset};
  }
  return tree;
}

}  // namespace rg::dynamics
