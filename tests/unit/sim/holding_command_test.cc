#include "common/sim/holding_command.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "common/base/check.h"
#include "common/effects/effect_catalog.h"
#include "common/model/urdf_loader.h"

namespace rg::sim {
namespace {

using Eigen::VectorXd;

Plant Robot(const std::string& name, std::vector<effects::EffectSpec> effects = {}) {
  const auto robot =
      model::LoadUrdf(std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/" + name, {});
  RG_CHECK(robot.ok()) << robot.status().ToString();
  return Plant::Create(std::make_shared<const model::RobotModel>(*robot), {}, std::move(effects)).value();
}

double FastestAfterInstant(Simulator& simulator, const VectorXd& q, const VectorXd& u) {
  State x = simulator.MakeState(q, VectorXd::Zero(q.size()), 0, &u);
  EXPECT_TRUE(simulator.Advance(x, u, 1e-3).ok());
  return x.v.cwiseAbs().maxCoeff();
}

TEST(HoldingCommand, IsTheTorqueOfGravity) {
  const Plant arm = Robot("arm2.urdf");
  Simulator simulator(arm);
  const VectorXd q = Eigen::Vector2d(0.3, -0.7);
  const VectorXd held = HoldingCommand(simulator, q, VectorXd::Constant(2, 2.0));
  EXPECT_LT(FastestAfterInstant(simulator, q, held), 1e-5);
  EXPECT_GT(FastestAfterInstant(simulator, q, VectorXd::Constant(2, 2.0)), 1e-2);
}

TEST(HoldingCommand, IsTheCommandItselfWhereFrictionHoldsIt) {
  const Plant stiff =
      Robot("pendulum.urdf", {effects::MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", 100.0}})});
  Simulator simulator(stiff);
  const VectorXd q = VectorXd::Constant(1, 0.4), u = VectorXd::Constant(1, 3.0);
  EXPECT_EQ(HoldingCommand(simulator, q, u), u);
}

TEST(HoldingCommand, IsNearestToTheCommandWithinWhatFrictionHolds) {
  const auto friction = effects::MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", 0.2}});
  const Plant free = Robot("pendulum.urdf"), sticking = Robot("pendulum.urdf", {friction});
  Simulator at(free), with(sticking);
  const VectorXd q = VectorXd::Constant(1, 0.4), u = VectorXd::Constant(1, 50.0);
  EXPECT_NEAR(HoldingCommand(with, q, u)[0], HoldingCommand(at, q, u)[0] + 0.2, 0.02);
}

TEST(HoldingCommand, IsFoundHoweverSharpFrictionIs) {
  const auto friction = effects::MakeSpec("coulomb_friction", {"shoulder", "elbow"}, {{"coulomb", 0.05}});
  const Plant arm = Robot("arm2.urdf", {friction});
  const VectorXd q = Eigen::Vector2d(0.3, -0.7), u = Eigen::Vector2d(9.0, -4.0);
  for (const double stick : {2e-3, 1e-4, 1e-6}) {
    SimulatorOptions options;
    options.stick_velocity = stick;
    Simulator simulator(arm, options);
    const VectorXd held = HoldingCommand(simulator, q, u);
    EXPECT_NE(held, u) << stick;
    EXPECT_LT(FastestAfterInstant(simulator, q, held), std::max(1e-5, stick)) << stick;
    EXPECT_GT(FastestAfterInstant(simulator, q, u), 10 * stick) << stick;
  }
}

TEST(HeldBefore, IsInForceUntilTheFirstCommand) {
  const auto command =
      CommandSignal::Create({1.0, 2.0}, Eigen::RowVector2d(5.0, 6.0), Hold::kZeroOrder).value();
  const CommandSignal with = HeldBefore(command, VectorXd::Constant(1, 3.0));
  EXPECT_EQ(with.At(0, 0.99), 3.0);
  EXPECT_EQ(with.At(0, 1.5), 5.0);
  EXPECT_NEAR(with.Average(0, 0.5, 1.5), 4.0, 1e-12);
  const auto linear = CommandSignal::Create({1.0, 2.0}, Eigen::RowVector2d(5.0, 6.0), Hold::kLinear).value();
  EXPECT_EQ(HeldBefore(linear, VectorXd::Constant(1, 3.0)).size(), 2);
}

// A lag of 0.1 s under a command that begins with a step: it comes in slowly where the robot was held, at
// once where the first command is taken to have been in force for long.
TEST(HeldBefore, ALagBeginsWhereItHeld) {
  const Plant late =
      Robot("pendulum.urdf", {effects::MakeSpec("actuator_lag", {"hinge"}, {{"time_constant", 0.1}})});
  Simulator simulator(late);
  const VectorXd q = VectorXd::Zero(1), v = q;
  const auto command = CommandSignal::Create({0.0}, VectorXd::Constant(1, 1.0), Hold::kZeroOrder).value();
  const State settled = simulator.MakeState(q, v, 0.0, command);
  const State held = simulator.MakeState(q, v, 0.0, HeldBefore(command, VectorXd::Zero(1)));
  EXPECT_NEAR(settled.z[0], 1.0, 1e-9);
  EXPECT_NEAR(held.z[0], 0.0, 1e-9);
}

}  // namespace
}  // namespace rg::sim
