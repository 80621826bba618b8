// Robots of which joints follow others, against the same robots with all joints free: with q̇_free = G q̇ every
// torque is Gᵀ of the free one's.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>

#include "common/dynamics/dynamics.h"
#include "common/math/gradient_check.h"
#include "tests/support/sim/followers.h"
#include "tests/unit/dynamics/robots.h"

namespace rg::dynamics {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using rg::testing::Bind;
using rg::testing::Binding;

struct Pair {
  model::RobotModel free;
  std::map<int, Binding> bindings;
};

// Drivers before and behind their followers, two followers of one driver, joints that hang on followers.
std::vector<Pair> Pairs() {
  std::vector<Pair> out;
  out.push_back({LoadRobot("arm2.urdf"), {{1, {0, -0.8, 0.3}}}});
  out.push_back({MicoArm(), {{2, {1, -1.0, 0.0}}, {4, {1, 0.5, -0.7}}}});
  out.push_back({MicoArm(), {{1, {5, 2.0, 0.1}}}});
  for (const int joints : {3, 8, 12})
    out.push_back({RandomTree(Rng(11).Split(joints), joints), {{1, {2, 0.7, 0.2}}}});
  return out;
}

template <class F>
void ForRandomTrees(F check) {
  for (const Pair& pair : Pairs()) {
    const auto bound = Bind(pair.free, pair.bindings);
    const auto [G, g0] = rg::testing::UnboundOf(pair.free, pair.bindings);
    const Mechanism m(*bound), free(pair.free);
    Workspace w, wf;
    Rng rng(3);
    for (int k = 0; k < 5; ++k) check(m, w, free, wf, G, g0, DrawState(rng, bound->num_joints()));
  }
}

TEST(Followers, TorquesAreTheFreeRobotsFoldedOntoTheDrivers) {
  ForRandomTrees([](const Mechanism& m, Workspace& w, const Mechanism& free, Workspace& wf,
                     const MatrixXd& G, const VectorXd& g0, const RandomState& s) {
    VectorXd tau(G.cols()), full(G.rows());
    Rnea(m, w, s.q, s.v, s.a, tau);
    Rnea(free, wf, G * s.q + g0, G * s.v, G * s.a, full);
    EXPECT_LT((tau - G.transpose() * full).cwiseAbs().maxCoeff(), 1e-9 * (1 + full.norm()));
    GravityTorque(m, w, s.q, tau);
    GravityTorque(free, wf, G * s.q + g0, full);
    EXPECT_LT((tau - G.transpose() * full).cwiseAbs().maxCoeff(), 1e-9 * (1 + full.norm()));
  });
}

TEST(Followers, MassMatrixIsFoldedFromBothSides) {
  ForRandomTrees([](const Mechanism& m, Workspace& w, const Mechanism& free, Workspace& wf,
                     const MatrixXd& G, const VectorXd& g0, const RandomState& s) {
    const long n = G.cols(), N = G.rows();
    MatrixXd M(n, n), twin(n, n), full(N, N);
    VectorXd c(n), tau(n);
    Crba(m, w, s.q, M);
    Crba(free, wf, G * s.q + g0, full);
    EXPECT_LT((M - G.transpose() * full * G).cwiseAbs().maxCoeff(), 1e-10 * (1 + full.norm()));
    MassMatrixAndBias(m, w, s.q, s.v, twin, c);
    EXPECT_LT((M - twin).cwiseAbs().maxCoeff(), 1e-10 * (1 + full.norm()));
    Rnea(m, w, s.q, s.v, s.a, tau);
    EXPECT_LT((M * s.a + c - tau).cwiseAbs().maxCoeff(), 1e-9 * (1 + tau.norm()));
    EXPECT_NEAR(KineticEnergy(m, w, s.q, s.v), 0.5 * s.v.dot(M * s.v), 1e-9 * (1 + M.norm()));
    VectorXd a(n);
    Aba(m, w, s.q, s.v, tau, a);
    EXPECT_LT((a - s.a).cwiseAbs().maxCoeff(), 1e-7 * (1 + tau.norm()));
  });
}

TEST(Followers, RegressorTimesParametersIsTheTorque) {
  ForRandomTrees([](const Mechanism& m, Workspace& w, const Mechanism& free, Workspace&, const MatrixXd& G,
                     const VectorXd&, const RandomState& s) {
    ASSERT_EQ(m.num_bodies(), free.num_joints());
    MatrixXd Y(G.cols(), 10 * m.num_bodies());
    TorqueRegressor(m, w, s.q, s.v, s.a, Y);
    VectorXd tau(G.cols());
    Rnea(m, w, s.q, s.v, s.a, tau);
    const VectorXd phi = m.body_parameters().reshaped();
    EXPECT_LT((Y * phi - tau).cwiseAbs().maxCoeff(), 1e-9 * (1 + tau.norm()));
  });
}

TEST(Followers, DerivativesMatchCentralDifferences) {
  ForRandomTrees([](const Mechanism& m, Workspace& w, const Mechanism&, Workspace&, const MatrixXd& G,
                     const VectorXd&, const RandomState& s) {
    const long n = G.cols();
    MatrixXd by_q(n, n), by_v(n, n), by_g(n, 3);
    RneaDerivatives(m, w, s.q, s.v, s.a, by_q, by_v);
    VectorXd tau(n);
    const auto torque = [&](const VectorXd& q, const VectorXd& v) {
      Rnea(m, w, q, v, s.a, tau);
      return tau;
    };
    const auto by_position =
        math::CheckGradient([&](const VectorXd& q) { return torque(q, s.v); }, s.q, by_q);
    EXPECT_TRUE(by_position) << by_position.message;
    const auto by_speed = math::CheckGradient([&](const VectorXd& v) { return torque(s.q, v); }, s.v, by_v);
    EXPECT_TRUE(by_speed) << by_speed.message;
    RneaGravityDerivative(m, w, s.q, by_g);
    Mechanism turned = m;
    const auto by_gravity = math::CheckGradient(
        [&](const VectorXd& g) {
          turned.SetGravity(g);
          Rnea(turned, w, s.q, s.v, s.a, tau);
          return tau;
        },
        m.gravity(), by_g);
    EXPECT_TRUE(by_gravity) << by_gravity.message;
    MatrixXd da_dq(n, n), da_dv(n, n), da_dtau(n, n);
    VectorXd a(n);
    AbaDerivatives(m, w, s.q, s.v, VectorXd::Ones(n), a, da_dq, da_dv, da_dtau);
    const auto acceleration = math::CheckGradient(
        [&](const VectorXd& q) {
          Aba(m, w, q, s.v, VectorXd::Ones(n), a);
          return a;
        },
        s.q, da_dq);
    EXPECT_TRUE(acceleration) << acceleration.message;
  });
}

TEST(Followers, FramesMoveAsTheJacobianSays) {
  const auto free = MicoArm();
  const std::map<int, Binding> bindings = {{2, {1, -1.0, 0.4}}, {4, {1, 0.5, -0.7}}};
  const auto bound = Bind(free, bindings);
  const auto [G, g0] = rg::testing::UnboundOf(free, bindings);
  const Mechanism m(*bound), all(free);
  Workspace w, wf;
  Rng rng(5);
  const RandomState s = DrawState(rng, bound->num_joints());
  for (const model::Link& link : free.links()) {
    MatrixXd J(6, G.cols()), full(6, G.rows());
    const model::Pose X = FrameKinematics(m, w, s.q, *bound->FindFrame(link.name), J);
    const model::Pose X_free = FrameKinematics(all, wf, G * s.q + g0, *free.FindFrame(link.name), full);
    EXPECT_LT((X.translation - X_free.translation).norm(), 1e-12) << link.name;
    EXPECT_LT((J - full * G).cwiseAbs().maxCoeff(), 1e-12) << link.name;
  }
  EXPECT_NEAR(PotentialEnergy(m, w, s.q), PotentialEnergy(all, wf, G * s.q + g0), 1e-10);
}

}  // namespace
}  // namespace rg::dynamics
