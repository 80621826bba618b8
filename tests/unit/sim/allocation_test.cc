// The simulator allocates nothing once its outputs have their size: malloc is counted.
#include <gtest/gtest.h>

#include <cstdlib>

#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define RG_COUNTS_MALLOC 0
#else
#define RG_COUNTS_MALLOC 1
#endif

#if RG_COUNTS_MALLOC
namespace {
long allocations = 0;
}
extern "C" void* __libc_malloc(size_t size);
extern "C" void* malloc(size_t size) {
  ++allocations;
  return __libc_malloc(size);
}
#endif

namespace rg::sim {
namespace {

using effects::MakeSpec;

TEST(Allocation, NoneInSimulateAndAdvanceAfterTheFirstCall) {
#if !RG_COUNTS_MALLOC
  GTEST_SKIP() << "the sanitizer owns malloc";
#else
  const std::vector<std::string> joints = {"shoulder", "elbow"};
  const Plant plant = rg::testing::MakePlant(
      "arm2", {MakeSpec("coulomb_friction", joints, {{"coulomb", 0.3}}),
               MakeSpec("joint_elasticity", {"elbow"}, {{"stiffness", 500}}),
               MakeSpec("actuator_delay", joints, {{"delay", 0.01}}),
               MakeSpec("sensor_delay", joints, {{"delay", 0.005}}), MakeSpec("base_flexibility", {}, {}),
               MakeSpec("contact", {}, {{"height", 0.1}})});
  Simulator simulator(plant);
  const Eigen::VectorXd q = Eigen::VectorXd::Constant(2, 0.4), v = Eigen::VectorXd::Zero(2), u = q;
  const State x0 = simulator.MakeState(q, v);
  const CommandSignal command = CommandSignal::Constant(u);
  const std::vector<double> times = {0.0, 0.01, 0.02, 0.05};
  SensitivityRequest request{true, PaperParameters(plant)};
  Trajectory out;
  simulator.SimulateInto(x0, command, times, request, &out);
  ASSERT_TRUE(out.outcome.ok());
  long before = allocations;
  simulator.SimulateInto(x0, command, times, request, &out);
  EXPECT_EQ(allocations, before) << "in SimulateInto";

  State x = x0;
  Linearization lin;
  for (int k = 0; k < 30; ++k) ASSERT_TRUE(simulator.Advance(x, u, 0.01, &lin).ok());  // histories fill up
  before = allocations;
  for (int k = 0; k < 10; ++k) ASSERT_TRUE(simulator.Advance(x, u, 0.01, &lin).ok());
  EXPECT_EQ(allocations, before) << "in Advance";
#endif
}

}  // namespace
}  // namespace rg::sim
