// What the loop's identification gains by its start and loses by its regulariser: simulated Mico² with what
// the model lacks (lag, Stribeck friction), 6 s at 25 Hz to fit, 6 s held out. One line per variant, medians
// over the robots; RG_SOURCE_DIR is the source tree.
//
//   sysid_loop_identification [robots]      default 8
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <vector>

#include "common/base/clock.h"
#include "services/jobs/identify_problem.h"
#include "services/rollouts/scoring.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg {
namespace {

using Eigen::VectorXd;

constexpr double kWhole = std::numeric_limits<double>::infinity();

struct Variant {
  const char* name;
  bool regress;
  double alpha, long_weight;
  bool bodies = true;
};

constexpr Variant kVariants[] = {
    {"from p_init, alpha 1e-2", false, 1e-2, 0.02},
    {"from the regression, alpha 1e-2", true, 1e-2, 0.02},
    {"the same, alpha 1e-6", true, 1e-6, 0.02},
    {"without the long window", true, 1e-6, 0.0},
    {"with it, raw links", true, 1e-6, 0.02, false},
};

struct Outcome {
  double holdout, holdout_whole, fitted, fitted_whole, seconds;
};

std::vector<effects::EffectSpec> Hidden() {
  const std::vector<std::string> joints = sysid::testing::LoadPlant("mico2").joint_names();
  const double viscous[] = {9.0, 11.0, 12.0, 2.6, 2.9, 2.8}, rotor[] = {0.30, 0.35, 0.30, 0.045, 0.04, 0.04};
  const double coulomb[] = {0.12, 0.15, 0.12, 0.02, 0.02, 0.015};
  std::vector<effects::EffectSpec> out;
  for (size_t j = 0; j < joints.size(); ++j) {
    out.push_back(effects::MakeSpec("viscous_friction", {joints[j]}, {{"viscous", viscous[j]}}));
    out.push_back(effects::MakeSpec("rotor_inertia", {joints[j]}, {{"armature", rotor[j]}}));
    out.push_back(effects::MakeSpec(
        "stribeck_friction", {joints[j]},
        {{"coulomb", coulomb[j]}, {"static", 1.25 * coulomb[j]}, {"stribeck_velocity", 0.05}}));
    out.push_back(effects::MakeSpec("actuator_lag", {joints[j]}, {{"time_constant", 0.02}}));
  }
  return out;
}

struct Robot {
  recordings::Recording fit, holdout;

  explicit Robot(uint64_t seed) {
    const sim::Plant plant = sysid::testing::LoadPlant("mico2", Hidden());
    Rng rng(seed);
    VectorXd values = plant.parameters().Nominal();
    for (int i = 0; i < values.size(); ++i) {
      const sim::ParameterKind kind = plant.parameters()[i].kind;
      const bool body = kind == sim::ParameterKind::kMass || kind == sim::ParameterKind::kInertia;
      if (body || kind == sim::ParameterKind::kEffect) values[i] *= 1.0 + 0.2 * rng.Uniform(-1.0, 1.0);
    }
    sysid::testing::MakeOptions make{.duration_s = 6.0,
                                     .rate_hz = 25.0,
                                     .position_noise = 3e-4,
                                     .velocity_noise = 0.01,
                                     .center = sysid::testing::CandlePose(),
                                     .moves = true};
    fit = sysid::testing::MakeRecording(plant, values, 1000 + seed, make);
    for (int j = 0; j < fit.v.rows(); ++j) fit.v.row(j) *= j % 2 == 0 ? 1.02 : 0.98;
    make.position_noise = make.velocity_noise = 0.0;
    holdout = sysid::testing::MakeRecording(plant, values, 2000 + seed, make);
  }
};

double Score(const sim::Plant& plant, const VectorXd& values, const recordings::Recording& rec,
             double window) {
  rollouts::SimulationScoreOptions options;
  options.window_s = window;
  return rollouts::ScoreSimulation(plant, values, rec, options).joint_rms;
}

Outcome Identify(const Robot& robot, const Variant& variant) {
  const sim::Plant bare = sysid::testing::LoadPlant("mico2");
  jobs::IdentifyProblemOptions options;
  options.friction = true;
  options.consistent_inertias = variant.bodies;
  options.alpha = variant.alpha;
  options.simulator.step_s = 0.002;
  options.simulator.stick_velocity = 2e-3;
  const sim::ModelFile model = *jobs::ModelToFit({bare, bare.parameters().Nominal(), 1}, options);
  const double begin = RealClock().SteadySeconds();
  const sysid::SolveOptions solve{.max_iterations = 60, .function_tolerance = 1e-5};
  const auto first = *jobs::IdentifyProblem::Create(model.plant, model.values, robot.fit, options);
  const VectorXd start = variant.regress ? first.Start(model.plant, robot.fit) : first.problem().initial;
  VectorXd p = sysid::Solve(first.problem(), start, solve, {}).p;
  options.long_weight = variant.long_weight;
  const auto last = *jobs::IdentifyProblem::Create(model.plant, model.values, robot.fit, options);
  p = sysid::Solve(last.problem(), p, solve, {}).p;
  const double seconds = RealClock().SteadySeconds() - begin;
  const VectorXd values = last.FullValues(p);
  return {Score(model.plant, values, robot.holdout, 1.0), Score(model.plant, values, robot.holdout, kWhole),
          Score(model.plant, values, robot.fit, 1.0), Score(model.plant, values, robot.fit, kWhole), seconds};
}

double Median(std::vector<Outcome>* outcomes, double Outcome::*field) {
  std::sort(outcomes->begin(), outcomes->end(),
            [&](const Outcome& a, const Outcome& b) { return a.*field < b.*field; });
  const size_t n = outcomes->size();
  return 0.5 * ((*outcomes)[(n - 1) / 2].*field + (*outcomes)[n / 2].*field);
}

void Run(int robots) {
  std::printf("%-32s %12s %12s %12s %12s %9s\n", "medians, rad", "held out 1 s", "6 s", "fitted 1 s", "6 s",
              "seconds");
  for (const Variant& variant : kVariants) {
    std::vector<Outcome> outcomes;
    for (int k = 0; k < robots; ++k) {
      outcomes.push_back(Identify(Robot(static_cast<uint64_t>(k + 1)), variant));
    }
    std::printf("%-32s %12.5f %12.5f %12.5f %12.5f %9.1f\n", variant.name,
                Median(&outcomes, &Outcome::holdout), Median(&outcomes, &Outcome::holdout_whole),
                Median(&outcomes, &Outcome::fitted), Median(&outcomes, &Outcome::fitted_whole),
                Median(&outcomes, &Outcome::seconds));
    std::fflush(stdout);
  }
}

}  // namespace
}  // namespace rg

int main(int argc, char** argv) {
  rg::Run(argc > 1 ? std::max(1, std::atoi(argv[1])) : 8);
  return 0;
}
