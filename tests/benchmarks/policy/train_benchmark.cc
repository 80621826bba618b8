// Training at the paper's size: 11,250 points in 450 trajectories, 18 → 128 → 128 → 6, 100 epochs,
// batch 32, on each instruction set there is. CPU time is the figure; prints the final loss too.
#include <benchmark/benchmark.h>

#include <cmath>

#include "common/base/rng.h"
#include "services/policy/train.h"

namespace rg::policy {
namespace {

// A stiff feedback law with gravity, the kind of function that optimal control gives.
Dataset PaperSizedDataset() {
  constexpr int kJoints = 6, kPoints = 25, kTrajectories = 450;
  Rng rng(1);
  Dataset dataset;
  for (int trajectory = 0; trajectory < kTrajectories; ++trajectory) {
    Eigen::MatrixXd q(kJoints, kPoints), v(kJoints, kPoints), u(kJoints, kPoints);
    Eigen::VectorXd start(kJoints), goal(kJoints);
    for (int j = 0; j < kJoints; ++j) {
      start[j] = rng.Uniform(-2.0, 2.0);
      goal[j] = start[j] + rng.Uniform(-0.4, 0.4);
    }
    for (int k = 0; k < kPoints; ++k) {
      const double s = k / 24.0, shape = s * s * (3.0 - 2.0 * s), rate = 6.0 * s * (1.0 - s);
      q.col(k) = start + shape * (goal - start);
      v.col(k) = rate * (goal - start);
      for (int j = 0; j < kJoints; ++j) {
        u(j, k) = 8.0 * (goal[j] - q(j, k)) - 2.0 * v(j, k) +
                  5.0 * std::sin(q(j, k) + 0.5 * q((j + 1) % kJoints, k)) + 0.3 * std::tanh(10.0 * v(j, k));
      }
    }
    dataset.AddTrajectory(static_cast<uint64_t>(trajectory), q, v, goal, u);
  }
  return dataset;
}

void TrainPaperSize(benchmark::State& state, const Kernels* kernels) {
  if (!kernels) {
    state.SkipWithError("not on this processor");
    return;
  }
  const Dataset dataset = PaperSizedDataset();
  TrainOptions options;
  options.batch = static_cast<int>(state.range(0));
  options.validation_fraction = 0.0;
  options.kernels = kernels;
  for (auto _ : state) {
    const auto result = Train(dataset, options);
    state.counters["loss"] = result->train_loss;
  }
}

BENCHMARK_CAPTURE(TrainPaperSize, avx512, KernelsAvx512())
    ->Arg(32)
    ->Arg(256)
    ->Unit(benchmark::kSecond)
    ->Iterations(1);
BENCHMARK_CAPTURE(TrainPaperSize, avx2, KernelsAvx2())
    ->Arg(32)
    ->Arg(256)
    ->Unit(benchmark::kSecond)
    ->Iterations(1);
BENCHMARK_CAPTURE(TrainPaperSize, baseline, KernelsBaseline())
    ->Arg(32)
    ->Unit(benchmark::kSecond)
    ->Iterations(1);

void EvaluatePolicy(benchmark::State& state) {
  TrainOptions options;
  options.epochs = 1;
  const auto result = Train(PaperSizedDataset(), options);
  std::vector<double> in(18, 0.1), out(6);
  for (auto _ : state) {
    benchmark::DoNotOptimize(result->policy.Evaluate(in, out));
    benchmark::DoNotOptimize(out.data());
  }
}
BENCHMARK(EvaluatePolicy)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace rg::policy

BENCHMARK_MAIN();
