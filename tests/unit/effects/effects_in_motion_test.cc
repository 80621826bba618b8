// What every effect owes: nothing when it is off, no energy when it only dissipates, no surprise over a
// range of parameters and speeds.
#include <gtest/gtest.h>

#include <cmath>

#include "common/base/rng.h"
#include "common/dynamics/dynamics.h"
#include "common/effects/effect_catalog.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::MakeSpec;
using rg::testing::JointNames;
using rg::testing::LoadRobot;
using rg::testing::MakePlant;

const std::vector<std::string> kJoints = {"shoulder", "elbow"};
const Eigen::VectorXd kQ = Eigen::VectorXd::LinSpaced(2, 0.4, -0.9);
const Eigen::VectorXd kV = Eigen::VectorXd::LinSpaced(2, 0.7, -1.1);
const Eigen::VectorXd kZero = Eigen::VectorXd::Zero(2);

Trajectory Swing(const Plant& plant) {
  Simulator simulator(plant);
  std::vector<double> times;
  Eigen::MatrixXd u(2, 11);
  for (int k = 0; k <= 10; ++k) {
    times.push_back(0.04 * k);
    u(0, k) = 3 * std::sin(0.9 * k);
    u(1, k) = 2 * std::cos(0.7 * k);
  }
  const auto command = CommandSignal::Create(times, u, Hold::kZeroOrder).value();
  return simulator.Simulate(simulator.MakeState(kQ, kV, 0.0, command), command, {0.1, 0.4});
}

TEST(EffectsOff, ChangeNothing) {
  const Eigen::MatrixXd rigid = Swing(MakePlant("arm2")).position;
  const std::map<std::string, std::map<std::string, double>> off = {
      {"viscous_friction", {}},
      {"coulomb_friction", {}},
      {"stribeck_friction", {}},
      {"asymmetric_friction", {}},
      {"load_dependent_friction", {}},
      {"quadratic_drag", {}},
      {"presliding_hysteresis", {}},
      {"actuator_delay", {}},
      {"actuator_lag", {}},
      {"torque_gain", {}},
      {"torque_deadband", {}},
      {"torque_saturation", {}},
      {"torque_offset", {}},
      {"torque_ripple", {}},
      {"rotor_inertia", {}},
      {"payload", {}},
      {"gravity_misalignment", {}},
      {"encoder_offset", {}},
      {"sensor_delay", {}},
      {"position_spring", {}},
      {"thermal_drift", {}},
      {"external_disturbance", {}},
      {"contact", {{"stiffness", 0}, {"damping", 0}}},
      {"unknown_field", {}},
      {"joint_coupling", {}},
  };
  for (const auto& [id, values] : off) {
    const auto* info = effects::FindEffect(id);
    const auto joints = info->scope == effects::Scope::kRobot ? std::vector<std::string>{} : kJoints;
    const Trajectory out = Swing(MakePlant("arm2", {MakeSpec(id, joints, values)}));
    ASSERT_TRUE(out.outcome.ok()) << id << " " << out.outcome.ToString();
    EXPECT_LT((out.position - rigid).cwiseAbs().maxCoeff(), 1e-7) << id;
  }
}

// A lag filters what acts on the command, and nothing of what acts on the motor behind it.
TEST(TorqueRipple, OnTheCommandIsFilteredByALag) {
  const auto swing = [](const std::string& side, double lag) {
    effects::EffectSpec ripple =
        MakeSpec("torque_ripple", {kJoints[0]}, {{"amplitude", 0.5}, {"cycles_per_rev", 9}, {"phase", 0.4}});
    ripple.options["acts_on"] = side;
    std::vector<effects::EffectSpec> effects = {ripple};
    if (lag > 0) effects.push_back(MakeSpec("actuator_lag", {kJoints[0]}, {{"time_constant", lag}}));
    return Swing(MakePlant("arm2", effects)).position;
  };
  const auto apart = [&](double lag) {
    return (swing("motor", lag) - swing("command", lag)).cwiseAbs().maxCoeff();
  };
  EXPECT_EQ(apart(0), 0);
  EXPECT_GT(apart(0.05), 1e-3);
  EXPECT_NEAR(apart(2e-5), apart(1e-5) * 2, 0.5 * apart(1e-5)) << "to first order in the time constant";
}

TEST(EffectsAlmostRigid, ApproachTheRigidArm) {
  // A stiff transmission, mount or hold with hardly any inertia of its own.
  const Eigen::MatrixXd rigid = Swing(MakePlant("arm2")).position;
  const std::vector<effects::EffectSpec> specs = {
      MakeSpec("joint_elasticity", kJoints, {{"stiffness", 1e6}, {"damping", 100}, {"motor_inertia", 1e-5}}),
      MakeSpec("backlash", kJoints,
               {{"gap", 0}, {"contact_stiffness", 1e6}, {"contact_damping", 100}, {"motor_inertia", 1e-5}}),
      MakeSpec("base_flexibility", {}, {{"stiffness", 1e7}, {"damping", 1e3}}),
      MakeSpec("sloshing_payload", {}, {{"mass", 1e-6}, {"stiffness", 100}})};
  for (const auto& spec : specs) {
    const Trajectory out = Swing(MakePlant("arm2", {spec}));
    ASSERT_TRUE(out.outcome.ok()) << spec.id << " " << out.outcome.ToString();
    EXPECT_LT((out.position - rigid).cwiseAbs().maxCoeff(), 2e-3) << spec.id;
  }
}

// Within its nodes splines of one height add up to that height.
TEST(UnknownFieldAsDrag, IsViscousFrictionWhereItIsTheSameEverywhere) {
  std::map<std::string, double> values = {{"low", -6}, {"high", 6}};
  for (int i = 0; i < 8; ++i) values["w" + std::to_string(i)] = 0.8;
  effects::EffectSpec drag = MakeSpec("unknown_field", kJoints, values);
  drag.options["variable"] = "drag";
  const Trajectory same = Swing(MakePlant("arm2", {drag}));
  const Trajectory viscous =
      Swing(MakePlant("arm2", {MakeSpec("viscous_friction", kJoints, {{"viscous", 0.8}})}));
  EXPECT_LT((same.position - viscous.position).cwiseAbs().maxCoeff(), 1e-12);
}

TEST(DissipativeEffects, OnlyTakeEnergyFromAFreeArm) {
  auto model = LoadRobot("arm2");
  dynamics::Mechanism mechanism(*model);
  dynamics::Workspace workspace;
  const std::vector<effects::EffectSpec> specs = {
      MakeSpec("viscous_friction", kJoints, {{"viscous", 1}}),
      MakeSpec("coulomb_friction", kJoints, {{"coulomb", 0.7}}),
      MakeSpec("stribeck_friction", kJoints, {{"coulomb", 0.4}, {"static", 0.8}, {"stribeck_velocity", 0.1}}),
      MakeSpec("asymmetric_friction", kJoints, {{"coulomb_positive", 0.9}, {"coulomb_negative", 0.3}}),
      MakeSpec("load_dependent_friction", kJoints, {{"coulomb", 0.5}, {"load_coefficient", 0.1}}),
      MakeSpec("quadratic_drag", kJoints, {{"quadratic", 0.5}}),
      MakeSpec("thermal_drift", kJoints, {{"initial", 0.8}, {"final", 0.4}, {"time_constant", 1}})};
  for (const auto& spec : specs) {
    Simulator simulator(MakePlant("arm2", {spec}));
    State x = simulator.MakeState(kQ, kV);
    double last = 1e9;
    for (int k = 0; k < 1500; ++k) {
      ASSERT_TRUE(simulator.Advance(x, kZero, 1e-3).ok());
      const double energy = dynamics::KineticEnergy(mechanism, workspace, x.q, x.v) +
                            dynamics::PotentialEnergy(mechanism, workspace, x.q);
      // The integrator's own energy error per step, of third order.
      EXPECT_LT(energy, last + 2e-5) << spec.id << " step " << k;
      last = energy;
    }
  }
}

// Random plants, values and commands: whatever stands in the catalogue at any admissible strength must step
// a light arm without losing the solution.
TEST(AllEffects, RunAtRandomStrengthsOnTheLightArm) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  Rng rng(11);
  int runs = 0;
  for (const auto& info : effects::Catalog()) {
    if (info.scope == effects::Scope::kJointPair || info.id == "viscous_friction") continue;
    for (int trial = 0; trial < 3; ++trial) {
      effects::EffectSpec spec;
      spec.id = info.id;
      if (info.scope == effects::Scope::kJoint) spec.joints = joints;
      std::vector<std::string> owners = spec.joints;
      if (owners.empty()) owners = {"*"};
      for (const auto& owner : owners) {
        for (size_t i = 0; i < info.parameters.size(); ++i) {
          const auto& p = info.parameters[i];
          if (!info.Applies(static_cast<int>(i), spec) || p.default_is_effort) continue;
          if (p.name == "low" || p.name == "high") continue;
          const double scale = p.prior_of_effort ? 3.0 : 1.0;
          const bool both_signs =
              p.lower < 0 && p.name != "stiffness" && p.name != "cubic";  // else it runs away
          const double value = p.default_value +
                               p.prior_stddev * scale * (both_signs ? rng.Uniform(-2, 2) : rng.Uniform(0, 2));
          spec.values[owner][p.name] = std::min(std::max(value, p.lower), p.upper);
        }
      }
      const Plant plant =
          MakePlant("mico2", {spec, MakeSpec("viscous_friction", joints, {{"viscous", 0.3}})});
      Simulator simulator(plant);
      std::vector<double> times;
      Eigen::MatrixXd u(6, 25);
      for (int k = 0; k < 25; ++k) {
        times.push_back(0.04 * k);
        for (int i = 0; i < 6; ++i) u(i, k) = rng.Uniform(-1, 1) * (i < 3 ? 8.0 : 1.0);
      }
      const auto command = CommandSignal::Create(times, u, Hold::kZeroOrder).value();
      Eigen::VectorXd q(6);
      q << 0.0, 2.8, 2.6, 0.3, 0.2, 0.1;
      const Trajectory out =
          simulator.Simulate(simulator.MakeState(q, Eigen::VectorXd::Zero(6), 0.0, command), command, {1.0},
                             {.initial_state = true, .parameters = PaperParameters(plant)});
      EXPECT_TRUE(out.outcome.ok()) << info.id << " " << out.outcome.ToString();
      EXPECT_TRUE(out.dposition.allFinite()) << info.id;
      ++runs;
    }
  }
  EXPECT_GT(runs, 60);
}

}  // namespace
}  // namespace rg::sim
