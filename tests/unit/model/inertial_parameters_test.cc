#include "common/model/inertial_parameters.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>

#include "common/base/rng.h"
#include "common/math/gradient_check.h"
#include "common/model/urdf_loader.h"

namespace rg::model {
namespace {

LogCholesky RandomTheta(Rng& rng) {
  LogCholesky theta;
  for (int i = 0; i < 10; ++i) theta[i] = rng.Uniform(-1.0, 1.0);
  return theta;
}

TEST(LogCholesky, AnyThetaIsABodyThatCouldBeBuilt) {
  Rng rng(1);
  for (int i = 0; i < 200; ++i) {
    const LinkParameters link = FromLogCholesky(RandomTheta(rng));
    const Eigen::Vector3d moments =
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(InertiaMatrix(link)).eigenvalues();
    EXPECT_GT(link[0], 0.0);
    EXPECT_GT(moments[0], 0.0);
    EXPECT_GT(moments[0] + moments[1], moments[2]);
    EXPECT_GT(ConsistencyMargin(link), 0.0);
  }
}

TEST(LogCholesky, RoundTrips) {
  Rng rng(2);
  for (int i = 0; i < 50; ++i) {
    const LogCholesky theta = RandomTheta(rng);
    const auto back = ToLogCholesky(FromLogCholesky(theta));
    ASSERT_TRUE(back.has_value());
    EXPECT_LT((*back - theta).cwiseAbs().maxCoeff(), 1e-9);
  }
}

TEST(LogCholesky, HoldsEveryLinkOfTheMicoThatHasMass) {
  const auto mico = LoadUrdf("deploy/robots/mico2.urdf");
  ASSERT_TRUE(mico.ok());
  for (const Link& link : mico->links()) {
    const auto theta = ToLogCholesky(link.parameters);
    EXPECT_EQ(theta.has_value(), link.has_inertial) << link.name;
    if (!theta.has_value()) continue;
    EXPECT_LT((FromLogCholesky(*theta) - link.parameters).cwiseAbs().maxCoeff(), 1e-14) << link.name;
  }
}

TEST(LogCholesky, JacobianMatchesCentralDifferences) {
  Rng rng(3);
  for (int i = 0; i < 5; ++i) {
    const LogCholesky theta = RandomTheta(rng);
    const auto check =
        math::CheckGradient([](const Eigen::VectorXd& x) { return Eigen::VectorXd(FromLogCholesky(x)); },
                            theta, LogCholeskyJacobian(theta), {.tolerance = 1e-9});
    EXPECT_TRUE(check) << check.message;
  }
}

TEST(LogCholesky, RefusesWhatCannotBeBuilt) {
  LinkParameters link;
  link << 2.0, 0, 0, 0, 1.0, 1.0, 2.5, 0, 0, 0;  // breaks the triangle inequality
  EXPECT_FALSE(ToLogCholesky(link).has_value());
  EXPECT_LT(ConsistencyMargin(link), 0.0);
  link << -1.0, 0, 0, 0, 1.0, 1.0, 1.0, 0, 0, 0;
  EXPECT_FALSE(ToLogCholesky(link).has_value());
  EXPECT_FALSE(ToLogCholesky(LinkParameters::Zero()).has_value());
}

}  // namespace
}  // namespace rg::model
