// Rigid-body algorithms on the Mico² (6 joints, fingers locked), per instruction set, with KDL in the
// same run as the yardstick: compare ratios, not microseconds. From the repository's root:
//   build/release/bin/dynamics_benchmark --benchmark_format=json --benchmark_repetitions=9
//     --benchmark_report_aggregates_only=true --benchmark_enable_random_interleaving=true
#include <benchmark/benchmark.h>

#include <kdl/chaindynparam.hpp>
#include <kdl/chainidsolver_recursive_newton_euler.hpp>

#include "common/dynamics/dynamics.h"
#include "common/dynamics/mechanism_impl.h"
#include "tests/benchmarks/dynamics/lane_kernels.h"
#include "tests/unit/dynamics/kdl_tree.h"
#include "tests/unit/dynamics/robots.h"

namespace rg::dynamics {

// One definition per instruction set in lane_kernels.cc.
namespace isa_v1 {
extern const LaneBenchmark kLaneBenchmark;
}
namespace isa_v3 {
extern const LaneBenchmark kLaneBenchmark;
}
namespace isa_v4 {
extern const LaneBenchmark kLaneBenchmark;
}

namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

struct Problem {
  explicit Problem(math::Isa isa, const model::RobotModel& robot = MicoArm())
      : model(robot), mechanism(model, isa), n(model.num_joints()) {
    Rng rng(1);
    state = DrawState(rng, n);
    tau = out = c = VectorXd::Zero(n);
    M = dq = dv = MatrixXd::Zero(n, n);
    Y = MatrixXd::Zero(n, 10 * n);
    Rnea(mechanism, workspace, state.q, state.v, state.a, tau);
  }
  // The input depends on the last result's bits as a simulation's does, without leaving the state.
  void Feed(double last) { state.q[0] += 1e-30 * last; }

  model::RobotModel model;
  Mechanism mechanism;
  int n;
  Workspace workspace;
  RandomState state;
  VectorXd tau, out, c;
  MatrixXd M, dq, dv, Y;
};

template <class Body>
void Run(benchmark::State& state, math::Isa isa, Body body) {
  if (!math::IsaSupported(isa)) {
    state.SkipWithError("instruction set not supported");
    return;
  }
  Problem problem(isa);
  for (auto _ : state) {
    body(problem);
    benchmark::ClobberMemory();
  }
}

void RegisterOurs(math::Isa isa) {
  const auto add = [isa](const std::string& name, auto body) {
    benchmark::RegisterBenchmark((name + "/" + math::IsaName(isa)).c_str(),
                                 [isa, body](benchmark::State& state) { Run(state, isa, body); });
  };
  add("rnea", [](Problem& p) {
    Rnea(p.mechanism, p.workspace, p.state.q, p.state.v, p.state.a, p.out);
    p.Feed(p.out[0]);
  });
  add("crba", [](Problem& p) {
    Crba(p.mechanism, p.workspace, p.state.q, p.M);
    p.Feed(p.M(0, 0));
  });
  add("aba", [](Problem& p) {
    Aba(p.mechanism, p.workspace, p.state.q, p.state.v, p.tau, p.out);
    p.Feed(p.out[0]);
  });
  add("mass_matrix_and_bias", [](Problem& p) {
    MassMatrixAndBias(p.mechanism, p.workspace, p.state.q, p.state.v, p.M, p.c);
    p.Feed(p.c[0]);
  });
  add("rnea_derivatives", [](Problem& p) {
    RneaDerivatives(p.mechanism, p.workspace, p.state.q, p.state.v, p.state.a, p.dq, p.dv);
    p.Feed(p.dq(0, 0));
  });
  add("aba_derivatives", [](Problem& p) {
    AbaDerivatives(p.mechanism, p.workspace, p.state.q, p.state.v, p.tau, p.out, p.dq, p.dv, p.M);
    p.Feed(p.out[0]);
  });
  add("regressor", [](Problem& p) {
    TorqueRegressor(p.mechanism, p.workspace, p.state.q, p.state.v, p.state.a, p.Y);
    p.Feed(p.Y(0, 0));
  });
  add("step_terms", [](Problem& p) {
    const Mechanism::Impl& m = p.mechanism.impl();
    m.kernels->step_terms(m.tree, m.inertias, m.gravity.data(), p.state.q.data(), p.state.v.data(),
                          p.state.a.data(), Scratch(m, p.workspace.impl()));
  });
}

void RegisterLanes(math::Isa isa, const LaneBenchmark& lanes) {
  if (!math::IsaSupported(isa)) return;
  benchmark::RegisterBenchmark(
      (std::string("step_terms_lanes") + std::to_string(lanes.lanes) + "/" + math::IsaName(isa)).c_str(),
      [&lanes](benchmark::State& state) {
        const model::RobotModel model = MicoArm();
        const Tree tree = MakeTree(model);
        const BodyParameters phi = LumpedInertias(model, model.NominalLinkParameters());
        void* buffer = lanes.make(tree, phi.data());
        for (auto _ : state) {
          lanes.run(tree, buffer);
          benchmark::ClobberMemory();
        }
        state.counters["per_lane"] =
            benchmark::Counter(static_cast<double>(state.iterations()) * lanes.lanes,
                               benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
        lanes.destroy(buffer);
      });
}

KDL::Chain KdlChain(const model::RobotModel& model) {
  const KDL::Tree tree = KdlTree(model);
  KDL::Chain chain;
  tree.getChain(tree.getRootSegment()->first, model.end_effector().name, chain);
  return chain;
}

void KdlRnea(benchmark::State& state) {
  const KDL::Chain chain = KdlChain(MicoArm());
  KDL::ChainIdSolver_RNE solver(chain, KDL::Vector(0, 0, -9.81));
  Rng rng(1);
  const RandomState s = DrawState(rng, 6);
  KDL::JntArray q(6), v(6), a(6), tau(6);
  q.data = s.q, v.data = s.v, a.data = s.a;
  const KDL::Wrenches none(chain.getNrOfSegments(), KDL::Wrench::Zero());
  for (auto _ : state) {
    solver.CartToJnt(q, v, a, none, tau);
    q(0) += 1e-30 * tau(0);
    benchmark::ClobberMemory();
  }
}

void KdlMass(benchmark::State& state) {
  const KDL::Chain chain = KdlChain(MicoArm());
  KDL::ChainDynParam solver(chain, KDL::Vector(0, 0, -9.81));
  Rng rng(1);
  KDL::JntArray q(6);
  q.data = DrawState(rng, 6).q;
  KDL::JntSpaceInertiaMatrix M(6);
  if (solver.JntToMass(q, M) != 0) state.SkipWithError("KDL refuses");
  for (auto _ : state) {
    solver.JntToMass(q, M);
    q(0) += 1e-30 * M(0, 0);
    benchmark::ClobberMemory();
  }
}

}  // namespace
}  // namespace rg::dynamics

int main(int argc, char** argv) {
  using namespace rg;
  benchmark::RegisterBenchmark("kdl_rnea", dynamics::KdlRnea);
  benchmark::RegisterBenchmark("kdl_mass_matrix", dynamics::KdlMass);
  for (math::Isa isa : {math::Isa::kV1, math::Isa::kV3, math::Isa::kV4}) dynamics::RegisterOurs(isa);
  dynamics::RegisterLanes(math::Isa::kV1, dynamics::isa_v1::kLaneBenchmark);
  dynamics::RegisterLanes(math::Isa::kV3, dynamics::isa_v3::kLaneBenchmark);
  dynamics::RegisterLanes(math::Isa::kV4, dynamics::isa_v4::kLaneBenchmark);
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}
