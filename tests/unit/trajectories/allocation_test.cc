// Counts allocations while the controller runs: Eigen and the library take memory from malloc.
#include <gtest/gtest.h>

#include <atomic>

#include "services/trajectories/mpc_controller.h"
#include "tests/unit/trajectories/test_plants.h"

#if defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define RG_COUNTS_ALLOCATIONS 1
#endif

namespace {
std::atomic<long> allocations{0};
}

#ifdef RG_COUNTS_ALLOCATIONS
extern "C" void* __libc_malloc(size_t size);  // NOLINT: the name is glibc's
extern "C" void* malloc(size_t size) {
  allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
#endif

namespace rg::trajectories {
namespace {

TEST(MpcController, WarmSolvesDoNotAllocate) {
#ifndef RG_COUNTS_ALLOCATIONS
  GTEST_SKIP() << "malloc is the sanitizer's";
#endif
  for (const char* name : {"mico2", "slide"}) {  // compile-time and run-time sizes
    SCOPED_TRACE(name);
    const sim::Plant plant = MakePlant(name);
    const int n = plant.num_joints();
    auto controller = MpcController::Create(plant, plant.parameters().Nominal(), {});
    ASSERT_TRUE(controller.ok());
    Eigen::VectorXd q = n == 6 ? Candle() : Eigen::VectorXd::Constant(n, 0.1);
    const Eigen::VectorXd goal = q.array() + 0.1;
    Eigen::VectorXd v = Eigen::VectorXd::Zero(n), u = v;
    controller.value()->Solve(q, v, goal, &u);
    long in_solve = 0;
    for (int k = 0; k < 5; ++k) {
      q = controller.value()->plan().x(1).head(n);
      v = controller.value()->plan().x(1).segment(n, n);
      const long before = allocations.load();
      const MpcStatus status = controller.value()->Solve(q, v, goal, &u);
      in_solve += allocations.load() - before;
      EXPECT_TRUE(status.ok);
    }
    EXPECT_EQ(in_solve, 0);
  }
}

}  // namespace
}  // namespace rg::trajectories
