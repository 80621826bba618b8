#include "services/trajectories/reference_tracking.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "common/sim/simulator.h"
#include "services/trajectories/motion_limits.h"
#include "tests/unit/trajectories/test_plants.h"

namespace rg::trajectories {
namespace {

using Eigen::VectorXd;

constexpr double kDuration = 4.0, kInterval = 0.04;

// From rest to rest.
MotionFn Swing(const VectorXd& from, double width) {
  return [=](double t, VectorXd* q, VectorXd* v, VectorXd* a) {
    const double w = 2 * M_PI / kDuration, s = t >= 0 && t <= kDuration ? 1.0 : 0.0;
    const VectorXd way = VectorXd::Constant(from.size(), width);
    *q = from + s * way * (1 - std::cos(w * t)) / 2;
    *v = s * way * w * std::sin(w * t) / 2;
    *a = s * way * w * w * std::cos(w * t) / 2;
  };
}

// The largest position error of `truth` under the plan made with `model`.
double Followed(const sim::Plant& truth, const sim::Plant& model, const MotionFn& motion,
                const VectorXd& start) {
  const auto plan = PlanTracking(model, model.parameters().Nominal(), motion, kDuration, kInterval,
                                 MotionLimits::FromModel(model.model()).torque);
  EXPECT_TRUE(plan.ok()) << plan.status().ToString();
  sim::Simulator simulator(truth);
  const Eigen::Index n = start.size();
  VectorXd q(n), v(n);
  const VectorXd hold = plan->effort.col(0);
  sim::State x = simulator.MakeState(start, VectorXd::Zero(n), 0.0, &hold);
  double worst = 0;
  for (int k = 0; k < plan->intervals(); ++k) {
    simulator.Measure(x, &q, &v);
    worst = std::max(worst, (plan->q.col(k) - q).cwiseAbs().maxCoeff());
    VectorXd error(2 * n);
    error << plan->q.col(k) - q, plan->v.col(k) - v;
    const VectorXd u = plan->effort.col(k) + plan->gain[static_cast<size_t>(k)] * error;
    EXPECT_TRUE(simulator.Advance(x, u, kInterval).ok());
  }
  return worst;
}

TEST(ReferenceTracking, FollowsWithItsOwnModelAndWithPhysicsItDoesNotKnow) {
  const VectorXd start = Eigen::Vector2d(0.3, 0.4);
  const MotionFn motion = Swing(start, 0.8);
  const sim::Plant plain = MakePlant("arm2");
  EXPECT_LT(Followed(plain, plain, motion, start), 0.01);
  const sim::Plant unknown =
      MakePlant("arm2", {effects::MakeSpec("viscous_friction", {"shoulder", "elbow"}, {{"viscous", 0.5}}),
                         effects::MakeSpec("actuator_lag", {"elbow"}, {{"time_constant", 0.01}})});
  EXPECT_LT(Followed(unknown, plain, motion, start), 0.1);
  EXPECT_LT(Followed(unknown, unknown, motion, start), 0.02) << "a model that knows them follows better";
}

TEST(ReferenceTracking, HoldsALightWristAt25Hz) {
  const sim::Plant mico = MakePlant("mico2");
  EXPECT_LT(Followed(mico, mico, Swing(Candle(), 0.3), Candle()), 0.01);
}

TEST(ReferenceTracking, TakesMotorsBehindSpringsAlongAndEncodersAtTheirWord) {
  const VectorXd start = Eigen::Vector2d(0.3, 0.4);
  const sim::Plant elastic =
      MakePlant("arm2", {effects::MakeSpec("joint_elasticity", {"elbow"},
                                           {{"stiffness", 2000}, {"damping", 5}, {"motor_inertia", 0.05}})});
  EXPECT_LT(Followed(elastic, elastic, Swing(start, 0.5), start), 0.02);
  const sim::Plant off =
      MakePlant("arm2", {effects::MakeSpec("encoder_offset", {"elbow"}, {{"offset", 0.1}})});
  const sim::Plant plain = MakePlant("arm2");
  const auto effort = [&](const sim::Plant& plant, const VectorXd& from) {
    return PlanTracking(plant, plant.parameters().Nominal(), Swing(from, 0.5), kDuration, kInterval,
                        MotionLimits::FromModel(plant.model()).torque)
        ->effort;
  };
  EXPECT_LT((effort(off, Eigen::Vector2d(0.3, 0.5)) - effort(plain, start)).cwiseAbs().maxCoeff(), 1e-9);
}

TEST(ReferenceTracking, ATorqueBeyondTheLimitIsNamedWithJointAndTime) {
  const sim::Plant plant = MakePlant("arm2");
  const auto plan = PlanTracking(plant, plant.parameters().Nominal(), Swing(Eigen::Vector2d(1.2, 0), 0.2),
                                 kDuration, kInterval, Eigen::Vector2d(5, 5));
  EXPECT_THAT(plan.status().message(), testing::HasSubstr("motion: shoulder needs a torque of"));
  EXPECT_THAT(plan.status().message(), testing::HasSubstr("its limit is 5"));
}

}  // namespace
}  // namespace rg::trajectories
