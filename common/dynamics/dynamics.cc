#include "common/dynamics/dynamics.h"

#include <Eigen/Cholesky>

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

using Eigen::MatrixXd;
using Eigen::VectorXd;

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
  impl_->plain = impl_->tree.num_ties == 0;
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

int Mechanism::num_joints() const { return impl_->n(); }
int Mechanism::num_bodies() const { return impl_->tree.n; }
const Eigen::Vector3d& Mechanism::gravity() const { return impl_->gravity; }
void Mechanism::SetGravity(const Eigen::Vector3d& gravity_W) { impl_->gravity = gravity_W; }
const BodyParameters& Mechanism::body_parameters() const { return impl_->parameters; }

void Mechanism::SetBodyParameters(const BodyParameters& parameters) {
  RG_CHECK(parameters.cols() == num_bodies()) << parameters.cols();
  impl_->parameters = parameters;
  for (int k = 0; k < num_bodies(); ++k)
    impl_->kernels->set_body(impl_->inertias, k, parameters.col(impl_->tree.body[k]).data());
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
  for (Eigen::Index size : {q.size(), v.size(), a.size(), tau.size()}) CheckSize(size, m.n());
  void* scratch = Scratch(m, workspace.impl());
  const auto run = [&](const double* x, const double* rate, const double* acceleration, double* out) {
    m.kernels->rnea(m.tree, m.inertias, m.gravity.data(), x, rate, acceleration, scratch, out);
  };
  if (m.plain) return run(q.data(), v.data(), a.data(), tau.data());
  const Unfolded all(m.tree);
  VectorXd full(m.tree.n);
  run(all.Position(q).data(), all.Rate(v).data(), all.Rate(a).data(), full.data());
  all.FoldRows(full, tau);
}

void GravityTorque(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, VectorOut tau) {
  const double zero[kMaxBodies] = {};
  const Eigen::Map<const VectorXd> none(zero, mechanism.num_joints());
  Rnea(mechanism, workspace, q, none, none, tau);
}

void Crba(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, MatrixOut M) {
  const Mechanism::Impl& m = mechanism.impl();
  CheckSize(q.size(), m.n());
  CheckShape(M, m.n(), m.n());
  void* scratch = Scratch(m, workspace.impl());
  if (m.plain) {
    m.kernels->crba(m.tree, m.inertias, q.data(), scratch, M.data(), M.outerStride());
    return;
  }
  const Unfolded all(m.tree);
  MatrixXd full(m.tree.n, m.tree.n);
  m.kernels->crba(m.tree, m.inertias, all.Position(q).data(), scratch, full.data(), full.outerStride());
  all.Fold(full, M);
}

void MassMatrixAndBias(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                       MatrixOut M, VectorOut c) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), c.size()}) CheckSize(size, m.n());
  CheckShape(M, m.n(), m.n());
  void* scratch = Scratch(m, workspace.impl());
  const auto run = [&](const double* x, const double* rate, double* mass, ptrdiff_t ld, double* bias) {
    m.kernels->terms(m.tree, m.inertias, m.gravity.data(), x, rate, scratch, mass, ld, bias);
  };
  if (m.plain) return run(q.data(), v.data(), M.data(), M.outerStride(), c.data());
  const Unfolded all(m.tree);
  MatrixXd full(m.tree.n, m.tree.n);
  VectorXd bias(m.tree.n);
  run(all.Position(q).data(), all.Rate(v).data(), full.data(), full.outerStride(), bias.data());
  all.Fold(full, M);
  all.FoldRows(bias, c);
}

void Aba(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
         const VectorIn& tau, VectorOut a) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), tau.size(), a.size()}) CheckSize(size, m.n());
  if (m.plain) {
    m.kernels->aba(m.tree, m.inertias, m.gravity.data(), q.data(), v.data(), tau.data(),
                   Scratch(m, workspace.impl()), a.data());
    return;
  }
  // The recursion is of trees; joints that follow others close loops in it.
  MatrixXd M(m.n(), m.n());
  VectorXd c(m.n());
  MassMatrixAndBias(mechanism, workspace, q, v, M, c);
  a = M.llt().solve(tau - c);
}

void RneaDerivatives(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                     const VectorIn& a, MatrixOut dtau_dq, MatrixOut dtau_dv) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), a.size()}) CheckSize(size, m.n());
  CheckShape(dtau_dq, m.n(), m.n());
  CheckShape(dtau_dv, m.n(), m.n());
  void* scratch = Scratch(m, workspace.impl());
  const auto run = [&](const double* x, const double* rate, const double* acceleration, auto& by_q,
                       auto& by_v) {
    double M[kMaxBodies * kMaxBodies], c[kMaxBodies];
    m.kernels->terms(m.tree, m.inertias, m.gravity.data(), x, rate, scratch, M, kMaxBodies, c);
    m.kernels->derivatives(m.tree, acceleration, scratch, by_q.data(), by_q.outerStride(), by_v.data(),
                           by_v.outerStride(), nullptr);
  };
  if (m.plain) return run(q.data(), v.data(), a.data(), dtau_dq, dtau_dv);
  const Unfolded all(m.tree);
  MatrixXd by_q(m.tree.n, m.tree.n), by_v(m.tree.n, m.tree.n);
  run(all.Position(q).data(), all.Rate(v).data(), all.Rate(a).data(), by_q, by_v);
  all.Fold(by_q, dtau_dq);
  all.Fold(by_v, dtau_dv);
}

void RneaGravityDerivative(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                           MatrixOut dtau_dg) {
  const Mechanism::Impl& m = mechanism.impl();
  CheckSize(q.size(), m.n());
  CheckShape(dtau_dg, m.n(), 3);
  void* scratch = Scratch(m, workspace.impl());
  const auto run = [&](const double* x, auto& by_g) {
    double M[kMaxBodies * kMaxBodies];
    m.kernels->crba(m.tree, m.inertias, x, scratch, M, kMaxBodies);
    m.kernels->gravity_derivative(m.tree, scratch, by_g.data(), by_g.outerStride());
  };
  if (m.plain) return run(q.data(), dtau_dg);
  const Unfolded all(m.tree);
  MatrixXd full(m.tree.n, 3);
  run(all.Position(q).data(), full);
  all.FoldRows(full, dtau_dg);
}

void AbaDerivatives(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                    const VectorIn& tau, VectorOut a, MatrixOut da_dq, MatrixOut da_dv, MatrixOut da_dtau) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), tau.size(), a.size()}) CheckSize(size, m.n());
  for (const MatrixOut* matrix : {&da_dq, &da_dv, &da_dtau}) CheckShape(*matrix, m.n(), m.n());
  if (m.plain) {
    m.kernels->aba_derivatives(m.tree, m.inertias, m.gravity.data(), q.data(), v.data(), tau.data(),
                               Scratch(m, workspace.impl()), a.data(), da_dq.data(), da_dq.outerStride(),
                               da_dv.data(), da_dv.outerStride(), da_dtau.data(), da_dtau.outerStride());
    return;
  }
  Aba(mechanism, workspace, q, v, tau, a);
  MatrixXd M(m.n(), m.n()), by_q(m.n(), m.n()), by_v(m.n(), m.n());
  Crba(mechanism, workspace, q, M);
  RneaDerivatives(mechanism, workspace, q, v, a, by_q, by_v);
  da_dtau = M.llt().solve(MatrixXd::Identity(m.n(), m.n()));
  da_dq = -da_dtau * by_q;
  da_dv = -da_dtau * by_v;
}

void TorqueRegressor(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                     const VectorIn& a, MatrixOut Y) {
  const Mechanism::Impl& m = mechanism.impl();
  for (Eigen::Index size : {q.size(), v.size(), a.size()}) CheckSize(size, m.n());
  CheckShape(Y, m.n(), 10 * m.tree.n);
  void* scratch = Scratch(m, workspace.impl());
  const auto run = [&](const double* x, const double* rate, const double* acceleration, auto& out) {
    m.kernels->regressor(m.tree, m.gravity.data(), x, rate, acceleration, scratch, out.data(),
                         out.outerStride());
  };
  if (m.plain) return run(q.data(), v.data(), a.data(), Y);
  const Unfolded all(m.tree);
  MatrixXd full(m.tree.n, 10 * m.tree.n);
  run(all.Position(q).data(), all.Rate(v).data(), all.Rate(a).data(), full);
  for (int k = 0; k < m.tree.n; ++k)
    all.FoldRows(full.middleCols(10 * k, 10), Y.middleCols(10 * m.tree.body[k], 10));
}

}  // namespace rg::dynamics
