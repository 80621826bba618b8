#include "services/sysid/boxed_newton_step.h"

#include <gtest/gtest.h>

#include "common/base/rng.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

struct Problem {
  MatrixXd H;
  VectorXd g, low, high;
};

// Strongly coupled coordinates of very different scale, and a box that most of them would leave.
Problem RandomProblem(int P, double box, uint64_t seed) {
  Rng rng(seed);
  MatrixXd A(P + 2, P);
  for (double& x : A.reshaped()) x = rng.Normal();
  A.leftCols(P / 2) += 3.0 * A.col(P - 1).replicate(1, P / 2);
  VectorXd scale(P);
  for (double& s : scale) s = std::pow(10.0, rng.Uniform(-2.0, 2.0));
  Problem p;
  p.H = scale.asDiagonal() * (A.transpose() * A + 1e-3 * MatrixXd::Identity(P, P)) * scale.asDiagonal();
  p.g.resize(P);
  for (int i = 0; i < P; ++i) p.g[i] = 10.0 * scale[i] * rng.Normal();
  p.low = -box * scale.cwiseInverse(), p.high = box * scale.cwiseInverse();
  p.low[0] = 0.0;  // stands at a side of the box already
  return p;
}

TEST(BoxedNewtonStep, IsTheMinimumWithinTheBox) {
  for (const double box : {1e-4, 1e-2, 0.3, 3.0, 1e6}) {
    for (uint64_t seed = 1; seed <= 20; ++seed) {
      const Problem p = RandomProblem(30, box, seed);
      const VectorXd x = BoxedNewtonStep(p.H, p.g, p.low, p.high);
      const VectorXd gradient = p.g + p.H * x;
      for (int i = 0; i < x.size(); ++i) {
        ASSERT_GE(x[i], p.low[i]);
        ASSERT_LE(x[i], p.high[i]);
        const double small = 1e-5 * (std::abs(p.g[i]) + std::sqrt(p.H(i, i)));
        if (x[i] > p.low[i]) {
          EXPECT_LT(gradient[i], small) << "box " << box << " seed " << seed << " i " << i;
        }
        if (x[i] < p.high[i]) {
          EXPECT_GT(gradient[i], -small) << "box " << box << " seed " << seed << " i " << i;
        }
      }
    }
  }
}

TEST(BoxedNewtonStep, LowersTheModelHoweverSmallTheBox) {
  for (uint64_t seed = 1; seed <= 50; ++seed) {
    const Problem p = RandomProblem(70, 1e-5, seed);
    const VectorXd x = BoxedNewtonStep(p.H, p.g, p.low, p.high);
    EXPECT_LT(p.g.dot(x) + 0.5 * x.dot(p.H * x), 0.0) << seed;
  }
}

}  // namespace
}  // namespace rg::sysid
