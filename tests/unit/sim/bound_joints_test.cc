// Joints that are not free: those that move as they are told, and those that follow others.
#include "common/integrators/bound_joints.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/math/gradient_check.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/followers.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::MakeSpec;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using rg::testing::Bind;
using rg::testing::Binding;
using rg::testing::LoadRobot;
using rg::testing::MakePlant;
using ::testing::HasSubstr;

CommandSignal Sines(int n, double amplitude) {
  std::vector<double> times;
  MatrixXd u(n, 60);
  for (int k = 0; k < 60; ++k) {
    times.push_back(0.01 * k);
    for (int i = 0; i < n; ++i) u(i, k) = amplitude / (1 + i) * std::sin(0.3 * k + i);
  }
  return CommandSignal::Create(times, u, Hold::kLinear).value();
}

// Joint j swings: q = 0.4 sin(5 t + j).
std::shared_ptr<const GivenMotion> Swing(const std::vector<int>& joints) {
  std::vector<double> times;
  for (int k = 0; k <= 80; ++k) times.push_back(-0.1 + 0.01 * k);
  const auto m = static_cast<long>(joints.size());
  MatrixXd q(m, 81), v(m, 81), a(m, 81);
  for (int k = 0; k <= 80; ++k) {
    for (long i = 0; i < m; ++i) {
      const double phase = 5 * times[k] + joints[i];
      q(i, k) = 0.4 * std::sin(phase), v(i, k) = 2 * std::cos(phase), a(i, k) = -10 * std::sin(phase);
    }
  }
  return std::make_shared<const GivenMotion>(GivenMotion::Create(joints, times, q, v, a).value());
}

Plant WithPrescribed(const std::string& robot, const std::vector<int>& joints,
                     std::vector<effects::EffectSpec> effects = {}) {
  PlantOptions options;
  const auto model = LoadRobot(robot);
  for (const int j : joints) options.prescribed.push_back(model->joint(j).name);
  return MakePlant(robot, std::move(effects), options);
}

SensitivityRequest Everything(const Plant& plant) {
  SensitivityRequest request{.initial_state = true, .parameters = {}};
  for (int i = 0; i < plant.parameters().size(); ++i) request.parameters.push_back(i);
  return request;
}

std::vector<double> Grid(double step, int count) {
  std::vector<double> times;
  for (int k = 0; k <= count; ++k) times.push_back(step * k);
  return times;
}

VectorXd Outputs(const Trajectory& out) {
  VectorXd y(out.position.size() + out.velocity.size() + out.state.rows());
  y << out.position.reshaped(), out.velocity.reshaped(), out.state.col(out.state.cols() - 1);
  return y;
}

// Every sensitivity of a short run against central differences, steps small against what is small.
math::GradientCheckResult CheckSensitivities(Simulator& simulator, const State& x0,
                                             const CommandSignal& command, const Trajectory& out,
                                             const std::vector<double>& times) {
  const Plant& plant = simulator.plant();
  MatrixXd jacobian(2 * out.dposition.rows() + out.dfinal_state.rows(), out.dposition.cols());
  jacobian << out.dposition, out.dvelocity, out.dfinal_state;
  const long nx = plant.num_states(), n = plant.num_joints();
  const VectorXd p0 = plant.parameters().Nominal();
  VectorXd base(nx + p0.size()), scale = VectorXd::Constant(nx + p0.size(), 0.02);
  base << x0.Stacked(), p0;
  for (int i = 0; i < p0.size(); ++i) {
    const Parameter& row = plant.parameters()[i];
    const bool small = row.kind == ParameterKind::kInertia || row.unit == "s" || row.field == "motor_inertia";
    if (small) scale[nx + i] = 1e-3;
  }
  const auto run = [&](const VectorXd& at) {
    const VectorXd input = base + scale.cwiseProduct(at);
    simulator.SetParameters(input.tail(p0.size()));
    State x = x0;
    x.q = input.head(n), x.v = input.segment(n, n), x.z = input.segment(2 * n, nx - 2 * n);
    return Outputs(simulator.Simulate(x, command, times));
  };
  math::GradientCheckOptions options;
  options.scale_floor = 1e-3;
  return math::CheckGradient(run, VectorXd::Zero(base.size()), jacobian * scale.asDiagonal(), options);
}

TEST(PrescribedJoint, IsWhereItIsToldToBeAtEveryOutput) {
  const Plant plant = WithPrescribed("mico2", {1, 4});
  const auto motion = Swing({1, 4});
  Simulator simulator(plant, {.step_s = 2e-3});
  const VectorXd zero = VectorXd::Zero(6);
  const Trajectory out =
      simulator.Simulate(simulator.MakeState(zero, zero), Sines(6, 2).WithMotion(motion), Grid(0.0073, 40));
  ASSERT_TRUE(out.outcome.ok()) << out.outcome.ToString();
  for (size_t k = 0; k < out.times.size(); ++k) {
    for (int i = 0; i < 2; ++i) {
      const GivenMotion::Point told = motion->At(i, out.times[k]);
      EXPECT_NEAR(out.position(motion->joints()[i], k), told.q, 1e-12);
      EXPECT_NEAR(out.velocity(motion->joints()[i], k), told.v, 1e-12);
    }
  }
}

// A robot driven by torques, and the same robot that is told what one of its joints then did: what moves it
// does not matter to the others.
TEST(PrescribedJoint, ActsOnTheOthersAsIfATorqueHadMovedIt) {
  const Plant driven =
      MakePlant("mico2", {MakeSpec("viscous_friction", {"joint_1", "joint_3"}, {{"viscous", 0.4}})});
  const CommandSignal command = Sines(6, 4);
  Simulator simulator(driven, {.step_s = 1e-4});
  VectorXd q0(6), a(6), u(6);
  q0 << 0.3, 2.5, 1.9, 0.2, -0.4, 0.1;
  const State x0 = simulator.MakeState(q0, VectorXd::Zero(6));
  const std::vector<double> knots = Grid(1e-3, 400);
  const Trajectory truth = simulator.Simulate(x0, command, knots);
  ASSERT_TRUE(truth.outcome.ok());
  MatrixXd q(1, 401), v(1, 401), acceleration(1, 401);
  for (int k = 0; k <= 400; ++k) {
    for (int i = 0; i < 6; ++i) u[i] = command.At(i, knots[k]);
    ASSERT_TRUE(
        simulator.Acceleration(simulator.MakeState(truth.position.col(k), truth.velocity.col(k)), u, &a));
    q(0, k) = truth.position(1, k), v(0, k) = truth.velocity(1, k), acceleration(0, k) = a[1];
  }
  const auto motion =
      std::make_shared<const GivenMotion>(GivenMotion::Create({1}, knots, q, v, acceleration).value());
  PlantOptions options;
  options.prescribed = {"joint_2"};
  const Plant plant = MakePlant("mico2", driven.effects(), options);
  const auto error = [&](const Plant& of, double step) {
    Simulator other(of, {.step_s = step});
    const Trajectory out = other.Simulate(x0, command.WithMotion(motion), knots);
    EXPECT_TRUE(out.outcome.ok()) << out.outcome.ToString();
    return (out.position - truth.position).cwiseAbs().maxCoeff();
  };
  EXPECT_GT((truth.position.row(2).array() - q0[2]).abs().maxCoeff(), 0.1) << "it moves";
  EXPECT_LT(error(plant, 1e-4), 1e-4);
  // Of second order in the step, and no worse than where the torque is simulated.
  EXPECT_LT(error(plant, 5e-4), 0.3 * error(plant, 1e-3));
  EXPECT_LT(error(plant, 1e-3), 2 * error(driven, 1e-3));
}

// Over a short step the others' acceleration is that of their own equations with the told joint's in them:
// M_oo·a_o = u_o − c_o − M_oj·a_j.
TEST(PrescribedJoint, ReactsByTheOthersRowsOfTheEquationsOfMotion) {
  const Plant plant = WithPrescribed("arm2", {0});
  const auto motion = Swing({0});
  const dynamics::Mechanism mechanism(plant.model());
  dynamics::Workspace workspace;
  const double h = 1e-6, t = 0.13;
  VectorXd q(2), v(2), c(2);
  q << motion->At(0, t).q, 0.9;
  v << motion->At(0, t).v, -1.3;
  MatrixXd M(2, 2);
  dynamics::MassMatrixAndBias(mechanism, workspace, q, v, M, c);
  const double given = (motion->At(0, t + h).v - v[0]) / h, u = 0.7;
  const double damping =
      plant.parameters()[plant.parameters().Find("damping." + plant.joint_names()[1])].nominal;
  const double expected = (u - damping * v[1] - c[1] - M(1, 0) * given) / M(1, 1);
  Simulator simulator(plant, {.step_s = 1});
  const CommandSignal command =
      CommandSignal::Constant((VectorXd(2) << 100.0, u).finished()).WithMotion(motion);
  const Trajectory out = simulator.Simulate(simulator.MakeState(q, v, t), command, {t + h});
  ASSERT_TRUE(out.outcome.ok());
  EXPECT_GT(std::abs(M(1, 0) * given / M(1, 1)), 1.0) << "a reaction that matters";
  EXPECT_NEAR((out.velocity(1, 0) - v[1]) / h, expected, 1e-3 * (1 + std::abs(expected)));
}

struct GradientCase {
  std::string name;
  Integrator integrator;
  std::vector<effects::EffectSpec> effects;
};

TEST(PrescribedJoint, SensitivitiesMatchCentralDifferences) {
  const std::vector<GradientCase> cases = {
      {"leapfrog", Integrator::kLeapfrog, {}},
      {"euler", Integrator::kSemiImplicitEuler, {}},
      {"friction",
       Integrator::kLeapfrog,
       {MakeSpec("coulomb_friction", {"joint_1"}, {{"coulomb", 0.4}}),
        MakeSpec("actuator_lag", {"joint_3"}, {{"time_constant", 0.03}}),
        MakeSpec("payload", {}, {{"mass", 0.5}, {"com_z", 0.05}}), MakeSpec("gravity_misalignment", {}, {})}},
      {"elastic", Integrator::kLeapfrog, {MakeSpec("joint_elasticity", {"joint_3"}, {{"stiffness", 90.0}})}},
  };
  for (const GradientCase& c : cases) {
    const Plant plant = WithPrescribed("mico2", {1, 4}, c.effects);
    Simulator simulator(plant, {.integrator = c.integrator});
    const CommandSignal command = Sines(6, 2).WithMotion(Swing({1, 4}));
    VectorXd q(6), v(6);
    q << 0.3, 0, 1.9, 0.2, 0, 0.1;
    v << 1.0, 0, 1.2, -0.9, 0, 1.1;
    const State x0 = simulator.MakeState(q, v);
    const std::vector<double> times = {0.0, 0.004, 0.011};
    const SensitivityRequest request = Everything(plant);
    const Trajectory out = simulator.Simulate(x0, command, times, request);
    ASSERT_TRUE(out.outcome.ok()) << c.name << out.outcome.ToString();
    const auto check = CheckSensitivities(simulator, x0, command, out, times);
    EXPECT_TRUE(check) << c.name << ": " << check.message;
    for (const int j : {1, 4}) {
      EXPECT_EQ(out.dposition.col(j).cwiseAbs().maxCoeff(), 0.0) << c.name << " its start is not free";
      EXPECT_EQ(out.dposition.row(12 + j).cwiseAbs().maxCoeff(), 0.0) << c.name << " nothing moves it";
    }
  }
}

TEST(PrescribedJoint, IsTheSameInLanesAsAlone) {
  const Plant plant =
      WithPrescribed("mico2", {1, 4}, {MakeSpec("coulomb_friction", {"joint_1"}, {{"coulomb", 0.3}})});
  Simulator simulator(plant);
  const CommandSignal command = Sines(6, 3).WithMotion(Swing({1, 4}));
  std::vector<std::vector<double>> times;
  std::vector<SimulationWindow> runs;
  for (int w = 0; w < 9; ++w) {
    times.push_back({});
    for (int k = 0; k < 3 + w; ++k) times.back().push_back(0.05 * w + 0.0062 * k);
  }
  for (int w = 0; w < 9; ++w) {
    VectorXd q = VectorXd::Constant(6, 0.2 + 0.1 * w), v = VectorXd::Constant(6, 0.4 - 0.1 * w);
    runs.push_back({simulator.MakeState(q, v, times[w][0]), &command, &times[w]});
  }
  std::vector<Trajectory> lanes;
  simulator.SimulateWindows(runs, Everything(plant), &lanes);
  for (int w = 0; w < 9; ++w) {
    const Trajectory alone = simulator.Simulate(runs[w].x0, command, times[w], Everything(plant));
    ASSERT_TRUE(alone.outcome.ok() && lanes[w].outcome.ok());
    EXPECT_LT((lanes[w].state - alone.state).cwiseAbs().maxCoeff(), 1e-10);
    EXPECT_LT((lanes[w].dposition - alone.dposition).cwiseAbs().maxCoeff(), 1e-8);
  }
}

TEST(PrescribedJoint, OfAHeldCommandGoesEvenlyToTheVelocityThatItIsTold) {
  const Plant plant = WithPrescribed("arm2", {0});
  Simulator simulator(plant, {.step_s = 1e-3});
  State x = simulator.MakeState((VectorXd(2) << 0.1, 0.2).finished(), (VectorXd(2) << 0.5, 0.0).finished());
  Linearization lin;
  ASSERT_TRUE(simulator.Advance(x, (VectorXd(2) << 0.9, 0.1).finished(), 0.01, &lin).ok());
  EXPECT_NEAR(x.v[0], 0.9, 1e-12);
  EXPECT_NEAR(x.q[0], 0.1 + 0.01 * 0.7, 1e-12);
  for (const int row : {0, 2}) {
    EXPECT_EQ(lin.A.row(row).cwiseAbs().maxCoeff(), 0.0);
    EXPECT_EQ(lin.A.col(row).cwiseAbs().maxCoeff(), 0.0);
  }
  EXPECT_GT(lin.B.row(3).cwiseAbs().maxCoeff(), 0.0);
}

TEST(PrescribedJoint, TakesNoEffectsAndAPassiveOneNoneOfADrive) {
  PlantOptions options;
  options.prescribed = {"joint_2"}, options.passive = {"joint_4"};
  const auto refusal = [&](const effects::EffectSpec& spec) {
    const auto plant = Plant::Create(LoadRobot("mico2"), options, {spec});
    return plant.ok() ? std::string() : plant.status().message();
  };
  EXPECT_THAT(refusal(MakeSpec("viscous_friction", {"joint_2"})), HasSubstr("joint_2 moves as it is told"));
  EXPECT_THAT(refusal(MakeSpec("encoder_offset", {"joint_2"})), HasSubstr("joint_2 moves as it is told"));
  EXPECT_THAT(refusal(MakeSpec("joint_coupling", {"joint_1", "joint_2"})), HasSubstr("joint_2"));
  for (const char* id : {"torque_gain", "actuator_delay", "joint_elasticity", "backlash", "rotor_inertia",
                         "load_dependent_friction", "torque_saturation"})
    EXPECT_THAT(refusal(MakeSpec(id, {"joint_4"})), HasSubstr("joint_4 has no drive (passive)")) << id;
  for (const char* id : {"viscous_friction", "coulomb_friction", "encoder_offset", "position_spring"})
    EXPECT_EQ(refusal(MakeSpec(id, {"joint_4"})), "") << id;
  EXPECT_EQ(refusal(MakeSpec("torque_gain", {"joint_1"})), "");
  for (const auto& [joints, why] : {std::pair<std::vector<std::string>, const char*>{
                                        {"joint_1", "joint_2"}, "joint_2 moves as it is told"},
                                    {{"joint_5", "joint_4"}, "joint_4 has no drive (passive)"}}) {
    auto wrist = MakeSpec("joint_coupling", joints, {{"coulomb", 1.0}});
    wrist.options["form"] = "kinematic";
    EXPECT_THAT(refusal(wrist), HasSubstr(why));
  }
  EXPECT_EQ(refusal(MakeSpec("unknown_field_pair", {"joint_2", "joint_1"})), "") << "it is only looked at";
  const Plant plant = Plant::Create(LoadRobot("mico2"), options).value();
  EXPECT_TRUE(plant.IsPrescribed(1) && plant.IsPassive(3) && !plant.IsPassive(1));
  EXPECT_FALSE(plant.Takes("viscous_friction", 1));
  EXPECT_TRUE(plant.Takes("viscous_friction", 3));
  EXPECT_FALSE(plant.Takes("torque_gain", 3));
  options.prescribed = {"elbow"};
  EXPECT_THAT(refusal(MakeSpec("payload")), HasSubstr("prescribed: the model has no moving joint elbow"));
  EXPECT_FALSE(Simulator::Supports(WithPrescribed("arm2", {0}), {.integrator = Integrator::kRk4}).ok());
}

// A Mico of which two joints follow joint_2, one of them with the rest of the arm on it.
struct Gripper {
  std::shared_ptr<const model::RobotModel> free = LoadRobot("mico2");
  std::map<int, Binding> bindings = {{2, {1, -0.8, 0.5}}, {4, {1, 1.3, -0.2}}};
  std::shared_ptr<const model::RobotModel> bound = Bind(*free, bindings);
  Plant MakeBound(std::vector<effects::EffectSpec> effects = {}, const PlantOptions& options = {}) const {
    auto plant = Plant::Create(bound, options, std::move(effects));
    RG_CHECK(plant.ok()) << plant.status().ToString();
    return *plant;
  }
};

// Runge-Kutta on Gᵀ M G a = u − Gᵀ c − d v of the free robot.
MatrixXd Reference(const Gripper& g, const CommandSignal& command, VectorXd q, VectorXd v, double end,
                   int steps) {
  const auto [G, g0] = rg::testing::UnboundOf(*g.free, g.bindings);
  const dynamics::Mechanism all(*g.free);
  dynamics::Workspace w;
  MatrixXd M(6, 6);
  VectorXd c(6), damping(6);
  for (int j = 0; j < 6; ++j) damping[j] = g.free->joint(j).damping;
  const auto acceleration = [&, G = G, g0 = g0](double t, const VectorXd& x,
                                                const VectorXd& rate) -> VectorXd {
    dynamics::MassMatrixAndBias(all, w, G * x + g0, G * rate, M, c);
    VectorXd u(4);
    for (int j = 0; j < 4; ++j) u[j] = command.At(j, t);
    const MatrixXd folded = G.transpose() * M * G;
    return folded.llt().solve(u - G.transpose() * (c + damping.cwiseProduct(G * rate)));
  };
  const double h = end / steps;
  for (int k = 0; k < steps; ++k) {
    const double t = h * k;
    const VectorXd k1 = acceleration(t, q, v), k2 = acceleration(t + h / 2, q + h / 2 * v, v + h / 2 * k1);
    const VectorXd k3 = acceleration(t + h / 2, q + h / 2 * v + h * h / 4 * k1, v + h / 2 * k2);
    const VectorXd k4 = acceleration(t + h, q + h * v + h * h / 2 * k2, v + h * k3);
    q += h * v + h * h / 6 * (k1 + k2 + k3);
    v += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
  }
  MatrixXd out(4, 2);
  out << q, v;
  return out;
}

TEST(FollowingJoint, MovesWithItsDriverByTheEquationsOfBoth) {
  const Gripper g;
  const Plant plant = g.MakeBound();
  ASSERT_EQ(plant.num_joints(), 4);
  EXPECT_EQ(plant.num_states(), 8);
  const CommandSignal command = Sines(4, 4);
  VectorXd q(4), v(4);
  q << 0.3, 2.5, 0.2, 0.1;
  v << 0.5, -0.4, 0.8, -0.2;
  const MatrixXd truth = Reference(g, command, q, v, 0.4, 4000);
  for (const Integrator integrator :
       {Integrator::kLeapfrog, Integrator::kSemiImplicitEuler, Integrator::kRk4}) {
    Simulator simulator(plant, {.integrator = integrator, .step_s = 2e-4});
    const Trajectory out = simulator.Simulate(simulator.MakeState(q, v), command, {0.4});
    ASSERT_TRUE(out.outcome.ok()) << out.outcome.ToString();
    const double tolerance = integrator == Integrator::kSemiImplicitEuler ? 1e-2 : 1e-4;
    EXPECT_LT((out.position.col(0) - truth.col(0)).norm(), tolerance);
    EXPECT_LT((out.velocity.col(0) - truth.col(1)).norm(), 20 * tolerance);
  }
}

TEST(FollowingJoint, SensitivitiesMatchCentralDifferences) {
  const Gripper g;
  const std::vector<GradientCase> cases = {
      {"leapfrog", Integrator::kLeapfrog, {}},
      {"euler", Integrator::kSemiImplicitEuler, {}},
      {"rk4", Integrator::kRk4, {}},
      {"effects",
       Integrator::kLeapfrog,
       {MakeSpec("coulomb_friction", {"joint_2"}, {{"coulomb", 0.4}}),
        MakeSpec("rotor_inertia", {"joint_2"}, {{"armature", 0.05}}),
        MakeSpec("payload", {}, {{"mass", 0.5}, {"com_z", 0.05}}), MakeSpec("gravity_misalignment"),
        MakeSpec("contact", {}, {{"height", -5.0}}),
        MakeSpec("external_disturbance", {}, {{"force_x", 2.0}, {"start", -1.0}, {"end", 9.0}})}},
      {"mount", Integrator::kLeapfrog, {MakeSpec("base_flexibility"), MakeSpec("sloshing_payload")}},
      {"told", Integrator::kLeapfrog, {}},
  };
  for (const GradientCase& c : cases) {
    PlantOptions told;
    if (c.name == "told") told.prescribed = {"joint_2"};
    const Plant plant = g.MakeBound(c.effects, told);
    Simulator simulator(plant, {.integrator = c.integrator});
    CommandSignal command = Sines(4, 2);
    if (c.name == "told") command = command.WithMotion(Swing({1}));
    VectorXd q(4), v(4);
    q << 0.3, 2.5, 0.2, 0.1;
    v << 1.0, -1.2, 0.9, 1.1;
    const State x0 = simulator.MakeState(q, v);
    const std::vector<double> times = {0.0, 0.004, 0.011};
    const SensitivityRequest request = Everything(plant);
    const Trajectory out = simulator.Simulate(x0, command, times, request);
    ASSERT_TRUE(out.outcome.ok()) << c.name << out.outcome.ToString();
    const auto check = CheckSensitivities(simulator, x0, command, out, times);
    EXPECT_TRUE(check) << c.name << ": " << check.message;
  }
}

// A mass on the tool, a mount under the base: bodies before and behind those that follow.
TEST(FollowingJoint, StandsBesideBodiesThatEffectsAdd) {
  const Gripper g;
  const std::vector<effects::EffectSpec> extra = {
      MakeSpec("base_flexibility", {}, {{"stiffness", 1e7}, {"damping", 3e3}}),
      MakeSpec("sloshing_payload", {}, {{"mass", 0.3}, {"stiffness", 1e5}, {"damping", 300.0}})};
  const model::RobotModel& robot = *g.bound;
  const model::Link& last = robot.link(robot.joint(3).child_link);
  const Eigen::Vector3d com = (last.X_BL.Inverse() * robot.end_effector().X_BL).translation;
  ASSERT_EQ(last.body, robot.end_effector().body);
  const Plant stiff = g.MakeBound(extra),
              rigid = g.MakeBound({MakeSpec(
                  "payload", {}, {{"mass", 0.3}, {"com_x", com[0]}, {"com_y", com[1]}, {"com_z", com[2]}})});
  VectorXd q(4), v = VectorXd::Zero(4);
  q << 0.3, 2.5, 0.2, 0.1;
  const CommandSignal command = Sines(4, 2);
  Simulator a(stiff), b(rigid);
  const Trajectory moved = a.Simulate(a.MakeState(q, v), command, {0.3});
  const Trajectory expected = b.Simulate(b.MakeState(q, v), command, {0.3});
  ASSERT_TRUE(moved.outcome.ok() && expected.outcome.ok()) << moved.outcome.ToString();
  EXPECT_LT((moved.position - expected.position).norm(), 5e-3);
}

}  // namespace
}  // namespace rg::sim
