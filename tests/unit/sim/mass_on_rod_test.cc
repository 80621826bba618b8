// A mass that swings on a rod at the last link (sloshing_payload, form "rod"), against closed forms and
// equations of motion written down by hand.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <functional>

#include "common/dynamics/dynamics.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;
using rg::testing::MakePlant;

constexpr double kGravity = 9.81;
const char* const kHinges[] = {"x", "y", "z"};

EffectSpec Rod(std::map<std::string, double> values, const std::string& hinge) {
  EffectSpec spec = MakeSpec("sloshing_payload", {}, std::move(values));
  spec.options = {{"form", "rod"}, {"hinge", hinge}};
  return spec;
}

// The pendulum robot, held by its hinge's friction, with a rod at its tip, whose axes are W's at q = 0.
Plant HeldPendulum(std::map<std::string, double> values, const std::string& hinge) {
  return MakePlant("pendulum", {Rod(std::move(values), hinge),
                                MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", 1e3}})});
}

// Direction of the rod in the link's axes at the hinge's angles, composed as two turns.
Eigen::Vector3d Along(int hinge, double first, double second) {
  const Eigen::Vector3d a = Eigen::Vector3d::Unit(hinge), b = Eigen::Vector3d::Unit((hinge + 1) % 3);
  return Eigen::AngleAxisd(first, a) *
         (Eigen::AngleAxisd(second, b) * -Eigen::Vector3d::Unit((hinge + 2) % 3));
}

TEST(MassOnRod, SwingsWithThePeriodOfAPendulum) {
  for (int hinge = 0; hinge < 2; ++hinge) {  // about z it would hang along its axis
    const double length = 0.2, radius = 0.1, amplitude = 0.02;
    Simulator simulator(HeldPendulum({{"mass", 0.3}, {"length", length}, {"radius", radius}, {"damping", 0}},
                                     kHinges[hinge]));
    State x = simulator.MakeState(Eigen::VectorXd::Zero(1), Eigen::VectorXd::Zero(1));
    const double rest = x.z[0];
    x.z[0] += amplitude;
    // The rod passes the vertical at a quarter of a period, and again half a period later.
    double passed = 0, last = x.z[0] - rest;
    int times = 0;
    for (int k = 1; times < 2 && k < 5000; ++k) {
      ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Zero(1), 1e-3).ok());
      const double now = x.z[0] - rest;
      if (last * now <= 0) {
        const double at = 1e-3 * (k - now / (now - last));
        if (++times == 2) passed = at - passed;
        if (times == 1) passed = at;
      }
      last = now;
    }
    const double period = 2 * M_PI * std::sqrt((length * length + radius * radius) / (kGravity * length));
    EXPECT_NEAR(2 * passed, period * (1 + amplitude * amplitude / 16), 1e-5 * period) << kHinges[hinge];
  }
}

TEST(MassOnRod, KeepsItsEnergyOnAHeldLinkAndLosesItToDamping) {
  const double mass = 0.3, length = 0.25, radius = 0.06;
  const int hinge = 1;
  const auto energy = [&](const State& x) {
    const double first = x.z[0], first_rate = x.z[1], second = x.z[2], second_rate = x.z[3];
    const double across = std::cos(second);
    const double turn = first_rate * first_rate + second_rate * second_rate;  // about axes at right angles
    const double speed =
        length * length * (across * across * first_rate * first_rate + second_rate * second_rate);
    return 0.5 * mass * (speed + radius * radius * turn) +
           mass * kGravity * length * Along(hinge, first, second).z();
  };
  for (const double damping : {0.0, 0.3}) {
    Simulator simulator(HeldPendulum(
        {{"mass", mass}, {"length", length}, {"radius", radius}, {"damping", damping}}, kHinges[hinge]));
    State x = simulator.MakeState(Eigen::VectorXd::Zero(1), Eigen::VectorXd::Zero(1));
    x.z[0] += 1.9, x.z[1] = 2.0, x.z[3] = 1.5;  // far out, and out of one plane
    const double start = energy(x), size = mass * kGravity * length;
    double last = start, worst = 0;
    for (int k = 0; k < 4000; ++k) {
      ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Zero(1), 1e-3).ok());
      const double now = energy(x);
      worst = std::max(worst, std::abs(now - start));
      if (damping > 0) {
        EXPECT_LT(now, last + 1e-5 * size) << k;
      }
      last = now;
    }
    if (damping == 0) {
      EXPECT_LT(worst, 1e-4 * size);
    } else {
      EXPECT_LT(last, start - 0.5 * size);
    }
  }
}

// The robot's link and the rod are a double pendulum, whose equations stand in every textbook; here with q
// from the vertical and s = q + φ of the rod, both about y.
TEST(MassOnRod, IsADoublePendulumOnAFreeHinge) {
  const double mass = 0.25, length = 0.3, radius = 0.05;
  const double arm_mass = 0.6, com = 0.45, arm_inertia = 0.00209375 + arm_mass * com * com, tip = 0.5;
  Plant plant = MakePlant(
      "pendulum", {Rod({{"mass", mass}, {"length", length}, {"radius", radius}, {"damping", 0}}, "y")});
  Simulator simulator(plant);
  Eigen::VectorXd values = plant.parameters().Nominal();
  values[plant.parameters().Find("damping.hinge")] = 0.0;
  simulator.SetParameters(values);
  const double q0 = 0.9, v0 = -1.0;
  State x = simulator.MakeState(Eigen::VectorXd::Constant(1, q0), Eigen::VectorXd::Constant(1, v0));
  x.z[0] += 0.7, x.z[1] += 1.2;
  // About y, from hanging down, the rod's angle in W.
  const auto absolute = [&](const State& at) {
    const Eigen::Vector3d along =
        Eigen::AngleAxisd(at.q[0], Eigen::Vector3d::UnitY()) * Along(1, at.z[0], at.z[2]);
    return std::atan2(-along.x(), -along.z());
  };
  Eigen::Vector4d y(q0, absolute(x), v0, v0 + x.z[1]);
  const auto rate = [&](const Eigen::Vector4d& s) -> Eigen::Vector4d {
    const double d = s[0] - s[1], coupling = mass * tip * length;
    Eigen::Matrix2d M;
    M << arm_inertia + mass * tip * tip, coupling * std::cos(d), coupling * std::cos(d),
        mass * (length * length + radius * radius);
    const Eigen::Vector2d force(
        -coupling * std::sin(d) * s[3] * s[3] - (arm_mass * com + mass * tip) * kGravity * std::sin(s[0]),
        coupling * std::sin(d) * s[2] * s[2] - mass * length * kGravity * std::sin(s[1]));
    const Eigen::Vector2d a = M.inverse() * force;
    return {s[2], s[3], a[0], a[1]};
  };
  const double h = 1e-3;
  for (int k = 0; k < 1500; ++k) {
    ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Zero(1), h).ok());
    const Eigen::Vector4d k1 = rate(y), k2 = rate(y + 0.5 * h * k1), k3 = rate(y + 0.5 * h * k2),
                          k4 = rate(y + h * k3);
    y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
    ASSERT_NEAR(x.q[0], y[0], 2e-4) << k;
    ASSERT_NEAR(std::remainder(absolute(x) - y[1], 2 * M_PI), 0, 4e-4) << k;
  }
}

Eigen::VectorXd MicoPosition() {
  Eigen::VectorXd q(6);
  q << 0.4, 2.6, 1.9, 0.9, 0.7, 0.3;
  return q;
}
Eigen::VectorXd MicoSpeed() {
  Eigen::VectorXd v(6);
  v << 0.5, -0.4, 0.6, 0.8, -0.7, 0.9;
  return v;
}

TEST(MassOnRod, StartsWhereItHangsAndDoesNotTurnInTheWorld) {
  for (int hinge = 0; hinge < 3; ++hinge) {
    const Plant plant = MakePlant("mico2", {Rod({{"mass", 0.1}}, kHinges[hinge])});
    Simulator simulator(plant);
    const Eigen::VectorXd q = MicoPosition(), v = MicoSpeed();
    const State x = simulator.MakeState(q, v);
    dynamics::Mechanism mechanism(plant.model());
    dynamics::Workspace workspace;
    const auto tool = plant.model().FindFrame(plant.model().end_effector().name);
    const auto along = [&](double t) -> Eigen::Vector3d {
      const Eigen::VectorXd at = q + t * v;
      return dynamics::FramePose(mechanism, workspace, at, *tool).rotation *
             Along(hinge, x.z[0] + t * x.z[1], x.z[2] + t * x.z[3]);
    };
    EXPECT_LT((along(0) + Eigen::Vector3d::UnitZ()).norm(), 1e-9) << kHinges[hinge];
    EXPECT_LT((along(1e-4) - along(-1e-4)).norm() / 2e-4, 1e-6) << kHinges[hinge];
  }
}

// Where a point mass can be does not depend on which axes its hinge has, away from the first of them.
TEST(MassOnRod, MovesThePointMassAlikeByEitherHinge) {
  std::vector<Eigen::VectorXd> ends;
  for (const char* hinge : {"x", "y"}) {
    Simulator simulator(MakePlant("mico2", {Rod({{"mass", 0.2}, {"length", 0.15}, {"damping", 0}}, hinge)}));
    State x = simulator.MakeState(MicoPosition(), MicoSpeed());
    Eigen::VectorXd u = Eigen::VectorXd::Constant(6, 0.3);
    for (int k = 0; k < 1200; ++k) ASSERT_TRUE(simulator.Advance(x, u, 2.5e-4).ok());
    ends.push_back(x.q);
  }
  EXPECT_LT((ends[0] - ends[1]).cwiseAbs().maxCoeff(), 5e-5);
  EXPECT_GT((ends[0] - MicoPosition()).cwiseAbs().maxCoeff(), 0.05);
}

}  // namespace
}  // namespace rg::sim
