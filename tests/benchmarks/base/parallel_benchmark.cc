// What one loop costs beside its items: on `threads`, of so many items of about so many microseconds each.
// Wall time; run with --benchmark_format=json for figures.
#include <benchmark/benchmark.h>

#include <cstdint>

#include "common/base/parallel.h"

namespace rg {
namespace {

// About a microsecond for each.
void Work(int64_t microseconds) {
  uint64_t x = 1;
  for (int64_t i = 0; i < 700 * microseconds; ++i) benchmark::DoNotOptimize(x = x * 6364136223846793005u + 1);
}

void SmallLoop(benchmark::State& state) {
  const auto threads = static_cast<int>(state.range(0)), items = static_cast<int>(state.range(1));
  for (auto _ : state) ParallelFor(threads, items, [&](int, int) { Work(state.range(2)); });
}
BENCHMARK(SmallLoop)
    ->UseRealTime()
    ->Unit(benchmark::kMicrosecond)
    ->ArgNames({"threads", "items", "us"})
    ->Args({1, 2, 0})
    ->Args({2, 2, 0})
    ->Args({1, 8, 10})
    ->Args({2, 8, 10})
    ->Args({1, 8, 100})
    ->Args({2, 8, 100})
    ->Args({1, 8, 1000})
    ->Args({2, 8, 1000});

}  // namespace
}  // namespace rg

BENCHMARK_MAIN();
