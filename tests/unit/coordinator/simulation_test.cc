// Thousands of seeded histories of the whole service in memory (simulation.h).
//
// RG_SIMULATIONS overrides how many (the suite `full`: 100,000). With RG_PROGRESS=FILE batches that are done are
// noted there with what they met, and a run that was broken off goes on with the next.
#include "tests/unit/coordinator/simulation.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <sstream>

#include "tests/support/base/batches_done.h"

namespace rg::coordinator {
namespace {

using Facts = Simulation::Facts;

uint64_t Histories(uint64_t normally) {
  const char* asked = std::getenv("RG_SIMULATIONS");
  return asked != nullptr ? std::strtoull(asked, nullptr, 10) : normally;
}

std::string ToLine(const Facts& facts) {
  std::string line;
  for (const auto fact : Facts::kAll) line += std::to_string(facts.*fact) + " ";
  return line;
}

void AddLine(const std::string& line, Facts* sum) {
  std::istringstream in(line);
  uint64_t value = 0;
  for (const auto fact : Facts::kAll) {
    if (in >> value) sum->*fact += value;
  }
}

void PlayBatch(uint64_t first_seed, uint64_t count, const SimulationOptions& options, Facts* sum) {
  for (uint64_t seed = first_seed; seed < first_seed + count; ++seed) {
    Simulation simulation(seed, options);
    const auto broken = simulation.Run();
    ASSERT_TRUE(broken.empty()) << "seed " << seed << ": " << broken.front();
    for (const auto fact : Facts::kAll) sum->*fact += simulation.facts().*fact;
  }
}

void Play(const std::string& name, uint64_t first_seed, uint64_t count, const SimulationOptions& options,
          Facts* sum) {
  constexpr uint64_t kPerBatch = 500;
  testing::BatchesDone done(name);
  for (uint64_t at = 0; at < count; at += kPerBatch) {
    const int batch = static_cast<int>(at / kPerBatch);
    auto met = done.Find(batch);
    if (!met) {
      Facts facts;
      PlayBatch(first_seed + at, std::min(kPerBatch, count - at), options, &facts);
      if (::testing::Test::HasFatalFailure()) return;
      met = ToLine(facts);
      done.Note(batch, *met);
    }
    AddLine(*met, sum);
  }
  done.Forget();
}

TEST(Simulation, NoHistoryOfKillsAndLossesBreaksAPromise) {
  Facts sum;
  ASSERT_NO_FATAL_FAILURE(Play("histories", 1, Histories(2500), SimulationOptions{}, &sum));
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
  EXPECT_GT(sum.counted_overdue, 20u);
  EXPECT_GT(sum.reprioritised, 100u);
  EXPECT_GT(sum.unable, 100u);
  std::printf("%llu events, %llu restarts, %llu deaths, %llu freezes, %llu refused, %llu commits, %llu after a limit\n",
              static_cast<unsigned long long>(sum.events), static_cast<unsigned long long>(sum.restarts),
              static_cast<unsigned long long>(sum.deaths), static_cast<unsigned long long>(sum.freezes),
              static_cast<unsigned long long>(sum.refused), static_cast<unsigned long long>(sum.commits),
              static_cast<unsigned long long>(sum.counted_overdue));
}

TEST(Simulation, AVeryBadNetworkOnlyDelays) {
  SimulationOptions options;
  options.drop = 0.3;
  options.repeat = 0.3;
  options.delay_max_ms = 1500;
  options.chaos_ms = 15'000;
  Facts sum;
  Play("bad_network", 1'000'000, Histories(400), options, &sum);
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
