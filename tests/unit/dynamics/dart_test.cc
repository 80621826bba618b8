// DART as a second oracle, with its own URDF reader and its own algorithms.
#include <gtest/gtest.h>

#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <dart/utils/urdf/DartLoader.hpp>

#include "common/dynamics/dynamics.h"
#include "tests/unit/dynamics/robots.h"

namespace rg::dynamics {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

dart::dynamics::SkeletonPtr LoadIntoDart(const model::RobotModel& model) {
  dart::utils::DartLoader loader;
  dart::utils::DartLoader::Options options;
  options.mDefaultRootJointType = dart::utils::DartLoader::RootJointType::FIXED;
  // DART gives links without <inertial> a mass; here they have none.
  options.mDefaultInertia =
      dart::dynamics::Inertia(1e-14, Eigen::Vector3d::Zero(), 1e-14 * Eigen::Matrix3d::Identity());
  loader.setOptions(options);
  const auto skeleton = loader.parseSkeletonString(model.urdf_text(), "");
  // DART's forward dynamics would apply the URDF's damping; here it is an effect, not rigid-body dynamics.
  for (auto* dof : skeleton->getDofs()) dof->setDampingCoefficient(0.0);
  return skeleton;
}

// Index of each of DART's degrees of freedom in the model.
std::vector<int> Order(const dart::dynamics::Skeleton& skeleton, const model::RobotModel& model) {
  std::vector<int> out;
  for (const auto* dof : skeleton.getDofs()) out.push_back(model.FindJoint(dof->getName()));
  return out;
}

double Distance(const MatrixXd& a, const MatrixXd& b) {
  return (a - b).cwiseAbs().maxCoeff() / std::max(1.0, b.cwiseAbs().maxCoeff());
}

TEST(Dart, AgreesOnMassMatrixBiasAndForwardDynamics) {
  Rng rng(51);
  std::vector<model::RobotModel> robots = AllRobots();
  for (const model::RobotModel& model : robots) {
    const int n = model.num_joints();
    if (model.name() == "mico2" && n == 6) continue;  // DART moves the fingers too
    SCOPED_TRACE(model.name() + " " + std::to_string(n));
    const auto skeleton = LoadIntoDart(model);
    ASSERT_NE(skeleton, nullptr);
    ASSERT_EQ(static_cast<int>(skeleton->getNumDofs()), n);
    const std::vector<int> order = Order(*skeleton, model);
    Mechanism m(model);
    const Eigen::Vector3d gravity(1.0, 0.4, -9.3);
    m.SetGravity(gravity);
    skeleton->setGravity(gravity);
    Workspace w;
    for (int i = 0; i < 10; ++i) {
      const RandomState s = DrawState(rng, n);
      VectorXd tau(n), c(n), a(n);
      MatrixXd M(n, n);
      Rnea(m, w, s.q, s.v, s.a, tau);
      MassMatrixAndBias(m, w, s.q, s.v, M, c);
      Aba(m, w, s.q, s.v, tau, a);
      skeleton->setPositions(s.q(order));
      skeleton->setVelocities(s.v(order));
      skeleton->setForces(tau(order));
      skeleton->computeForwardDynamics();
      EXPECT_LT(Distance(M(order, order), skeleton->getMassMatrix()), 1e-9);
      EXPECT_LT(Distance(c(order), skeleton->getCoriolisAndGravityForces()), 1e-9);
      EXPECT_LT(Distance(a(order), skeleton->getAccelerations()), 1e-7);  // times the condition of M
      EXPECT_NEAR(KineticEnergy(m, w, s.q, s.v), skeleton->computeKineticEnergy(), 1e-9 * n * 10);
    }
  }
}

}  // namespace
}  // namespace rg::dynamics
