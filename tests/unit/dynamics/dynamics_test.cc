// Identities and physics that hold for every robot and state.
#include "common/dynamics/dynamics.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>
#include <limits>

#include "common/math/gradient_check.h"
#include "tests/unit/dynamics/robots.h"

namespace rg::dynamics {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr int kStates = 5;

// Calls check(model, mechanism, workspace, state) for random states of all robots.
template <class Check>
void ForRandomStates(Check check) {
  Rng rng(11);
  for (const model::RobotModel& model : AllRobots()) {
    SCOPED_TRACE(model.name() + " " + std::to_string(model.num_joints()));
    Mechanism mechanism(model);
    mechanism.SetGravity(Vector3d(0.7, -1.3, -9.5));
    Workspace workspace;
    for (int i = 0; i < kStates; ++i) check(model, mechanism, workspace, DrawState(rng, model.num_joints()));
  }
}

VectorXd InverseDynamicsOf(const Mechanism& m, Workspace& w, const VectorXd& q, const VectorXd& v,
                           const VectorXd& a) {
  VectorXd tau(q.size());
  Rnea(m, w, q, v, a, tau);
  return tau;
}
MatrixXd MassMatrixOf(const Mechanism& m, Workspace& w, const VectorXd& q) {
  MatrixXd M(q.size(), q.size());
  Crba(m, w, q, M);
  return M;
}

double RelativeError(const MatrixXd& a, const MatrixXd& b) {
  return (a - b).cwiseAbs().maxCoeff() / std::max(1.0, b.cwiseAbs().maxCoeff());
}

TEST(Aba, UndoesRnea) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    VectorXd a(s.q.size());
    Aba(m, w, s.q, s.v, InverseDynamicsOf(m, w, s.q, s.v, s.a), a);
    EXPECT_LT(RelativeError(a, s.a), 1e-9);
  });
}

TEST(Crba, IsSymmetricAndPositiveDefinite) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    const MatrixXd M = MassMatrixOf(m, w, s.q);
    EXPECT_EQ((M - M.transpose()).norm(), 0.0);
    EXPECT_EQ(M.llt().info(), Eigen::Success);
  });
}

TEST(MassMatrixAndBias, AddUpToRnea) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    const int n = static_cast<int>(s.q.size());
    MatrixXd M(n, n);
    VectorXd c(n);
    MassMatrixAndBias(m, w, s.q, s.v, M, c);
    EXPECT_LT(RelativeError(M * s.a + c, InverseDynamicsOf(m, w, s.q, s.v, s.a)), 1e-12);
    EXPECT_LT(RelativeError(M, MassMatrixOf(m, w, s.q)), 1e-13);
  });
}

TEST(GravityTorque, IsTheGradientOfPotentialEnergy) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    VectorXd g(s.q.size());
    GravityTorque(m, w, s.q, g);
    const auto energy = [&](const VectorXd& q) { return VectorXd::Constant(1, PotentialEnergy(m, w, q)); };
    const auto check = math::CheckGradient(energy, s.q, g.transpose(), {.tolerance = 1e-8});
    EXPECT_TRUE(check) << check.message;
  });
}

TEST(Rnea, PowerIsTheRateOfEnergy) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    const auto energy = [&](double t) {
      const VectorXd q = s.q + t * s.v + 0.5 * t * t * s.a;
      const VectorXd v = s.v + t * s.a;
      return KineticEnergy(m, w, q, v) + PotentialEnergy(m, w, q);
    };
    const double h = 1e-4;
    const double rate = (8 * (energy(h) - energy(-h)) - (energy(2 * h) - energy(-2 * h))) / (12 * h);
    const double power = s.v.dot(InverseDynamicsOf(m, w, s.q, s.v, s.a));
    EXPECT_NEAR(power, rate, 1e-6 * std::max(1.0, std::abs(power)));
  });
}

TEST(RneaDerivatives, MatchCentralDifferences) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    const int n = static_cast<int>(s.q.size());
    MatrixXd dq(n, n), dv(n, n);
    RneaDerivatives(m, w, s.q, s.v, s.a, dq, dv);
    const auto by_q =
        math::CheckGradient([&](const VectorXd& q) { return InverseDynamicsOf(m, w, q, s.v, s.a); }, s.q, dq,
                            {.tolerance = 1e-8});
    const auto by_v =
        math::CheckGradient([&](const VectorXd& v) { return InverseDynamicsOf(m, w, s.q, v, s.a); }, s.v, dv,
                            {.tolerance = 1e-8});
    EXPECT_TRUE(by_q) << by_q.message;
    EXPECT_TRUE(by_v) << by_v.message;
  });
}

TEST(RneaGravityDerivative, MatchesCentralDifferences) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    MatrixXd dg(s.q.size(), 3);
    RneaGravityDerivative(m, w, s.q, dg);
    Mechanism other = m;
    const auto check = math::CheckGradient(
        [&](const VectorXd& g) {
          other.SetGravity(g);
          return InverseDynamicsOf(other, w, s.q, s.v, s.a);
        },
        m.gravity(), dg, {.tolerance = 1e-9});
    EXPECT_TRUE(check) << check.message;
  });
}

TEST(AbaDerivatives, MatchCentralDifferences) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    const int n = static_cast<int>(s.q.size());
    const VectorXd tau = InverseDynamicsOf(m, w, s.q, s.v, s.a);
    VectorXd a(n);
    MatrixXd dq(n, n), dv(n, n), dtau(n, n);
    AbaDerivatives(m, w, s.q, s.v, tau, a, dq, dv, dtau);
    EXPECT_LT(RelativeError(a, s.a), 1e-9);
    const auto forward = [&](const VectorXd& q, const VectorXd& v, const VectorXd& u) {
      VectorXd out(n);
      Aba(m, w, q, v, u, out);
      return out;
    };
    const auto by_q = math::CheckGradient([&](const VectorXd& q) { return forward(q, s.v, tau); }, s.q, dq);
    const auto by_v = math::CheckGradient([&](const VectorXd& v) { return forward(s.q, v, tau); }, s.v, dv);
    const auto by_u = math::CheckGradient([&](const VectorXd& u) { return forward(s.q, s.v, u); }, tau, dtau);
    EXPECT_TRUE(by_q) << by_q.message;
    EXPECT_TRUE(by_v) << by_v.message;
    EXPECT_TRUE(by_u) << by_u.message;
    EXPECT_LT(RelativeError(dtau * MassMatrixOf(m, w, s.q), MatrixXd::Identity(n, n)), 1e-9);
  });
}

TEST(TorqueRegressor, TimesParametersIsRnea) {
  ForRandomStates([](const auto&, const Mechanism& m, Workspace& w, const RandomState& s) {
    const int n = static_cast<int>(s.q.size());
    MatrixXd Y(n, 10 * n);
    TorqueRegressor(m, w, s.q, s.v, s.a, Y);
    const VectorXd phi = Eigen::Map<const VectorXd>(m.body_parameters().data(), 10 * n);
    EXPECT_LT(RelativeError(Y * phi, InverseDynamicsOf(m, w, s.q, s.v, s.a)), 1e-12);
  });
}

TEST(TorqueRegressor, ColumnsAreTheTorquesOfUnitParameters) {
  Rng rng(3);
  const model::RobotModel model = RandomTree(Rng(5), 6);
  Mechanism m(model);
  Workspace w;
  const RandomState s = DrawState(rng, 6);
  MatrixXd Y(6, 60);
  TorqueRegressor(m, w, s.q, s.v, s.a, Y);
  for (int column = 0; column < 60; ++column) {
    BodyParameters unit = BodyParameters::Zero(10, 6);
    unit(column % 10, column / 10) = 1.0;
    m.SetBodyParameters(unit);
    EXPECT_LT(RelativeError(Y.col(column), InverseDynamicsOf(m, w, s.q, s.v, s.a)), 1e-12) << column;
  }
}

TEST(FrameKinematics, JacobianIsTheRateOfThePose) {
  ForRandomStates([](const model::RobotModel& model, const Mechanism& m, Workspace& w, const RandomState& s) {
    for (const model::Link& link : {model.link(0), model.end_effector(), model.links().back()}) {
      const model::Frame frame = *model.FindFrame(link.name);
      MatrixXd J(6, s.q.size());
      const model::Pose X = FrameKinematics(m, w, s.q, frame, J);
      // Columns of the rotation and the origin; d(R) = ω̂ R.
      MatrixXd expected(12, s.q.size());
      for (int j = 0; j < s.q.size(); ++j) {
        for (int c = 0; c < 3; ++c) {
          expected.block<3, 1>(3 * c, j) = Vector3d(J.col(j).head<3>()).cross(Vector3d(X.rotation.col(c)));
        }
        expected.block<3, 1>(9, j) = J.col(j).tail<3>();
      }
      const auto pose = [&](const VectorXd& q) {
        const model::Pose at = FramePose(m, w, q, frame);
        VectorXd out(12);
        out << Eigen::Map<const VectorXd>(at.rotation.data(), 9), at.translation;
        return out;
      };
      const auto check = math::CheckGradient(pose, s.q, expected, {.tolerance = 1e-9});
      EXPECT_TRUE(check) << link.name << ": " << check.message;
    }
  });
}

TEST(LumpedInertias, AreUnchangedWhenMassMovesBetweenFixedLinks) {
  // link_6 given to end_effector, which is fixed to it and has no inertial of its own.
  const model::RobotModel mico = MicoArm();
  const int from = mico.FindLink("link_6"), to = mico.FindLink("end_effector");
  LinkParametersMatrix links = mico.NominalLinkParameters();
  const BodyParameters before = LumpedInertias(mico, links);
  const model::Pose X_TF = mico.link(to).X_BL.Inverse() * mico.link(from).X_BL;
  const Eigen::Matrix3d I = X_TF.rotation * model::InertiaMatrix(links.col(from)) * X_TF.rotation.transpose();
  links.col(to) << links(0, from), X_TF.rotation * links.col(from).segment<3>(1) + X_TF.translation, I(0, 0),
      I(1, 1), I(2, 2), I(0, 1), I(0, 2), I(1, 2);
  links.col(from).setZero();
  EXPECT_LT((LumpedInertias(mico, links) - before).cwiseAbs().maxCoeff(), 1e-15);
}

TEST(LumpedInertias, IgnoreLinksOfTheBase) {
  const model::RobotModel mico = MicoArm();
  LinkParametersMatrix links = mico.NominalLinkParameters();
  const BodyParameters before = LumpedInertias(mico, links);
  for (const char* name : {"world", "root", "link_base"}) links.col(mico.FindLink(name)).setConstant(3.0);
  EXPECT_EQ(LumpedInertias(mico, links), before);
}

TEST(LumpingJacobian, MatchesCentralDifferences) {
  const model::RobotModel mico = MicoArm();
  Rng rng(2);
  for (int i = 0; i < mico.num_links(); ++i) {
    const int body = mico.link(i).body;
    if (body < 0) continue;
    LinkParametersMatrix links = mico.NominalLinkParameters();
    links.col(i) += RandomVector(rng, 10, 0.1);
    const auto lump = [&](const VectorXd& p) {
      LinkParametersMatrix changed = links;
      changed.col(i) = p;
      return VectorXd(LumpedInertias(mico, changed).col(body));
    };
    const auto check =
        math::CheckGradient(lump, links.col(i), LumpingJacobian(mico, i, links.col(i)), {.tolerance = 1e-9});
    EXPECT_TRUE(check) << mico.link(i).name << ": " << check.message;
  }
}

TEST(Dynamics, PendulumObeysItsClosedForm) {
  const model::RobotModel model = LoadRobot("pendulum.urdf");
  Mechanism m(model);
  Workspace w;
  const model::LinkParameters& p = model.link(1).parameters;
  const double length = -p[3], inertia = p[5] + p[0] * length * length;
  for (double angle : {0.0, 0.4, 1.7, -2.9}) {
    const VectorXd q = VectorXd::Constant(1, angle), v = VectorXd::Constant(1, 1.3),
                   tau = VectorXd::Constant(1, 0.2);
    VectorXd a(1);
    Aba(m, w, q, v, tau, a);
    EXPECT_NEAR(a[0], (0.2 - p[0] * 9.81 * length * std::sin(angle)) / inertia, 1e-12);
  }
}

TEST(Dynamics, BodyInFreeFallNeedsNoTorque) {
  const model::RobotModel slide = LoadRobot("slide.urdf");
  Mechanism m(slide);
  m.SetGravity(Vector3d(-9.81, 0, 0));  // along the rail
  Workspace w;
  const VectorXd q = Vector3d(0.1, 0.5, 0.1), v = VectorXd::Zero(3), tau = VectorXd::Zero(3);
  VectorXd a(3);
  Aba(m, w, q, v, tau, a);
  EXPECT_NEAR((a - VectorXd(Vector3d(-9.81, 0, 0))).norm(), 0.0, 1e-12);
}

TEST(Dynamics, GravityTorqueOfTheMicoStaysWithinItsKnownMaxima) {
  const model::RobotModel mico = MicoArm();
  Mechanism m(mico);
  Workspace w;
  Rng rng(1);
  VectorXd largest = VectorXd::Zero(6), g(6);
  for (int i = 0; i < 20000; ++i) {
    VectorXd q = RandomVector(rng, 6, M_PI);
    for (int k : {1, 2}) q[k] = rng.Uniform(mico.joint(k).lower, mico.joint(k).upper);
    GravityTorque(m, w, q, g);
    largest = largest.cwiseMax(g.cwiseAbs());
  }
  const double known[6] = {0.0, 12.43, 4.76, 1.96, 0.90, 0.001};
  for (int k = 0; k < 6; ++k) EXPECT_NEAR(largest[k], known[k], 0.03 * known[k] + 1e-3) << k;
}

TEST(Dynamics, NonFiniteInputGivesNonFiniteOutput) {
  const model::RobotModel mico = MicoArm();
  Mechanism m(mico);
  Workspace w;
  VectorXd q = VectorXd::Zero(6), zero = VectorXd::Zero(6), tau(6);
  q[2] = std::numeric_limits<double>::quiet_NaN();
  Rnea(m, w, q, zero, zero, tau);
  EXPECT_FALSE(tau.allFinite());
  q[2] = 0.0;
  Rnea(m, w, q, zero, zero, tau);  // nothing of it stays behind
  EXPECT_TRUE(tau.allFinite());
}

TEST(Dynamics, CostsNothingInAccuracyForAnglesThatWoundUp) {
  const model::RobotModel mico = MicoArm();
  Mechanism m(mico);
  Workspace w;
  Rng rng(4);
  const RandomState s = DrawState(rng, 6);
  const VectorXd far = s.q.array() + 2000.0 * M_PI;
  EXPECT_LT(RelativeError(InverseDynamicsOf(m, w, far, s.v, s.a), InverseDynamicsOf(m, w, s.q, s.v, s.a)),
            1e-11);
}

TEST(DynamicsDeathTest, WrongShapesAreBugs) {
  const model::RobotModel mico = MicoArm();
  const Mechanism m(mico);
  Workspace w;
  VectorXd five(5), six = VectorXd::Zero(6);
  EXPECT_DEATH(Rnea(m, w, six, six, six, five), "5 entries, 6 expected");
}

}  // namespace
}  // namespace rg::dynamics
