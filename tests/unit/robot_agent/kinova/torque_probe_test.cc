#include "robot_agent/drivers/kinova/torque_probe.h"

#include <gtest/gtest.h>

#include <cmath>

namespace rg::robot_agent::kinova {
namespace {

// A joint with a dead band and friction that sinks at `drift` rad/s by itself, seen at 25 Hz.
struct ProbedJoint {
  double dead_band = 0.3, friction = 0.2, viscous = 3.0, sign = 1.0, drift = 0.0;
  double q = 1.0;
  void Step(double torque, double dt) {
    const double beyond = std::max(0.0, std::abs(torque) - dead_band - friction);
    q += dt * (drift + sign * std::copysign(beyond, torque) / viscous);
  }
};

ProbeEnd RunProbe(ProbedJoint joint, TorqueProbe& probe, double* furthest = nullptr) {
  const double start = joint.q;
  for (int k = 0; k < 200; ++k) {
    const ProbeEnd end = probe.Step(0.04 * k, joint.q);
    if (furthest != nullptr) *furthest = std::max(*furthest, std::abs(joint.q - start));
    if (end != ProbeEnd::kGoingOn) return end;
    joint.Step(probe.torque(), 0.04);
  }
  return ProbeEnd::kGoingOn;
}

TEST(TorqueProbe, PassesDeadBandAndFrictionAndStopsAtTheMotion) {
  TorqueProbe probe({.most_nm = 2.0});
  double furthest = 0.0;
  EXPECT_EQ(RunProbe({}, probe, &furthest), ProbeEnd::kMoved);
  EXPECT_GT(probe.reached_nm(), 0.5);
  EXPECT_LT(probe.reached_nm(), 1.2);
  EXPECT_LT(furthest, 0.04);
  EXPECT_EQ(probe.torque(), 0.0);
}

TEST(TorqueProbe, NeverSendsMoreThanTheMostAndSaysHowMuchItWas) {
  TorqueProbe probe({.most_nm = 1.0});
  EXPECT_EQ(RunProbe({.dead_band = 5.0}, probe), ProbeEnd::kSilent);
  EXPECT_DOUBLE_EQ(probe.reached_nm(), 1.0);
}

TEST(TorqueProbe, FindsAWrongSign) {
  TorqueProbe probe({.most_nm = 2.0});
  EXPECT_EQ(RunProbe({.sign = -1.0}, probe), ProbeEnd::kWrongSign);
  EXPECT_LT(probe.moved_rad(), -0.019);
}

TEST(TorqueProbe, DriftIsNeitherAnAnswerNorAWrongSign) {
  TorqueProbe silent({.most_nm = 1.0});
  EXPECT_EQ(RunProbe({.dead_band = 5.0, .drift = 0.05}, silent), ProbeEnd::kSilent);
  TorqueProbe against({.most_nm = 2.0});
  EXPECT_EQ(RunProbe({.drift = -0.05}, against), ProbeEnd::kMoved);
  TorqueProbe fast({.most_nm = 2.0});
  EXPECT_EQ(RunProbe({.drift = 0.5}, fast), ProbeEnd::kDrifts);
  EXPECT_EQ(fast.reached_nm(), 0.0);
}

}  // namespace
}  // namespace rg::robot_agent::kinova
