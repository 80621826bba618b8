// KDL as an oracle: its own tree is made from the URDF text, not from RobotModel.
#include <gtest/gtest.h>

#include <kdl/chaindynparam.hpp>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <kdl/chainjnttojacsolver.hpp>
#include <kdl/tree.hpp>
#include <kdl/treeidsolver_recursive_newton_euler.hpp>

#include "common/dynamics/dynamics.h"
#include "tests/unit/dynamics/kdl_tree.h"
#include "tests/unit/dynamics/robots.h"

namespace rg::dynamics {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// q in KDL's joint numbering.
KDL::JntArray ToKdl(const KDL::Tree& tree, const model::RobotModel& model, const VectorXd& x) {
  KDL::JntArray out(tree.getNrOfJoints());
  for (const auto& [name, element] : tree.getSegments()) {
    const KDL::Joint& joint = GetTreeElementSegment(element).getJoint();
    if (joint.getType() == KDL::Joint::Fixed) continue;
    out(GetTreeElementQNr(element)) = x[model.FindJoint(joint.getName())];
  }
  return out;
}

VectorXd FromKdl(const KDL::Tree& tree, const model::RobotModel& model, const KDL::JntArray& x) {
  VectorXd out(model.num_joints());
  for (const auto& [name, element] : tree.getSegments()) {
    const KDL::Joint& joint = GetTreeElementSegment(element).getJoint();
    if (joint.getType() == KDL::Joint::Fixed) continue;
    out[model.FindJoint(joint.getName())] = x(GetTreeElementQNr(element));
  }
  return out;
}

TEST(Kdl, AgreesOnInverseDynamics) {
  Rng rng(41);
  for (const model::RobotModel& model : AllRobots()) {
    SCOPED_TRACE(model.name() + " " + std::to_string(model.num_joints()));
    const int n = model.num_joints();
    const KDL::Tree tree = KdlTree(model);
    ASSERT_EQ(static_cast<int>(tree.getNrOfJoints()), n);
    Mechanism m(model);
    const Eigen::Vector3d gravity(0.3, -2.0, -9.0);
    m.SetGravity(gravity);
    Workspace w;
    KDL::TreeIdSolver_RNE solver(tree, KDL::Vector(gravity[0], gravity[1], gravity[2]));
    for (int i = 0; i < 20; ++i) {
      const RandomState s = DrawState(rng, n);
      KDL::JntArray torques(n);
      ASSERT_EQ(solver.CartToJnt(ToKdl(tree, model, s.q), ToKdl(tree, model, s.v), ToKdl(tree, model, s.a),
                                 KDL::WrenchMap(), torques),
                0);
      const VectorXd expected = FromKdl(tree, model, torques);
      VectorXd tau(n);
      Rnea(m, w, s.q, s.v, s.a, tau);
      EXPECT_LT((tau - expected).cwiseAbs().maxCoeff(), 1e-9 * std::max(1.0, expected.cwiseAbs().maxCoeff()));
    }
  }
}

TEST(Kdl, AgreesOnMassMatrixPoseAndJacobianOfChains) {
  Rng rng(42);
  std::vector<model::RobotModel> robots;
  robots.push_back(MicoArm());
  for (const char* name : {"arm2.urdf", "pendulum.urdf", "arm7.urdf", "slide.urdf"})
    robots.push_back(LoadRobot(name));
  for (const model::RobotModel& model : robots) {
    SCOPED_TRACE(model.name());
    const int n = model.num_joints();
    const KDL::Tree tree = KdlTree(model);
    KDL::Chain chain;
    ASSERT_TRUE(tree.getChain(tree.getRootSegment()->first, model.end_effector().name, chain));
    const Mechanism m(model);
    Workspace w;
    KDL::ChainFkSolverPos_recursive forward(chain);
    KDL::ChainJntToJacSolver jacobian(chain);
    for (int i = 0; i < 10; ++i) {
      const RandomState s = DrawState(rng, n);
      KDL::JntArray q(n);
      q.data = s.q;
      KDL::Frame pose;
      KDL::Jacobian J_kdl(n);
      ASSERT_EQ(forward.JntToCart(q, pose), 0);
      ASSERT_EQ(jacobian.JntToJac(q, J_kdl), 0);
      MatrixXd J(6, n);
      const model::Pose X = FrameKinematics(m, w, s.q, *model.FindFrame(model.end_effector().name), J);
      for (int r = 0; r < 3; ++r) {
        EXPECT_NEAR(X.translation[r], pose.p(r), 1e-9);
        for (int c = 0; c < 3; ++c) EXPECT_NEAR(X.rotation(r, c), pose.M(r, c), 1e-9);
      }
      EXPECT_LT((J.topRows(3) - J_kdl.data.bottomRows(3)).cwiseAbs().maxCoeff(), 1e-9);
      EXPECT_LT((J.bottomRows(3) - J_kdl.data.topRows(3)).cwiseAbs().maxCoeff(), 1e-9);
    }
    // KDL's chain to the end effector lacks side branches (the fingers' mass), so M is compared where
    // the chain is the whole robot.
    if (model.name() == "mico2") continue;
    KDL::ChainDynParam parameters(chain, KDL::Vector(0, 0, -9.81));
    for (int i = 0; i < 10; ++i) {
      const RandomState s = DrawState(rng, n);
      KDL::JntArray q(n);
      q.data = s.q;
      KDL::JntSpaceInertiaMatrix H(n);
      ASSERT_EQ(parameters.JntToMass(q, H), 0);
      MatrixXd M(n, n);
      Crba(m, w, s.q, M);
      EXPECT_LT((M - H.data).cwiseAbs().maxCoeff(), 1e-9 * std::max(1.0, H.data.maxCoeff()));
    }
  }
}

}  // namespace
}  // namespace rg::dynamics
