// Thousands of seeded histories of the whole service in memory (simulation.h).
#include "tests/unit/coordinator/simulation.h"

#include <gtest/gtest.h>

#include <cstdlib>

namespace rg::coordinator {
namespace {

// RG_SIMULATIONS overrides how many histories are played.
uint64_t Histories(uint64_t normally) {
  const char* asked = std::getenv("RG_SIMULATIONS");
  return asked != nullptr ? std::strtoull(asked, nullptr, 10) : normally;
}

void Play(uint64_t first_seed, uint64_t count, const SimulationOptions& options, Simulation::Facts* sum) {
  for (uint64_t seed = first_seed; seed < first_seed + count; ++seed) {
    Simulation simulation(seed, options);
    const auto broken = simulation.Run();
    ASSERT_TRUE(broken.empty()) << "seed " << seed << ": " << broken.front();
    const auto& f = simulation.facts();
    sum->events += f.events, sum->restarts += f.restarts, sum->deaths += f.deaths, sum->refused += f.refused;
    sum->commits += f.commits, sum->succeeded += f.succeeded, sum->failed += f.failed;
    sum->stalls += f.stalls, sum->clock_jumps += f.clock_jumps;
    sum->after_others += f.after_others, sum->overdue += f.overdue, sum->reprioritised += f.reprioritised;
    sum->of_tasks += f.of_tasks, sum->lost_batches += f.lost_batches;
    sum->cancelled += f.cancelled, sum->freezes += f.freezes, sum->uncertain += f.uncertain;
  }
}

TEST(Simulation, NoHistoryOfKillsAndLossesBreaksAPromise) {
  Simulation::Facts sum;
  Play(1, Histories(2500), SimulationOptions{}, &sum);
  // The histories must have met what they are for.
  EXPECT_GT(sum.restarts, 100u);
  EXPECT_GT(sum.lost_batches, 100u);
  EXPECT_GT(sum.stalls, 100u);
  EXPECT_GT(sum.clock_jumps, 100u);
  EXPECT_GT(sum.deaths, 100u);
  EXPECT_GT(sum.refused, 10u);
  EXPECT_GT(sum.succeeded, 100u);
  EXPECT_GT(sum.failed, 100u);
  EXPECT_GT(sum.cancelled, 100u);
  EXPECT_GT(sum.uncertain, 0u);
  EXPECT_GT(sum.of_tasks, 100u);
  EXPECT_GT(sum.after_others, 100u);
  EXPECT_GT(sum.overdue, 20u);
  EXPECT_GT(sum.reprioritised, 100u);
  std::printf("%llu events, %llu restarts, %llu deaths, %llu freezes, %llu refused, %llu commits\n",
              static_cast<unsigned long long>(sum.events), static_cast<unsigned long long>(sum.restarts),
              static_cast<unsigned long long>(sum.deaths), static_cast<unsigned long long>(sum.freezes),
              static_cast<unsigned long long>(sum.refused), static_cast<unsigned long long>(sum.commits));
}

TEST(Simulation, AVeryBadNetworkOnlyDelays) {
  SimulationOptions options;
  options.drop = 0.3;
  options.repeat = 0.3;
  options.delay_max_ms = 1500;
  options.chaos_ms = 15'000;
  Simulation::Facts sum;
  Play(100'000, Histories(400), options, &sum);
}

TEST(Simulation, TheSameSeedGivesTheSameHistory) {
  Simulation a(7, {}), b(7, {});
  a.Run(), b.Run();
  EXPECT_EQ(a.facts().events, b.facts().events);
  EXPECT_EQ(a.facts().commits, b.facts().commits);
  EXPECT_EQ(a.facts().refused, b.facts().refused);
}

}  // namespace
}  // namespace rg::coordinator
