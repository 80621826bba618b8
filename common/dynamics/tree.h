// The topology and placements of a RobotModel as flat arrays, for kernels. Plain data, the same on
// every instruction set; includes nothing that kernels must not see.
#pragma once

#include <cstdint>

namespace rg::model {
class RobotModel;
}

namespace rg::dynamics {

inline constexpr int kMaxBodies = 16;  // model::kMaxBodies

// A body's joint that follows another one: q = ratio · q of the driver + offset. Both are places in the tree.
struct Tie {
  int follower = -1;
  int driver = -1;
  double ratio = 1.0;
  double offset = 0.0;
};

// The n bodies, parents before children. RobotModel numbers its joints before its followers; without
// followers both numberings are the same.
struct Tree {
  int n = 0;
  bool chain = false;  // parent[k] == k - 1 for all k
  int parent[kMaxBodies] = {};
  // Pose of body k's frame in its parent's at q = 0: rotation by columns, translation.
  double rotation[kMaxBodies][9] = {};
  double translation[kMaxBodies][3] = {};
  // 1 or 0; a joint is one of the two. Zero past the last joint.
  alignas(64) double revolute[kMaxBodies] = {};
  alignas(64) double prismatic[kMaxBodies] = {};
  // Bit j of path[k]: j is k or an ancestor of k. Bit j of below[k]: j is a descendant of k.
  uint32_t path[kMaxBodies] = {};
  uint32_t below[kMaxBodies] = {};
  // The same as 0 or 1 per joint.
  alignas(64) double path_mask[kMaxBodies][kMaxBodies] = {};
  alignas(64) double below_mask[kMaxBodies][kMaxBodies] = {};
  int num_ties = 0;
  Tie ties[kMaxBodies];
  int body[kMaxBodies] = {};   // place in the tree -> RobotModel's number
  int place[kMaxBodies] = {};  // and back

  int num_joints() const { return n - num_ties; }  // that move by themselves
};

Tree MakeTree(const model::RobotModel& model);

}  // namespace rg::dynamics
