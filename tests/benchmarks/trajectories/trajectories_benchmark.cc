// Control on the Mico²: Riccati, one GNMS iteration, whole solves, trajectories of 1 s, success at 2 s.
//   RG_SOURCE_DIR=. build/release/bin/trajectories_benchmark --benchmark_format=json
#include <benchmark/benchmark.h>

#include <cstdlib>
#include <memory>

#include "common/base/check.h"
#include "common/model/urdf_loader.h"
#include "services/trajectories/shard.h"

namespace rg::trajectories {
namespace {

sim::Plant Mico() {
  const char* source = std::getenv("RG_SOURCE_DIR");
  model::LoadOptions options;
  options.joints = {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"};
  auto model =
      model::LoadUrdf(std::string(source != nullptr ? source : ".") + "/deploy/robots/mico2.urdf", options);
  RG_CHECK(model.ok()) << model.status().ToString();
  return sim::Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
}

Eigen::VectorXd Candle() {
  return (Eigen::VectorXd(6) << 0.0, 3.14159265358979, 3.14159265358979, 0.0, 0.0, 0.0).finished();
}

ShardSpec Spec(const sim::Plant& plant, double duration_s, double step_s) {
  ShardSpec spec;
  spec.seed = 1;
  spec.duration_s = duration_s;
  spec.mpc.simulation.step_s = step_s;
  spec.mpc.peak_torque = KnownPeakTorques(plant.model());
  spec.sampling.home = Candle();
  return spec;
}

void BM_RiccatiSweep(benchmark::State& state) {
  LqSolver lq(12, 6, 25);
  LqProblem& problem = lq.problem();
  for (int k = 0; k <= 25; ++k) {
    problem.Q(k).setIdentity();
    if (k == 25) break;
    problem.R(k).setIdentity();
    problem.A(k).setIdentity();
    problem.A(k).topRightCorner(6, 6).diagonal().setConstant(0.04);
    problem.B(k).bottomRows(6).diagonal().setConstant(1.0);
    problem.d(k).setConstant(0.01);
  }
  for (auto _ : state) benchmark::DoNotOptimize(lq.Solve({}).sweeps);
}
BENCHMARK(BM_RiccatiSweep)->Unit(benchmark::kMicrosecond);

// One warm iteration: linear-quadratic problem, step, new linearisation of 25 knots. Argument: step [ms].
void BM_GnmsIteration(benchmark::State& state) {
  const sim::Plant plant = Mico();
  ShardSpec spec = Spec(plant, 1.0, 1e-3 * state.range(0));
  spec.mpc.cold_iterations = 3;
  spec.mpc.warm_iterations = 1;
  spec.mpc.solver.extra_iterations = 0;
  auto controller = MpcController::Create(plant, plant.parameters().Nominal(), spec.mpc).value();
  auto sampler = StartGoalSampler::Create(plant.model(), controller->limits(), 1.0, spec.sampling).value();
  Rng rng(1);
  Eigen::VectorXd u, q, v;
  for (auto _ : state) {
    state.PauseTiming();
    const StartGoal draw = *sampler.Draw(rng);
    controller->Reset();
    controller->Solve(draw.q, draw.v, draw.goal, &u);
    q = controller->plan().x(1).head(6);
    v = controller->plan().x(1).segment(6, 6);
    state.ResumeTiming();
    benchmark::DoNotOptimize(controller->Solve(q, v, draw.goal, &u).iterations);
  }
}
BENCHMARK(BM_GnmsIteration)->Arg(1)->Arg(4)->Arg(5)->Arg(10)->Unit(benchmark::kMillisecond);

void BM_ColdSolve(benchmark::State& state) {
  const sim::Plant plant = Mico();
  const ShardSpec spec = Spec(plant, 1.0, 1e-3 * state.range(0));
  auto controller = MpcController::Create(plant, plant.parameters().Nominal(), spec.mpc).value();
  auto sampler = StartGoalSampler::Create(plant.model(), controller->limits(), 1.0, spec.sampling).value();
  Rng rng(1);
  Eigen::VectorXd u;
  double iterations = 0.0, converged = 0.0;
  for (auto _ : state) {
    const StartGoal draw = *sampler.Draw(rng);
    controller->Reset();
    const MpcStatus status = controller->Solve(draw.q, draw.v, draw.goal, &u);
    iterations += status.iterations;
    converged += status.termination == Termination::kConverged;
  }
  state.counters["iterations"] = benchmark::Counter(iterations, benchmark::Counter::kAvgIterations);
  state.counters["converged"] = benchmark::Counter(converged, benchmark::Counter::kAvgIterations);
}
BENCHMARK(BM_ColdSolve)->Arg(10)->Unit(benchmark::kMillisecond);

// Arguments: duration [s], simulation step [ms]. One iteration of the benchmark is one slot.
void BM_Trajectory(benchmark::State& state) {
  const sim::Plant plant = Mico();
  ShardSpec spec = Spec(plant, static_cast<double>(state.range(0)), 1e-3 * state.range(1));
  spec.count = 1;
  double failures = 0.0, worst = 0.0, iterations = 0.0, good = 0.0;
  for (auto _ : state) {
    const Shard shard = GenerateShard(plant, plant.parameters().Nominal(), spec).value();
    ++spec.first;
    failures += static_cast<double>(shard.num_failures());
    for (const Trajectory& t : shard.trajectories) {
      worst = std::max(worst, t.goal_error);
      iterations += t.iterations;
      ++good;
    }
  }
  state.counters["success_rate"] = good / (good + failures);
  state.counters["worst_goal_error_rad"] = worst;
  state.counters["gnms_iterations"] = benchmark::Counter(iterations, benchmark::Counter::kAvgIterations);
}
BENCHMARK(BM_Trajectory)
    ->Args({1, 10})
    ->Args({1, 5})
    ->Args({1, 1})
    ->Iterations(100)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(BM_Trajectory)->Args({2, 10})->Iterations(400)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace rg::trajectories

BENCHMARK_MAIN();
