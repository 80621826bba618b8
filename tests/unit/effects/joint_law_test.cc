// The friction law's impulse over a step, and the dual numbers under all laws.
#include "common/effects/joint_law.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/base/rng.h"

namespace rg::effects {
namespace {

JointLaw<double> Law(double v0, double v1, double mass, double h) {
  JointLaw<double> law;
  law.step = {h, 0.0, false, 1e-9};
  law.mass = law.reference_mass = mass;
  law.v0 = v0;
  law.v1 = v1;
  law.q0 = law.q1 = 0.0;
  law.acceleration = (v1 - v0) / h;
  return law;
}

// A block under a constant force G and Coulomb friction, followed exactly through its reversal.
double ExactEnd(double v0, double force, double positive, double negative, double mass, double h) {
  const double level = v0 > 0 ? -positive : negative;
  const double a = (force + level) / mass;
  const double rest = v0 == 0 ? 0.0 : -v0 / a;
  if (v0 != 0 && (rest < 0 || rest > h)) return v0 + a * h;
  const double left = h - (v0 == 0 ? 0.0 : rest);
  if (force > positive) return (force - positive) / mass * left;
  if (force < -negative) return (force + negative) / mass * left;
  return 0.0;
}

TEST(SignForce, IsTheExactAverageOfASlidingBlockThroughReversal) {
  Rng rng(3);
  constexpr double kH = 1e-3;
  int reversals = 0;
  for (int i = 0; i < 4000; ++i) {
    const double mass = rng.Uniform(0.01, 2.0), positive = rng.Uniform(0.0, 2.0),
                 negative = rng.Uniform(0.0, 2.0);
    const double force = rng.Uniform(-6.0, 6.0);
    const double v0 = rng.Uniform(-1.0, 1.0) * 4 * kH / mass;
    const double v1 = ExactEnd(v0, force, positive, negative, mass, kH);
    if (v1 == 0.0) continue;  // sticks: any force up to the level
    reversals += v0 * v1 < 0;
    // v1 must solve mass·(v1 − v0)/h = G + F̄(v1).
    const double needed = mass * (v1 - v0) / kH - force;
    EXPECT_NEAR(Law(v0, v1, mass, kH).SignForce(positive, negative), needed, 1e-9) << v0 << " " << v1;
  }
  EXPECT_GT(reversals, 400);
}

TEST(SignForce, FallsWithTheEndVelocityAndNeverExceedsTheLevels) {
  Rng rng(4);
  for (int i = 0; i < 500; ++i) {
    const double v0 = rng.Uniform(-0.1, 0.1), positive = rng.Uniform(0, 2), negative = rng.Uniform(0, 2);
    double last = 1e9;
    for (double v1 = -0.3; v1 <= 0.3; v1 += 0.002) {
      const double force = Law(v0, v1, 0.1, 1e-3).SignForce(positive, negative);
      EXPECT_LE(force, last + 1e-12);
      EXPECT_LE(force, negative + 1e-12);
      EXPECT_GE(force, -positive - 1e-12);
      last = force;
    }
  }
}

TEST(Weight, IsTheMidpointWhenResolvedAndTheEndWhenNot) {
  const auto law = Law(0, 0, 1, 1e-3);
  EXPECT_DOUBLE_EQ(law.Weight(0.0), 0.5);
  EXPECT_NEAR(law.Weight(0.1), 1 / (1 - std::exp(-0.1)) - 1 / 0.1, 1e-3);
  EXPECT_GT(law.Weight(1e6), 0.999);
  EXPECT_DOUBLE_EQ(law.Weight(-5.0), 0.5);
}

TEST(Dual, DifferentiatesProductsQuotientsAndFunctions) {
  using D = Dual<double, 2>;
  const D x = D::Variable(0.7, 0), y = D::Variable(-1.3, 1);
  const D f = Sin(x * y) / (2.0 + Exp(x)) - Sqrt(x) * Abs(y);
  auto value = [](double a, double b) {
    return std::sin(a * b) / (2 + std::exp(a)) - std::sqrt(a) * std::fabs(b);
  };
  constexpr double kE = 1e-6;
  EXPECT_DOUBLE_EQ(f.v, value(0.7, -1.3));
  EXPECT_NEAR(f.d[0], (value(0.7 + kE, -1.3) - value(0.7 - kE, -1.3)) / (2 * kE), 1e-8);
  EXPECT_NEAR(f.d[1], (value(0.7, -1.3 + kE) - value(0.7, -1.3 - kE)) / (2 * kE), 1e-8);
}

}  // namespace
}  // namespace rg::effects
