// The kernels for T = double, compiled once per instruction set (rg_isa_sources).
#include <new>

#include "common/dynamics/aba_kernel.h"
#include "common/dynamics/kernel_table.h"
#include "common/dynamics/kernels.h"
#include "common/math/dense_kernels.h"

namespace rg::dynamics {
inline namespace RG_ISA {
namespace {

using Space = KernelWorkspace<double, kMaxBodies>;
using BodyInertia = Inertias<double, kMaxBodies>;
static_assert(sizeof(BodyInertia) == sizeof(InertiaRows));

Space& AsSpace(void* workspace) { return *static_cast<Space*>(workspace); }
const BodyInertia& AsInertias(const InertiaRows& rows) { return reinterpret_cast<const BodyInertia&>(rows); }

template <int C>
void CopyOut(int n, const Row<double, C>& from, double* to) {
  for (int k = 0; k < n; ++k) to[k] = from[k];
}

template <int C>
void CopyOut(int n, const Row<double, C>* columns, int count, double* to, ptrdiff_t ld) {
  for (int j = 0; j < count; ++j) CopyOut(n, columns[j], to + j * ld);
}

void Init(void* workspace) { new (workspace) Space(); }

void SetBody(InertiaRows& rows, int body, const double* phi) {
  reinterpret_cast<BodyInertia&>(rows).Set(body, phi);
}

void Rnea(const Tree& tree, const InertiaRows& inertias, const double* gravity, const double* q,
          const double* v, const double* a, void* workspace, double* tau) {
  Space& w = AsSpace(workspace);
  InverseDynamics(tree, AsInertias(inertias), gravity, q, v, a, w);
  CopyOut(tree.n, w.tau, tau);
}

void Crba(const Tree& tree, const InertiaRows& inertias, const double* q, void* workspace, double* M,
          ptrdiff_t ld) {
  Space& w = AsSpace(workspace);
  CompositeRigidBody(tree, AsInertias(inertias), q, w);
  CopyOut(tree.n, w.M, tree.n, M, ld);
}

void MassMatrixAndBias(const Tree& tree, const InertiaRows& inertias, const double* gravity, const double* q,
                       const double* v, void* workspace, double* M, ptrdiff_t ld, double* c) {
  Space& w = AsSpace(workspace);
  Terms(tree, AsInertias(inertias), gravity, q, v, w);
  CopyOut(tree.n, w.M, tree.n, M, ld);
  CopyOut(tree.n, w.c, c);
}

void InverseDerivatives(const Tree& tree, const double* a, void* workspace, double* dtau_dq, ptrdiff_t ld_q,
                        double* dtau_dv, ptrdiff_t ld_v, double* tau) {
  Space& w = AsSpace(workspace);
  SetAcceleration(tree, a, w);
  Derivatives(tree, w);
  CopyOut(tree.n, w.dtau_dq, tree.n, dtau_dq, ld_q);
  CopyOut(tree.n, w.dtau_dv, tree.n, dtau_dv, ld_v);
  if (tau != nullptr) CopyOut(tree.n, w.tau, tau);
}

void GravityDerivative(const Tree& tree, void* workspace, double* dtau_dg, ptrdiff_t ld) {
  const Space& w = AsSpace(workspace);
  for (int k = 0; k < tree.n; ++k) {
    dtau_dg[k] = -w.F.lin.x[k];
    dtau_dg[k + ld] = -w.F.lin.y[k];
    dtau_dg[k + 2 * ld] = -w.F.lin.z[k];
  }
}

void TorqueRegressor(const Tree& tree, const double* gravity, const double* q, const double* v,
                     const double* a, void* workspace, double* Y, ptrdiff_t ld) {
  Space& w = AsSpace(workspace);
  CopyIn(tree.n, q, w.q);
  CopyIn(tree.n, v, w.v);
  Kinematics(tree, w);
  Velocities(tree, gravity, w);
  SetAcceleration(tree, a, w);
  Regressor(tree, w);
  for (int k = 0; k < tree.n; ++k) CopyOut(tree.n, w.Y[k], 10, Y + 10 * k * ld, ld);
}

void Aba(const Tree& tree, const InertiaRows& inertias, const double* gravity, const double* q,
         const double* v, const double* tau, void* workspace, double* a) {
  Space& w = AsSpace(workspace);
  ForwardDynamics(tree, AsInertias(inertias), gravity, q, v, tau, w);
  CopyOut(tree.n, w.a, a);
}

// da = M⁻¹ (dtau - d(M a + c)): the derivatives of inverse dynamics at the solution, times -M⁻¹.
void AbaDerivatives(const Tree& tree, const InertiaRows& inertias, const double* gravity, const double* q,
                    const double* v, const double* tau, void* workspace, double* a, double* da_dq,
                    ptrdiff_t ld_q, double* da_dv, ptrdiff_t ld_v, double* da_dtau, ptrdiff_t ld_tau) {
  Space& w = AsSpace(workspace);
  Terms(tree, AsInertias(inertias), gravity, q, v, w);
  math::InvertSpd(tree.n, w.M);
  Row<double, kMaxBodies> force, acceleration, column;
  for (int k = 0; k < tree.n; ++k) force[k] = tau[k] - w.c[k];
  math::MatrixTimes(tree.n, w.M, force, acceleration);
  CopyOut(tree.n, acceleration, a);
  SetAcceleration(tree, a, w);
  Derivatives(tree, w);
  for (int j = 0; j < tree.n; ++j) {
    math::MatrixTimes(tree.n, w.M, w.dtau_dq[j], column);
    for (int k = 0; k < tree.n; ++k) da_dq[j * ld_q + k] = -column[k];
    math::MatrixTimes(tree.n, w.M, w.dtau_dv[j], column);
    for (int k = 0; k < tree.n; ++k) da_dv[j * ld_v + k] = -column[k];
  }
  CopyOut(tree.n, w.M, tree.n, da_dtau, ld_tau);
}

void Poses(const Tree& tree, const double* q, void* workspace, double* out) {
  Space& w = AsSpace(workspace);
  CopyIn(tree.n, q, w.q);
  Kinematics(tree, w);
  for (int k = 0; k < tree.n; ++k, out += 12) {
    const Mat3<double> R = w.R.At(k);
    const Vec3<double> p = w.p.At(k);
    const Vec3<double> columns[4] = {R.x, R.y, R.z, p};
    for (int i = 0; i < 4; ++i) {
      out[3 * i] = columns[i].x;
      out[3 * i + 1] = columns[i].y;
      out[3 * i + 2] = columns[i].z;
    }
  }
}

void StepTerms(const Tree& tree, const InertiaRows& inertias, const double* gravity, const double* q,
               const double* v, const double* a, void* workspace) {
  Space& w = AsSpace(workspace);
  Terms(tree, AsInertias(inertias), gravity, q, v, w);
  SetAcceleration(tree, a, w);
  Derivatives(tree, w);
  Regressor(tree, w);
}

}  // namespace

extern const KernelTable kDoubleKernels;
const KernelTable kDoubleKernels = {
    .workspace_bytes = sizeof(Space),
    .init = Init,
    .set_body = SetBody,
    .rnea = Rnea,
    .crba = Crba,
    .terms = MassMatrixAndBias,
    .derivatives = InverseDerivatives,
    .gravity_derivative = GravityDerivative,
    .regressor = TorqueRegressor,
    .aba = Aba,
    .aba_derivatives = AbaDerivatives,
    .poses = Poses,
    .step_terms = StepTerms,
};

}  // namespace RG_ISA
}  // namespace rg::dynamics
