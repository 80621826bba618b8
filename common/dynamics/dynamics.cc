#include "common/dynamics/dynamics.h"

#include "common/base/check.h"
#include "common/dynamics/mechanism_impl.h"

namespace rg::dynamics {

void* Scratch(const Mechanism::Impl& mechanism, Workspace::Impl& workspace) {
  if (workspace.kernels != mechanism.kernels) {
    const size_t bytes = mechanism.kernels->workspace_bytes;
    workspace.memory.reset(static_cast<std::byte*>(::operator new[](bytes, std::align_val_t{64})));
    mechanism.kernels->init(workspace.memory.get());
    workspace.kernels = mechanism.kernels;
  }
  return workspace.memory.get();
}

namespace {

void CheckSize(Eigen::Index size, Eigen::Index expected) {
  RG_CHECK(size == expected) << "vector has " << size << " entries, " << expected << " expected";
}

void CheckShape(const MatrixOut& matrix, Eigen::Index rows, Eigen::Index columns) {
  RG_CHECK(matrix.rows() == rows && matrix.cols() == columns)
      << "matrix is " << matrix.rows() << "x" << matrix.cols() << ", " << rows << "x" << columns
      << " expected";
}

}  // namespace

Mechanism::Mechanism(const model::RobotModel& model, math::Isa isa) : impl_(std::make_unique<Impl>()) {
  impl_->tree = MakeTree(model);
  impl_->kernels = &GetKernels(isa);
  impl_->gravity = Eigen::Vector3d(0.0, 0.0, -9.81);
  SetLinkParameters(model, model.NominalLinkParameters());
}

Mechanism::~Mechanism() = default;
Mechanism::Mechanism(const Mechanism& other) : impl_(std::make_unique<Impl>(*other.impl_)) {}
Mechanism& Mechanism::operator=(const Mechanism& other) {
  *impl_ = *other.impl_;
  return *this;
}

int Mechanism::num_joints() const { return impl_->tree.n; }
const Eigen::Vector3d& Mechanism::gravity() const { return impl_->gravity; }
void Mechanism::SetGravity(const Eigen::Vector3d& gravity_W) { impl_->gravity = gravity_W; }
const BodyParameters& Mechanism::body_parameters() const { return impl_->parameters; }

void Mechanism::SetBodyParameters(const BodyParameters& parameters) {
  RG_CHECK(parameters.cols() == num_joints()) << parameters.cols();
  impl_->parameters = parameters;
  for (int k = 0; k < num_joints(); ++k)
    impl_->kernels->set_body(impl_->inertias, k, parameters.col(k).data());
}

void Mechanism::SetLinkParameters(const model::RobotModel& model, const LinkParametersMatrix& links) {
  SetBodyParameters(LumpedInertias(model, links));
}

Workspace::Workspace() : impl_(std::make_unique<Impl>()) {}
Workspace::~Workspace() = default;
Workspace::Workspace(Workspace&&) noexcept = default;
Workspace& Workspace::operator=(Workspace&&) noexcept = default;

void Rnea(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
          const VectorIn& a, VectorOut tau) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), a.size(), tau.size()}) CheckSize(size, m.tree.n);
  m.kernels->rnea(m.tree, m.inertias, m.gravity.data(), q.data(), v.data(), a.data(),
                  Scratch(m, workspace.impl()), tau.data());
}

void GravityTorque(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, VectorOut tau) {
  const Mechanism::Impl& m = mechanism.impl();
  CheckSize(q.size(), m.tree.n);
  CheckSize(tau.size(), m.tree.n);
  const double zero[kMaxBodies] = {};
  m.kernels->rnea(m.tree, m.inertias, m.gravity.data(), q.data(), zero, zero, Scratch(m, workspace.impl()),
                  tau.data());
}

void Crba(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, MatrixOut M) {
  const Mechanism::Impl& m = mechanism.impl();
  CheckSize(q.size(), m.tree.n);
  CheckShape(M, m.tree.n, m.tree.n);
  m.kernels->crba(m.tree, m.inertias, q.data(), Scratch(m, workspace.impl()), M.data(), M.outerStride());
}

void MassMatrixAndBias(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                       MatrixOut M, VectorOut c) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), c.size()}) CheckSize(size, m.tree.n);
  CheckShape(M, m.tree.n, m.tree.n);
  m.kernels->terms(m.tree, m.inertias, m.gravity.data(), q.data(), v.data(), Scratch(m, workspace.impl()),
                   M.data(), M.outerStride(), c.data());
}

void Aba(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
         const VectorIn& tau, VectorOut a) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), tau.size(), a.size()}) CheckSize(size, m.tree.n);
  m.kernels->aba(m.tree, m.inertias, m.gravity.data(), q.data(), v.data(), tau.data(),
                 Scratch(m, workspace.impl()), a.data());
}

void RneaDerivatives(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                     const VectorIn& a, MatrixOut dtau_dq, MatrixOut dtau_dv) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), a.size()}) CheckSize(size, m.tree.n);
  CheckShape(dtau_dq, m.tree.n, m.tree.n);
  CheckShape(dtau_dv, m.tree.n, m.tree.n);
  void* scratch = Scratch(m, workspace.impl());
  double M[kMaxBodies * kMaxBodies], c[kMaxBodies];
  m.kernels->terms(m.tree, m.inertias, m.gravity.data(), q.data(), v.data(), scratch, M, kMaxBodies, c);
  m.kernels->derivatives(m.tree, a.data(), scratch, dtau_dq.data(), dtau_dq.outerStride(), dtau_dv.data(),
                         dtau_dv.outerStride(), nullptr);
}

void RneaGravityDerivative(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                           MatrixOut dtau_dg) {
  const Mechanism::Impl& m = mechanism.impl();
  CheckSize(q.size(), m.tree.n);
  CheckShape(dtau_dg, m.tree.n, 3);
  void* scratch = Scratch(m, workspace.impl());
  double M[kMaxBodies * kMaxBodies];
  m.kernels->crba(m.tree, m.inertias, q.data(), scratch, M, kMaxBodies);
  m.kernels->gravity_derivative(m.tree, scratch, dtau_dg.data(), dtau_dg.outerStride());
}

void AbaDerivatives(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                    const VectorIn& tau, VectorOut a, MatrixOut da_dq, MatrixOut da_dv, MatrixOut da_dtau) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), tau.size(), a.size()}) CheckSize(size, m.tree.n);
  for (const MatrixOut* matrix : {&da_dq, &da_dv, &da_dtau}) CheckShape(*matrix, m.tree.n, m.tree.n);
  m.kernels->aba_derivatives(m.tree, m.inertias, m.gravity.data(), q.data(), v.data(), tau.data(),
                             Scratch(m, workspace.impl()), a.data(), da_dq.data(), da_dq.outerStride(),
                             da_dv.data(), da_dv.outerStride(), da_dtau.data(), da_dtau.outerStride());
}

void TorqueRegressor(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                     const VectorIn& a, MatrixOut Y) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), a.size()}) CheckSize(size, m.tree.n);
  CheckShape(Y, m.tree.n, 10 * m.tree.n);
  m.kernels->regressor(m.tree, m.gravity.data(), q.data(), v.data(), a.data(), Scratch(m, workspace.impl()),
                       Y.data(), Y.outerStride());
}

}  // namespace rg::dynamics
