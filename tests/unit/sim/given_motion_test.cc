#include "common/sim/given_motion.h"

#include <gtest/gtest.h>

#include <cmath>

namespace rg::sim {
namespace {

// Knots of a quintic polynomial, at uneven times.
double Value(double t) {
  return 0.3 - t + 2 * t * t + t * t * t - 0.5 * std::pow(t, 4) + 0.2 * std::pow(t, 5);
}
double Slope(double t) { return -1 + 4 * t + 3 * t * t - 2 * std::pow(t, 3) + std::pow(t, 4); }
double Bend(double t) { return 4 + 6 * t - 6 * t * t + 4 * std::pow(t, 3); }

GivenMotion Quintic() {
  const std::vector<double> times = {0.0, 0.3, 0.4, 1.1, 1.5};
  Eigen::MatrixXd q(2, 5), v(2, 5), a(2, 5);
  for (int k = 0; k < 5; ++k) {
    q.col(k) << Value(times[k]), -Value(times[k]);
    v.col(k) << Slope(times[k]), -Slope(times[k]);
    a.col(k) << Bend(times[k]), -Bend(times[k]);
  }
  return GivenMotion::Create({1, 4}, times, q, v, a).value();
}

TEST(GivenMotion, FollowsAQuinticExactlyBetweenItsKnots) {
  const GivenMotion motion = Quintic();
  for (double t = 0.0; t <= 1.5; t += 0.037) {
    EXPECT_NEAR(motion.At(0, t).q, Value(t), 1e-12) << t;
    EXPECT_NEAR(motion.At(0, t).v, Slope(t), 1e-11) << t;
    EXPECT_NEAR(motion.At(1, t).v, -Slope(t), 1e-11) << t;
  }
}

TEST(GivenMotion, GoesOnAtItsVelocityBeyondItsEnds) {
  const GivenMotion motion = Quintic();
  EXPECT_NEAR(motion.At(0, -0.2).q, Value(0) - 0.2 * Slope(0), 1e-12);
  EXPECT_NEAR(motion.At(0, -0.2).v, Slope(0), 1e-12);
  EXPECT_NEAR(motion.At(0, 1.7).q, Value(1.5) + 0.2 * Slope(1.5), 1e-12);
  EXPECT_NEAR(motion.At(0, 1.7).v, Slope(1.5), 1e-12);
}

TEST(GivenMotion, RefusesWhatIsNoMotion) {
  const Eigen::MatrixXd one = Eigen::MatrixXd::Zero(1, 2), two = Eigen::MatrixXd::Zero(2, 2);
  EXPECT_FALSE(GivenMotion::Create({0}, {}, {}, {}, {}).ok());
  EXPECT_FALSE(GivenMotion::Create({0}, {0.0, 1.0}, one, one, two).ok());
  EXPECT_FALSE(GivenMotion::Create({0}, {1.0, 1.0}, one, one, one).ok());
  EXPECT_FALSE(GivenMotion::Create({1, 0}, {0.0, 1.0}, two, two, two).ok());
  EXPECT_FALSE(GivenMotion::Create({0}, {0.0, 1.0}, one * NAN, one, one).ok());
}

}  // namespace
}  // namespace rg::sim
