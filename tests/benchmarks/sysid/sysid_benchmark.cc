// Cost of identification: Jacobians of the paper's window and of whole recordings, one linearisation of
// multiple shooting, one prediction. Run with --benchmark_format=json for figures; RG_SOURCE_DIR is the
// source tree.
#include <benchmark/benchmark.h>

#include "services/sysid/paper_problem.h"
#include "services/sysid/prediction.h"
#include "services/sysid/recording_shooting.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

// Eight seconds at 25 Hz near the hanging pose, where the arm is stable.
struct Bench {
  sim::Plant plant = testing::LoadPlant("mico2");
  VectorXd values = WithDamping(plant);
  recordings::Recording recording = testing::MakeRecording(
      plant, values, 1,
      {.duration_s = 8.0, .rate_hz = 25.0, .amplitude = 0.3, .center = testing::CandlePose()});

  static VectorXd WithDamping(const sim::Plant& plant) {
    VectorXd values = plant.parameters().Nominal();
    for (const int i : plant.parameters().OfKind(sim::ParameterKind::kDamping)) values[i] = 3.0;
    return values;
  }
};

// Residuals and Jacobian of a window of range(0) ms, 71 parameters, 1 ms steps, single shooting.
void PaperJacobian(benchmark::State& state) {
  const Bench bench;
  PaperOptions options;
  options.windows = {{.length_s = 1e-3 * static_cast<double>(state.range(0))}};
  options.interpolate = false;
  auto paper = *PaperProblem::Create(bench.plant, bench.values, bench.recording, options);
  ResidualFunction& residuals = *paper.problem().residuals;
  VectorXd r(residuals.num_residuals());
  RowMatrix J(residuals.num_residuals(), residuals.num_parameters());
  for (auto _ : state) {
    if (!residuals.Evaluate(paper.problem().initial, {}, &r, &J)) state.SkipWithError("not finite");
  }
  state.counters["time_per_step"] =
      benchmark::Counter(static_cast<double>(state.range(0)),
                         benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}
BENCHMARK(PaperJacobian)->Arg(200)->Arg(8000)->Unit(benchmark::kMillisecond);

// One Gauss-Newton linearisation and elimination of 8 s in windows of 1 s, on one thread.
void ShootingLinearisation(benchmark::State& state) {
  const Bench bench;
  const FitSpace space(InertialFitParameters(bench.plant));
  const std::vector<FitRecording> fit{{&bench.recording, DriveSignal(bench.recording)}};
  const recordings::SensorNoise noise{VectorXd::Constant(6, 6e-4), VectorXd::Constant(6, 1e-2),
                                      VectorXd::Zero(6)};
  RecordingShooting model(bench.plant, bench.values, space, fit, ScalesOf(noise), {}, 1);
  ShootingOptions options;
  options.max_iterations = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(
        SolveShooting(ShootingProblemFor(&model, space), space.nominal(), {}, options, {}).cost);
  }
}
BENCHMARK(ShootingLinearisation)->Unit(benchmark::kMillisecond);

void PredictEightSeconds(benchmark::State& state) {
  const Bench bench;
  PredictionOptions options;
  options.restart = state.range(0) == 0 ? RestartState::kMeasured : RestartState::kFiltered;
  for (auto _ : state) {
    benchmark::DoNotOptimize(PredictRecording(bench.plant, bench.values, bench.recording, options).q.data());
  }
}
BENCHMARK(PredictEightSeconds)->Arg(0)->Arg(1)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace rg::sysid

BENCHMARK_MAIN();
