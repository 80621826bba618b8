// Sensitivities of Simulate and Advance against central differences, for every effect of the catalogue:
// by the initial state (internal states included), every parameter, and the command.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <tuple>

#include "common/effects/effect_catalog.h"
#include "common/math/gradient_check.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

struct Case {
  std::string name;
  std::string robot;
  std::vector<EffectSpec> effects;
  double tolerance = 1e-6;
  double amplitude = 3.0;  // of the commands, N·m
};

Eigen::VectorXd StartPosition(const Plant& plant) {
  Eigen::VectorXd q(plant.num_joints());
  for (int i = 0; i < q.size(); ++i) {
    const auto& joint = plant.model().joint(i);
    q[i] = std::isfinite(joint.lower) ? joint.lower + 0.37 * (joint.upper - joint.lower) : 0.4 + 0.3 * i;
  }
  return q;
}

// Fast enough that no joint reverses within the window.
Eigen::VectorXd StartVelocity(const Plant& plant) {
  Eigen::VectorXd v(plant.num_joints());
  for (int i = 0; i < v.size(); ++i) v[i] = (i % 2 == 0 ? 1.0 : -0.8) * (1.0 + 0.1 * i);
  return v;
}

CommandSignal Commands(int n, double amplitude, Hold hold) {
  std::vector<double> times;
  Eigen::MatrixXd u(n, 12);
  for (int k = 0; k < 12; ++k) {
    times.push_back(-0.02 + 0.01 * k);
    for (int i = 0; i < n; ++i) u(i, k) = amplitude / (1.0 + i) * std::sin(0.7 * k + i) + 0.3;
  }
  return CommandSignal::Create(times, u, hold).value();
}

State FromStacked(const State& like, const Eigen::VectorXd& x) {
  State s = like;
  const auto n = like.q.size();
  s.q = x.head(n);
  s.v = x.segment(n, n);
  s.z = x.tail(x.size() - 2 * n);
  return s;
}

Eigen::VectorXd Outputs(const Trajectory& out) {
  const auto size = out.position.size();
  Eigen::VectorXd y(2 * size + out.state.rows());
  y << Eigen::Map<const Eigen::VectorXd>(out.position.data(), size),
      Eigen::Map<const Eigen::VectorXd>(out.velocity.data(), size), out.state.col(out.state.cols() - 1);
  return y;
}

// Steps of the differences: small against inertias and delays, whose nominal values are small.
double Scale(const Parameter& row) {
  if (row.kind == ParameterKind::kInertia) return 1e-3;
  if (row.unit == "s" || row.field == "gap" || row.field == "motor_inertia") return 1e-3;
  if (row.kind == ParameterKind::kMass || row.kind == ParameterKind::kCenterOfMass) return 1e-2;
  return row.field == "stiffness" || row.field == "bristle_stiffness" || row.field == "contact_stiffness"
             ? 10.0
             : 0.05;
}
constexpr double kStateScale = 0.02;

math::GradientCheckOptions Options(double tolerance) {
  math::GradientCheckOptions options;
  options.tolerance = tolerance;
  options.scale_floor = 1e-3;
  return options;
}

void PrintTo(const Case& c, std::ostream* os) { *os << c.name; }

class GradientTest : public ::testing::TestWithParam<Case> {};

TEST_P(GradientTest, SimulateMatchesCentralDifferences) {
  const Case& c = GetParam();
  const Plant plant = rg::testing::MakePlant(c.robot, c.effects);
  Simulator simulator(plant);
  const CommandSignal command = Commands(plant.num_joints(), c.amplitude, Hold::kLinear);
  const Eigen::VectorXd p0 = plant.parameters().Nominal();
  Eigen::VectorXd hold = Eigen::VectorXd::Constant(plant.num_joints(), 0.3);
  const State x0 = simulator.MakeState(StartPosition(plant), StartVelocity(plant), 0.0, &hold);
  const std::vector<double> times = {0.0, 0.0035, 0.01, 0.02};
  SensitivityRequest request{true, {}};
  for (int i = 0; i < plant.parameters().size(); ++i) request.parameters.push_back(i);

  const Trajectory out = simulator.Simulate(x0, command, times, request);
  ASSERT_TRUE(out.outcome.ok()) << out.outcome.ToString();
  Eigen::MatrixXd jacobian(out.dposition.rows() * 2 + out.dfinal_state.rows(), out.dposition.cols());
  jacobian << out.dposition, out.dvelocity, out.dfinal_state;

  const Eigen::Index nx = plant.num_states();
  Eigen::VectorXd base(nx + p0.size()), scale(nx + p0.size());
  base << x0.Stacked(), p0;
  scale.head(nx).setConstant(kStateScale);
  for (int i = 0; i < p0.size(); ++i) scale[nx + i] = Scale(plant.parameters()[i]);
  auto run = [&](const Eigen::VectorXd& at) {
    const Eigen::VectorXd input = base + scale.cwiseProduct(at);
    simulator.SetParameters(input.tail(p0.size()));
    return Outputs(simulator.Simulate(FromStacked(x0, input.head(nx)), command, times));
  };
  const auto check = math::CheckGradient(run, Eigen::VectorXd::Zero(base.size()),
                                         jacobian * scale.asDiagonal(), Options(c.tolerance));
  EXPECT_TRUE(check.ok) << check.message << " input "
                        << (check.column < nx ? std::to_string(check.column)
                                              : plant.parameters()[check.column - static_cast<int>(nx)].name);
}

TEST_P(GradientTest, AdvanceMatchesCentralDifferences) {
  const Case& c = GetParam();
  const Plant plant = rg::testing::MakePlant(c.robot, c.effects);
  Simulator simulator(plant);
  const int n = plant.num_joints();
  const Eigen::VectorXd u0 = Eigen::VectorXd::LinSpaced(n, 0.5, 1.5);
  State x0 = simulator.MakeState(StartPosition(plant), StartVelocity(plant), 0.0, &u0);
  // A past to look back to.
  ASSERT_TRUE(simulator.Advance(x0, 0.5 * u0, 0.02).ok());
  State x1 = x0;
  Linearization lin;
  ASSERT_TRUE(simulator.Advance(x1, u0, 0.02, &lin).ok());
  Eigen::MatrixXd jacobian(lin.A.rows(), lin.A.cols() + n);
  jacobian << lin.A, lin.B;
  Eigen::VectorXd base(plant.num_states() + n);
  base << x0.Stacked(), u0;
  auto run = [&](const Eigen::VectorXd& at) {
    const Eigen::VectorXd input = base + kStateScale * at;
    State x = FromStacked(x0, input.head(plant.num_states()));
    EXPECT_TRUE(simulator.Advance(x, input.tail(n), 0.02).ok());
    return x.Stacked();
  };
  const auto check = math::CheckGradient(run, Eigen::VectorXd::Zero(base.size()), kStateScale * jacobian,
                                         Options(c.tolerance));
  EXPECT_TRUE(check.ok) << check.message;
}

std::vector<Case> Cases() {
  const std::vector<std::string> all = {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"};
  std::vector<Case> cases;
  auto one = [&](const std::string& id, std::map<std::string, double> values, double tolerance = 1e-6) {
    const auto* info = effects::FindEffect(id);
    const bool robot = info->scope == effects::Scope::kRobot;
    cases.push_back(
        {id,
         "arm2",
         {MakeSpec(id, robot ? std::vector<std::string>{} : std::vector<std::string>{"shoulder", "elbow"},
                   std::move(values))},
         tolerance});
  };
  cases.push_back({"rigid_arm2", "arm2", {}});
  cases.push_back({"rigid_mico2", "mico2", {}});
  cases.push_back({"rigid_slide", "slide", {}});
  one("viscous_friction", {{"viscous", 0.8}});
  one("coulomb_friction", {{"coulomb", 0.4}});
  one("stribeck_friction", {{"coulomb", 0.3}, {"static", 0.5}, {"stribeck_velocity", 0.7}});
  one("asymmetric_friction", {{"coulomb_positive", 0.4}, {"coulomb_negative", 0.2}});
  one("load_dependent_friction", {{"coulomb", 0.1}, {"load_coefficient", 0.15}});
  one("quadratic_drag", {{"quadratic", 0.3}});
  one("presliding_hysteresis", {{"bristle_stiffness", 200}, {"coulomb", 0.5}, {"bristle_damping", 0.4}});
  one("joint_elasticity", {{"stiffness", 2000}, {"damping", 2}, {"motor_inertia", 0.2}});
  one("backlash",
      {{"gap", 0.001},
       {"contact_stiffness", 40},
       {"contact_damping", 0.2},
       {"motor_inertia", 0.2},
       {"motor_viscous", 0.4}},
      1e-5);
  one("actuator_delay", {{"delay", 0.0033}});
  one("actuator_lag", {{"time_constant", 0.007}});
  one("torque_gain", {{"gain", 1.2}});
  one("torque_deadband", {{"deadband", 0.05}}, 1e-5);
  one("torque_saturation", {{"limit", 0.4}});
  one("torque_offset", {{"offset", 0.3}});
  one("torque_ripple", {{"amplitude", 0.3}, {"cycles_per_rev", 11}, {"phase", 0.4}});
  one("rotor_inertia", {{"armature", 0.15}});
  one("payload", {{"mass", 0.7}, {"com_x", 0.1}, {"com_y", -0.05}, {"com_z", 0.02}});
  one("gravity_misalignment", {{"tilt", 0.1}, {"azimuth", 0.6}});
  one("encoder_offset", {{"offset", 0.02}});
  one("sensor_delay", {{"delay", 0.0042}});
  one("position_spring", {{"stiffness", 3}, {"cubic", 2}, {"center", 0.2}});
  one("thermal_drift", {{"initial", 0.5}, {"final", 0.3}, {"time_constant", 4}});
  one("base_flexibility", {{"stiffness", 3000}, {"damping", 10}});
  one("sloshing_payload", {{"mass", 0.3}, {"stiffness", 60}, {"damping", 0.4}});
  EffectSpec rod =
      MakeSpec("sloshing_payload", {}, {{"mass", 0.3}, {"length", 0.2}, {"damping", 0.4}, {"radius", 0.05}});
  rod.options = {{"form", "rod"}, {"hinge", "y"}};
  cases.push_back({"sloshing_rod_arm2", "arm2", {rod}});
  rod.options = {{"form", "rod"}, {"hinge", "z"}, {"point", "last_link"}};
  cases.push_back({"sloshing_rod_mico2", "mico2", {rod, MakeSpec("payload", {}, {{"mass", 0.2}})}});
  one("unknown_field", {{"w0", 0.3}, {"w3", -0.4}, {"w4", 0.5}, {"w5", 0.2}});
  EffectSpec drag =
      MakeSpec("unknown_field", {"elbow"}, {{"w0", 0.3}, {"w3", 0.4}, {"w4", 0.5}, {"w5", 0.2}});
  drag.options["variable"] = "drag";
  cases.push_back({"unknown_field_drag", "arm2", {drag}});
  EffectSpec on_command =
      MakeSpec("torque_ripple", {"elbow"}, {{"amplitude", 0.3}, {"cycles_per_rev", 11}, {"phase", 0.4}});
  on_command.options["acts_on"] = "command";
  cases.push_back({"ripple_on_command",
                   "arm2",
                   {MakeSpec("actuator_lag", {"elbow"}, {{"time_constant", 0.007}}), on_command}});
  cases.push_back(
      {"disturbance_torque",
       "arm2",
       {MakeSpec("external_disturbance", {"elbow"}, {{"start", 0.0043}, {"end", 0.0137}, {"torque", 1.0}})}});
  cases.push_back({"disturbance_force",
                   "arm2",
                   {MakeSpec("external_disturbance", {},
                             {{"start", 0.0043}, {"end", 0.0137}, {"force_x", 3.0}, {"force_z", -2.0}})}});
  EffectSpec contact = MakeSpec("contact", {}, {{"stiffness", 300}, {"damping", 5}, {"height", 3.0}});
  cases.push_back({"contact_plane", "mico2", {contact}, 1e-5});
  contact.options["point"] = "last_link";
  cases.push_back({"contact_last_link", "mico2", {contact}, 1e-5});
  cases.push_back({"contact_stop",
                   "arm2",
                   {MakeSpec("contact", {"elbow"}, {{"stiffness", 30}, {"damping", 1}, {"height", 3.5}})},
                   5e-6});
  cases.push_back({"joint_coupling",
                   "arm2",
                   {MakeSpec("joint_coupling", {"shoulder", "elbow"}, {{"coefficient", 0.3}}),
                    MakeSpec("actuator_lag", {"shoulder"}, {{"time_constant", 0.01}})}});
  const auto wrist = [](std::vector<std::string> joints, double ratio) {
    EffectSpec spec =
        MakeSpec("joint_coupling", std::move(joints),
                 {{"coefficient", ratio}, {"viscous", 0.4}, {"coulomb", 0.2}, {"armature", 0.1}});
    spec.options["form"] = "kinematic";
    return spec;
  };
  cases.push_back(
      {"kinematic_coupling",
       "arm2",
       {wrist({"shoulder", "elbow"}, 0.6), MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.2}}),
        MakeSpec("joint_elasticity", {"shoulder"}, {{"stiffness", 2000}, {"motor_inertia", 0.2}})}});
  // The motor's own joint before the other one.
  cases.push_back(
      {"kinematic_coupling_mico2",
       "mico2",
       {wrist({"joint_6", "joint_5"}, -0.7), MakeSpec("viscous_friction", all, {{"viscous", 0.2}}),
        MakeSpec("actuator_delay", all, {{"delay", 0.004}})},
       5e-6});
  // Eight moving bodies and the drive: the kernels of larger robots.
  cases.push_back({"kinematic_coupling_on_a_soft_base",
                   "mico2",
                   {wrist({"joint_5", "joint_6"}, 1.0), MakeSpec("viscous_friction", all, {{"viscous", 0.2}}),
                    MakeSpec("base_flexibility", {}, {{"stiffness", 3000}, {"damping", 10}})},
                   5e-6});
  std::map<std::string, double> surface = {
      {"low", -1.0}, {"high", 2.0}, {"other_low", -1.5}, {"other_high", 1.5}};
  for (int i = 0; i < 36; ++i)
    surface["w" + std::to_string(i / 6) + std::to_string(i % 6)] = 0.5 * std::sin(1.7 * i);
  cases.push_back({"unknown_field_pair",
                   "arm2",
                   {MakeSpec("unknown_field_pair", {"shoulder", "elbow"}, surface),
                    MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.3}})}});
  EffectSpec motor_side =
      MakeSpec("joint_elasticity", {"elbow"}, {{"stiffness", 500}, {"motor_inertia", 0.1}});
  motor_side.options["sensor"] = "motor";
  cases.push_back(
      {"motor_encoder", "arm2", {motor_side, MakeSpec("sensor_delay", {"elbow"}, {{"delay", 0.0032}})}});
  cases.push_back({"everything_mico2",
                   "mico2",
                   {MakeSpec("viscous_friction", all, {{"viscous", 0.2}}),
                    MakeSpec("coulomb_friction", all, {{"coulomb", 0.1}}),
                    MakeSpec("rotor_inertia", all, {{"armature", 0.05}}),
                    MakeSpec("actuator_lag", all, {{"time_constant", 0.01}}),
                    MakeSpec("actuator_delay", all, {{"delay", 0.004}}),
                    MakeSpec("joint_elasticity", all, {{"stiffness", 1e3}}),
                    MakeSpec("payload", {}, {{"mass", 0.3}, {"com_z", -0.1}})},
                   5e-6});
  return cases;
}

INSTANTIATE_TEST_SUITE_P(Catalogue, GradientTest, ::testing::ValuesIn(Cases()),
                         [](const auto& info) { return info.param.name; });

using IntegratorAndForm = std::tuple<Integrator, const char*>;
class IntegratorGradientTest : public ::testing::TestWithParam<IntegratorAndForm> {};

TEST_P(IntegratorGradientTest, MatchesCentralDifferences) {
  const std::vector<std::string> joints = {"shoulder", "elbow"};
  const auto [integrator, form] = GetParam();
  EffectSpec coupling = MakeSpec("joint_coupling", joints, {{"coefficient", 0.2}});
  coupling.options["form"] = form;
  if (form == std::string("kinematic"))
    coupling.values["*"] = {{"coefficient", 0.4}, {"viscous", 0.5}, {"coulomb", 0.2}, {"armature", 0.15}};
  const Plant plant = rg::testing::MakePlant(
      "arm2", {MakeSpec("viscous_friction", joints, {{"viscous", 0.8}}),
               MakeSpec("coulomb_friction", joints, {{"coulomb", 0.3}}),
               MakeSpec("rotor_inertia", joints, {{"armature", 0.1}}),
               MakeSpec("position_spring", joints, {{"stiffness", 4}}), coupling,
               MakeSpec("external_disturbance", {},
                        {{"start", -1}, {"end", 1}, {"force_x", 3.0}, {"force_z", -2.0}})});
  SimulatorOptions options;
  options.integrator = integrator;
  options.step_s = 4e-3;
  Simulator simulator(plant, options);
  const CommandSignal command = Commands(2, 3.0, Hold::kZeroOrder);
  const State x0 = simulator.MakeState(StartPosition(plant), StartVelocity(plant));
  SensitivityRequest request{true, {}};
  for (int i = 0; i < plant.parameters().size(); ++i) {
    if (plant.parameters()[i].unit != "s") request.parameters.push_back(i);
  }
  const Trajectory out = simulator.Simulate(x0, command, {0.02}, request);
  ASSERT_TRUE(out.outcome.ok()) << out.outcome.ToString();
  const auto count = static_cast<Eigen::Index>(request.parameters.size());
  Eigen::VectorXd scale(4 + count);
  scale.head(4).setConstant(kStateScale);
  for (int i = 0; i < count; ++i) scale[4 + i] = Scale(plant.parameters()[request.parameters[i]]);
  auto run = [&](const Eigen::VectorXd& at) {
    Eigen::VectorXd p = plant.parameters().Nominal();
    for (int i = 0; i < count; ++i) p[request.parameters[i]] += scale[4 + i] * at[4 + i];
    simulator.SetParameters(p);
    const State x = FromStacked(x0, x0.Stacked() + kStateScale * at.head(4));
    return Eigen::VectorXd(simulator.Simulate(x, command, {0.02}).state.col(0));
  };
  const auto check = math::CheckGradient(run, Eigen::VectorXd::Zero(scale.size()),
                                         out.dfinal_state * scale.asDiagonal(), Options(1e-6));
  EXPECT_TRUE(check.ok) << check.message;
}

INSTANTIATE_TEST_SUITE_P(All, IntegratorGradientTest,
                         ::testing::Combine(::testing::Values(Integrator::kSemiImplicitEuler,
                                                              Integrator::kLeapfrog, Integrator::kRk4),
                                            ::testing::Values("torque", "kinematic")));

TEST(GradientCases, CoverEveryEffectOfTheCatalogue) {
  for (const auto& info : effects::Catalog()) {
    bool found = false;
    for (const Case& c : Cases()) {
      for (const auto& spec : c.effects) found |= spec.id == info.id;
    }
    EXPECT_TRUE(found) << info.id;
  }
}

}  // namespace
}  // namespace rg::sim
