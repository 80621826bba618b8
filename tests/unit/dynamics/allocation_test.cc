// The algorithms allocate nothing once mechanism and workspace exist and were used.
#include <gtest/gtest.h>

#include <cstdlib>
#include <new>

#include "common/dynamics/dynamics.h"
#include "tests/unit/dynamics/robots.h"

namespace {
long allocations = 0;

void* Count(std::size_t size, std::size_t alignment) {
  ++allocations;
  void* memory = std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
  if (memory == nullptr) std::abort();
  return memory;
}
}  // namespace

void* operator new(std::size_t size) { return Count(size, 16); }
void* operator new[](std::size_t size) { return Count(size, 16); }
void* operator new(std::size_t size, std::align_val_t at) {
  return Count(size, static_cast<std::size_t>(at));
}
void* operator new[](std::size_t size, std::align_val_t at) {
  return Count(size, static_cast<std::size_t>(at));
}
// Inlined where operator new is not, they look mismatched to the compiler.
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete[](void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete[](void* memory, std::size_t) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete[](void* memory, std::align_val_t) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t, std::align_val_t) noexcept {
  std::free(memory);
}
[[gnu::noinline]] void operator delete[](void* memory, std::size_t, std::align_val_t) noexcept {
  std::free(memory);
}

namespace rg::dynamics {
namespace {

TEST(Dynamics, AllocatesNothingAfterTheFirstCall) {
  for (const model::RobotModel& model : {MicoArm(), RandomTree(Rng(1), 16)}) {
    const int n = model.num_joints();
    Mechanism m(model);
    Workspace w;
    Rng rng(2);
    const RandomState s = DrawState(rng, n);
    const model::Frame frame = *model.FindFrame(model.end_effector().name);
    const BodyParameters parameters = m.body_parameters();
    Eigen::VectorXd x(n), y(n);
    Eigen::MatrixXd A(n, n), B(n, n), C(n, n), J(6, n), Y(n, 10 * n), G(n, 3);
    const auto all = [&] {
      m.SetBodyParameters(parameters);
      Rnea(m, w, s.q, s.v, s.a, x);
      GravityTorque(m, w, s.q, x);
      Crba(m, w, s.q, A);
      MassMatrixAndBias(m, w, s.q, s.v, A, x);
      Aba(m, w, s.q, s.v, s.a, y);
      RneaDerivatives(m, w, s.q, s.v, s.a, A, B);
      RneaGravityDerivative(m, w, s.q, G);
      AbaDerivatives(m, w, s.q, s.v, s.a, y, A, B, C);
      TorqueRegressor(m, w, s.q, s.v, s.a, Y);
      FrameKinematics(m, w, s.q, frame, J);
      return KineticEnergy(m, w, s.q, s.v) + PotentialEnergy(m, w, s.q);
    };
    all();
    const long before = allocations;
    const double energy = all();
    EXPECT_EQ(allocations, before);
    EXPECT_TRUE(std::isfinite(energy));
  }
  EXPECT_GT(allocations, 0);  // the counter counts
}

}  // namespace
}  // namespace rg::dynamics
