// The Gram matrix of a screen's columns, of one window's rows: where a screen spends its time. Operations are
// those of the lower triangle.
#include <benchmark/benchmark.h>

#include "services/diagnosis/likelihood/row_products.h"

namespace rg::diagnosis {
namespace {

constexpr long kRows = 1500;

void Gram(benchmark::State& state) {
  const long columns = state.range(0);
  const RowMatrixXd A = RowMatrixXd::Random(kRows, columns);
  RowMatrixXd G = RowMatrixXd::Zero(columns, columns);
  for (auto _ : state) {
    AddGram(A, 1.0, G);
    benchmark::DoNotOptimize(G.data());
  }
  const double operations = static_cast<double>(kRows) * static_cast<double>(columns * (columns + 1));
  state.counters["operations"] =
      benchmark::Counter(operations, benchmark::Counter::kIsIterationInvariantRate);
}
BENCHMARK(Gram)->Arg(400)->Arg(1000)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace rg::diagnosis

BENCHMARK_MAIN();
