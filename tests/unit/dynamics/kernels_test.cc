// The kernel templates: instruction sets and lanes give the same numbers.
#include "common/dynamics/kernels.h"

#include <gtest/gtest.h>

#include <memory>

#include "common/dynamics/aba_kernel.h"
#include "common/dynamics/dynamics.h"
#include "common/math/dense_kernels.h"
#include "tests/unit/dynamics/robots.h"

namespace rg::dynamics {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

double Distance(const MatrixXd& a, const MatrixXd& b) {
  return (a - b).cwiseAbs().maxCoeff() / std::max(1.0, b.cwiseAbs().maxCoeff());
}

TEST(Kernels, AgreeBetweenInstructionSets) {
  Rng rng(21);
  for (const model::RobotModel& model : AllRobots()) {
    const int n = model.num_joints();
    const RandomState s = DrawState(rng, n);
    const Mechanism plain(model, math::Isa::kV1);
    Workspace w;
    VectorXd a(n), tau(n), c(n);
    MatrixXd dq(n, n), dv(n, n), dtau(n, n), M(n, n), Y(n, 10 * n);
    AbaDerivatives(plain, w, s.q, s.v, s.a, a, dq, dv, dtau);
    Rnea(plain, w, s.q, s.v, s.a, tau);
    MassMatrixAndBias(plain, w, s.q, s.v, M, c);
    TorqueRegressor(plain, w, s.q, s.v, s.a, Y);
    for (math::Isa isa : {math::Isa::kV3, math::Isa::kV4}) {
      if (!math::IsaSupported(isa)) continue;
      SCOPED_TRACE(model.name() + " on " + math::IsaName(isa));
      const Mechanism wide(model, isa);
      VectorXd a2(n), tau2(n), c2(n);
      MatrixXd dq2(n, n), dv2(n, n), dtau2(n, n), M2(n, n), Y2(n, 10 * n);
      AbaDerivatives(wide, w, s.q, s.v, s.a, a2, dq2, dv2, dtau2);
      Rnea(wide, w, s.q, s.v, s.a, tau2);
      MassMatrixAndBias(wide, w, s.q, s.v, M2, c2);
      TorqueRegressor(wide, w, s.q, s.v, s.a, Y2);
      EXPECT_LT(Distance(tau2, tau), 1e-12);
      EXPECT_LT(Distance(c2, c), 1e-12);
      EXPECT_LT(Distance(M2, M), 1e-12);
      EXPECT_LT(Distance(Y2, Y), 1e-12);
      EXPECT_LT(Distance(a2, a), 1e-10);  // times the condition of M
      EXPECT_LT(Distance(dq2, dq), 1e-10);
      EXPECT_LT(Distance(dv2, dv), 1e-10);
      EXPECT_LT(Distance(dtau2, dtau), 1e-10);
    }
  }
}

// Every lane has its own state, gravity and inertias.
template <int N, int Capacity>
void CompareLanesWithScalar(const model::RobotModel& model) {
  using T = math::Lanes<N>;
  const int n = model.num_joints();
  const Tree tree = MakeTree(model);
  auto lanes = std::make_unique<KernelWorkspace<T, Capacity>>();
  auto inertias = std::make_unique<Inertias<T, Capacity>>();
  T q[Capacity], v[Capacity], a[Capacity], gravity[3];
  std::vector<RandomState> states;
  std::vector<BodyParameters> bodies;
  const BodyParameters nominal = LumpedInertias(model, model.NominalLinkParameters());
  Rng rng(31);
  for (int lane = 0; lane < N; ++lane) {
    states.push_back(DrawState(rng, n));
    bodies.push_back(nominal * rng.Uniform(0.8, 1.2));
    for (int i = 0; i < 3; ++i) gravity[i].Set(lane, i - 3.0 - lane);
    for (int k = 0; k < n; ++k) {
      q[k].Set(lane, states[lane].q[k]);
      v[k].Set(lane, states[lane].v[k]);
      a[k].Set(lane, states[lane].a[k]);
    }
  }
  for (int k = 0; k < n; ++k) {
    T phi[10];
    for (int i = 0; i < 10; ++i) {
      for (int lane = 0; lane < N; ++lane) phi[i].Set(lane, bodies[lane](i, k));
    }
    inertias->Set(k, phi);
  }
  Terms(tree, *inertias, gravity, q, v, *lanes);
  SetAcceleration(tree, a, *lanes);
  Derivatives(tree, *lanes);
  Regressor(tree, *lanes);
  Mechanism m(model, math::Isa::kV1);
  Workspace w;
  for (int lane = 0; lane < N; ++lane) {
    const RandomState& s = states[lane];
    m.SetBodyParameters(bodies[lane]);
    m.SetGravity(Eigen::Vector3d(gravity[0][lane], gravity[1][lane], gravity[2][lane]));
    MatrixXd M(n, n), dq(n, n), dv(n, n), Y(n, 10 * n), M2(n, n), dq2(n, n), dv2(n, n), Y2(n, 10 * n);
    VectorXd c(n), tau(n), c2(n), tau2(n);
    MassMatrixAndBias(m, w, s.q, s.v, M, c);
    RneaDerivatives(m, w, s.q, s.v, s.a, dq, dv);
    TorqueRegressor(m, w, s.q, s.v, s.a, Y);
    Rnea(m, w, s.q, s.v, s.a, tau);
    for (int r = 0; r < n; ++r) {
      c2[r] = lanes->c[r][lane];
      tau2[r] = lanes->tau[r][lane];
      for (int j = 0; j < n; ++j) {
        M2(r, j) = lanes->M[j][r][lane];
        dq2(r, j) = lanes->dtau_dq[j][r][lane];
        dv2(r, j) = lanes->dtau_dv[j][r][lane];
        for (int i = 0; i < 10; ++i) Y2(r, 10 * j + i) = lanes->Y[j][i][r][lane];
      }
    }
    EXPECT_LT(Distance(M2, M), 1e-12);
    EXPECT_LT(Distance(c2, c), 1e-12);
    EXPECT_LT(Distance(tau2, tau), 1e-11);
    EXPECT_LT(Distance(dq2, dq), 1e-12);
    EXPECT_LT(Distance(dv2, dv), 1e-12);
    EXPECT_LT(Distance(Y2, Y), 1e-12);
  }
  // Forward dynamics of all lanes at once.
  T tau[Capacity];
  for (int k = 0; k < n; ++k) tau[k] = lanes->tau[k];
  ForwardDynamics(tree, *inertias, gravity, q, v, tau, *lanes);
  for (int lane = 0; lane < N; ++lane) {
    for (int k = 0; k < n; ++k) EXPECT_NEAR(lanes->a[k][lane], states[lane].a[k], 1e-8);
  }
}

TEST(Kernels, LanesComputeWhatScalarsDo) {
  CompareLanesWithScalar<2, 8>(MicoArm());
  CompareLanesWithScalar<4, 8>(LoadRobot("slide.urdf"));
  CompareLanesWithScalar<2, 16>(RandomTree(Rng(9), 12));
}

TEST(InvertSpd, MatchesEigenAndFindsIndefiniteMatrices) {
  Rng rng(8);
  for (int n : {1, 2, 5, 8}) {
    MatrixXd A = MatrixXd::Zero(n, n);
    for (int i = 0; i < 2 * n; ++i) {
      const VectorXd x = RandomVector(rng, n);
      A += x * x.transpose();
    }
    math::Row<double, 8> columns[8];
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) columns[j][i] = A(i, j);
    }
    EXPECT_GT(math::InvertSpd(n, columns), 0.0);
    MatrixXd inverse(n, n);
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) inverse(i, j) = columns[j][i];
    }
    EXPECT_LT(Distance(inverse * A, MatrixXd::Identity(n, n)), 1e-9);
  }
  math::Row<double, 8> indefinite[8];
  indefinite[0][0] = indefinite[1][1] = 1.0;
  indefinite[0][1] = indefinite[1][0] = 2.0;
  EXPECT_LT(math::InvertSpd(2, indefinite), 0.0);
}

}  // namespace
}  // namespace rg::dynamics
