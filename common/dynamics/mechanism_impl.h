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
  const KernelTable* kernels;
  Eigen::Vector3d gravity;
  BodyParameters parameters;
  InertiaRows inertias;
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
