// What the integrators do to energy and to joints at rest: one line per method and step. Run in the source
// tree.
//
//   integrator_figures
#include <cmath>
#include <cstdio>

#include "common/dynamics/dynamics.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using Eigen::VectorXd;

constexpr struct {
  Integrator integrator;
  const char* name;
  double step_s;
} kMethods[] = {{Integrator::kSemiImplicitEuler, "semi-implicit Euler", 1e-3},
                {Integrator::kLeapfrog, "leapfrog", 1e-3},
                {Integrator::kLeapfrog, "leapfrog", 4e-3},
                {Integrator::kRk4, "RK4", 1e-3},
                {Integrator::kRk4, "RK4", 1e-2}};

SimulatorOptions OptionsOf(Integrator integrator, double step_s) {
  SimulatorOptions options;
  options.integrator = integrator;
  options.step_s = step_s;
  return options;
}

struct Drift {
  double largest = 0.0, end = 0.0, swing = 0.0;  // J: |E − E0| at most, E − E0 at the end, largest kinetic
};

// A robot without damping or friction falls freely for `seconds`.
Drift EnergyDrift(const char* robot, const SimulatorOptions& options, double seconds) {
  const auto model = testing::LoadRobot(robot);
  const Plant plant = testing::MakePlant(robot);
  Simulator simulator(plant, options);
  VectorXd p = plant.parameters().Nominal();
  for (const auto kind : {ParameterKind::kDamping, ParameterKind::kFriction}) {
    for (const int i : plant.parameters().OfKind(kind)) p[i] = 0.0;
  }
  simulator.SetParameters(p);
  dynamics::Mechanism mechanism(*model);
  dynamics::Workspace workspace;
  const int n = plant.num_joints();
  State x = simulator.MakeState(VectorXd::LinSpaced(n, 0.9, 1.6), VectorXd::Zero(n));
  const double start = dynamics::PotentialEnergy(mechanism, workspace, x.q);
  Drift out;
  for (int k = 0; k < static_cast<int>(seconds * 20); ++k) {
    if (!simulator.Advance(x, VectorXd::Zero(n), 0.05).ok()) return {NAN, NAN, NAN};
    const double kinetic = dynamics::KineticEnergy(mechanism, workspace, x.q, x.v);
    out.swing = std::max(out.swing, kinetic);
    out.end = kinetic + dynamics::PotentialEnergy(mechanism, workspace, x.q) - start;
    out.largest = std::max(out.largest, std::abs(out.end));
  }
  return out;
}

// Largest way in 10 s of a Mico² that dry friction holds against gravity, rad.
double Creep(const SimulatorOptions& options) {
  const auto joints = testing::JointNames(*testing::LoadRobot("mico2"));
  const Plant plant =
      testing::MakePlant("mico2", {effects::MakeSpec("coulomb_friction", joints, {{"coulomb", 15.0}})});
  Simulator simulator(plant, options);
  const VectorXd q = VectorXd::LinSpaced(6, 0.9, 2.65);
  State x = simulator.MakeState(q, VectorXd::Zero(6));
  if (!simulator.Advance(x, VectorXd::Constant(6, 0.2), 10.0).ok()) return NAN;
  return (x.q - q).cwiseAbs().maxCoeff();
}

void Run() {
  std::printf("%-20s %6s  %36s  %36s  %12s\n", "method", "step", "arm2, 10 s: most / end / kinetic, J",
              "pendulum, 100 s: most / end / kinetic", "creep, rad");
  for (const auto& method : kMethods) {
    const SimulatorOptions options = OptionsOf(method.integrator, method.step_s);
    const Drift arm = EnergyDrift("arm2", options, 10.0);
    const Drift pendulum = EnergyDrift("pendulum", options, 100.0);
    std::printf("%-20s %4.0f ms  %12.2e %11.2e %11.2f  %12.2e %11.2e %11.2f  %12.2e\n", method.name,
                1e3 * method.step_s, arm.largest, arm.end, arm.swing, pendulum.largest, pendulum.end,
                pendulum.swing, Creep(options));
  }
}

}  // namespace
}  // namespace rg::sim

int main() {
  rg::sim::Run();
  return 0;
}
