// Time per 1 ms step of the Mico² (6 joints), with and without sensitivities and effects, and of the full
// Jacobian of an 8 s recording. "us_per_step" is what docs/figures.md quotes.
//
//   sim_benchmark --benchmark_out=sim.json --benchmark_out_format=json
#include <benchmark/benchmark.h>

#include <cmath>

#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::MakeSpec;

const std::vector<std::string> kJoints = {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"};

// Damping as identified by the paper, so that the motion stays like an arm's.
std::vector<effects::EffectSpec> Damped() { return {}; }

std::vector<effects::EffectSpec> Friction() {
  return {MakeSpec("coulomb_friction", kJoints, {{"coulomb", 0.3}})};
}

std::vector<effects::EffectSpec> Everything() {
  return {
      MakeSpec("coulomb_friction", kJoints, {{"coulomb", 0.3}}),
      MakeSpec("joint_elasticity", kJoints, {{"stiffness", 1e4}, {"damping", 2}, {"motor_inertia", 0.05}}),
      MakeSpec("actuator_lag", kJoints, {{"time_constant", 0.01}}),
      MakeSpec("actuator_delay", kJoints, {{"delay", 0.005}})};
}

struct Bench {
  explicit Bench(std::vector<effects::EffectSpec> effects, Integrator integrator = Integrator::kLeapfrog)
      : plant(rg::testing::MakePlant("mico2", std::move(effects))), simulator(plant, Options(integrator)) {
    Eigen::VectorXd p = plant.parameters().Nominal();
    const double damping[] = {12.12, 15.18, 17.56, 3.63, 4.31, 4.27};
    for (int i = 0; i < 6; ++i) p[plant.parameters().Find("damping." + kJoints[i])] = damping[i];
    simulator.SetParameters(p);
    Eigen::MatrixXd u(6, 201);
    for (int k = 0; k <= 200; ++k) {
      times.push_back(0.04 * k);
      for (int i = 0; i < 6; ++i) u(i, k) = (i < 3 ? 6.0 : 1.5) * std::sin(0.13 * k + i);
    }
    command = CommandSignal::Create(times, u, Hold::kZeroOrder).value();
    Eigen::VectorXd q(6);
    q << 0.0, 2.8, 2.6, 0.3, 0.2, 0.1;
    x0 = simulator.MakeState(q, Eigen::VectorXd::Zero(6), 0.0, command);
  }
  static SimulatorOptions Options(Integrator integrator) {
    SimulatorOptions options;
    options.integrator = integrator;
    return options;
  }
  Plant plant;
  Simulator simulator;
  std::vector<double> times;
  CommandSignal command;
  State x0;
};

constexpr int kSteps = 8000;

void Run(benchmark::State& state, Bench& bench, const SensitivityRequest& request) {
  Trajectory out;
  for (auto _ : state) {
    bench.simulator.SimulateInto(bench.x0, bench.command, bench.times, request, &out);
    if (!out.outcome.ok()) state.SkipWithError(out.outcome.ToString().c_str());
    benchmark::DoNotOptimize(out.position.data());
  }
  state.counters["us_per_step"] = benchmark::Counter(
      kSteps * 1e-6, benchmark::Counter::kIsIterationInvariantRate | benchmark::Counter::kInvert);
}

template <auto Effects>
void Value(benchmark::State& state) {
  Bench bench(Effects());
  Run(state, bench, {});
}
template <auto Effects>
void Paper71(benchmark::State& state) {
  Bench bench(Effects());
  Run(state, bench, {false, PaperParameters(bench.plant)});
}
void ValueEuler(benchmark::State& state) {
  Bench bench(Damped(), Integrator::kSemiImplicitEuler);
  Run(state, bench, {});
}
void Paper71Euler(benchmark::State& state) {
  Bench bench(Damped(), Integrator::kSemiImplicitEuler);
  Run(state, bench, {false, PaperParameters(bench.plant)});
}
void AdvanceLinearized(benchmark::State& state) {
  Bench bench(Damped());
  Linearization lin;
  const Eigen::VectorXd u = Eigen::VectorXd::Constant(6, 0.5);
  for (auto _ : state) {
    State x = bench.x0;
    benchmark::DoNotOptimize(bench.simulator.Advance(x, u, 0.04, &lin).ok());
  }
}

BENCHMARK(Value<Damped>)->Name("value/rigid")->Unit(benchmark::kMillisecond);
BENCHMARK(ValueEuler)->Name("value/rigid_euler")->Unit(benchmark::kMillisecond);
BENCHMARK(Value<Friction>)->Name("value/friction")->Unit(benchmark::kMillisecond);
BENCHMARK(Value<Everything>)->Name("value/friction_elasticity_lag_delay")->Unit(benchmark::kMillisecond);
BENCHMARK(Paper71<Damped>)->Name("sensitivities71/rigid")->Unit(benchmark::kMillisecond);
BENCHMARK(Paper71Euler)->Name("sensitivities71/rigid_euler")->Unit(benchmark::kMillisecond);
BENCHMARK(Paper71<Friction>)->Name("sensitivities71/friction")->Unit(benchmark::kMillisecond);
BENCHMARK(Paper71<Everything>)
    ->Name("sensitivities71/friction_elasticity_lag_delay")
    ->Unit(benchmark::kMillisecond);
BENCHMARK(AdvanceLinearized)->Name("advance_40ms_linearized")->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace rg::sim

BENCHMARK_MAIN();
