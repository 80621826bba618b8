// What Mechanism and Workspace hide from their users. Internal to this folder and its tests.
#pragma once

#include <cstddef>
#include <memory>
#include <new>

#include "common/dynamics/dynamics.h"
#include "common/dynamics/kernel_table.h"

namespace rg::dynamics {

struct Mechanism::Impl {
  Tree tree;
  bool plain = true;  // no joint follows another: joints and bodies of the tree are the model's, in order
  const KernelTable* kernels;
  Eigen::Vector3d gravity;
  BodyParameters parameters;  // columns are RobotModel's bodies
  InertiaRows inertias;

  int n() const { return tree.num_joints(); }
};

// A robot with followers in the order of its tree. With q̇ = G ẏ of the n joints, what the kernels say of all
// bodies is folded: Gᵀ tau, Gᵀ M G. `N`: bodies.
class Unfolded {
 public:
  explicit Unfolded(const Tree& tree) : tree_(tree) {}
  // N × 1 of n × 1. Positions have offsets, velocities and accelerations do not.
  Eigen::VectorXd Position(const VectorIn& q) const { return Of(q, true); }
  Eigen::VectorXd Rate(const VectorIn& v) const { return Of(v, false); }
  // n × c of N × c: rows of followers onto their drivers'.
  template <class Full, class Out>
  void FoldRows(const Full& full, Out&& out) const {
    for (int k = 0; k < tree_.n; ++k) {
      if (tree_.body[k] < tree_.num_joints()) out.row(tree_.body[k]) = full.row(k);
    }
    for (int i = 0; i < tree_.num_ties; ++i) {
      const Tie& tie = tree_.ties[i];
      out.row(tree_.body[tie.driver]) += tie.ratio * full.row(tie.follower);
    }
  }
  // n × n of N × N.
  template <class Full, class Out>
  void Fold(const Full& full, Out&& out) const {
    Eigen::MatrixXd rows(tree_.num_joints(), tree_.n);
    FoldRows(full, rows);
    FoldColumns(rows, out);
  }
  // r × n of r × N.
  template <class Full, class Out>
  void FoldColumns(const Full& full, Out&& out) const {
    FoldRows(full.transpose(), out.transpose());
  }

 private:
  Eigen::VectorXd Of(const VectorIn& x, bool offsets) const {
    Eigen::VectorXd out(tree_.n);
    for (int k = 0; k < tree_.n; ++k) {
      if (tree_.body[k] < tree_.num_joints()) out[k] = x[tree_.body[k]];
    }
    for (int i = 0; i < tree_.num_ties; ++i) {
      const Tie& tie = tree_.ties[i];
      out[tie.follower] = tie.ratio * out[tie.driver] + (offsets ? tie.offset : 0.0);
    }
    return out;
  }
  const Tree& tree_;
};

struct Workspace::Impl {
  // The memory is initialised for these; a mechanism with other kernels makes it anew.
  const KernelTable* kernels = nullptr;
  std::unique_ptr<std::byte[], void (*)(std::byte*)> memory{
      nullptr, [](std::byte* p) { ::operator delete[](p, std::align_val_t{64}); }};
};

// The workspace's memory, made at first use.
void* Scratch(const Mechanism::Impl& mechanism, Workspace::Impl& workspace);

}  // namespace rg::dynamics
