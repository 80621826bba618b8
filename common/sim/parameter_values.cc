#include "common/sim/parameter_values.h"

#include "common/base/check.h"
#include "common/effects/gravity_misalignment.h"
#include "common/effects/payload.h"
#include "common/effects/sloshing_payload.h"

namespace rg::sim::internal {
namespace {

using effects::Dual;
using Where = ParameterUse::Where;

// Barycentric parameters about the origin of frame L, in the frame B with X_BL.
template <class S>
void MoveInertia(const model::Pose& X_BL, const S* local, S* moved) {
  const auto& R = X_BL.rotation;
  const auto& p = X_BL.translation;
  const S I[3][3] = {
      {local[4], local[5], local[6]}, {local[5], local[7], local[8]}, {local[6], local[8], local[9]}};
  S h[3], turned[3][3];
  for (int i = 0; i < 3; ++i) {
    h[i] = R(i, 0) * local[1] + R(i, 1) * local[2] + R(i, 2) * local[3];
    for (int j = 0; j < 3; ++j) {
      turned[i][j] = S(0.0);
      for (int a = 0; a < 3; ++a) {
        for (int b = 0; b < 3; ++b) turned[i][j] += (R(i, a) * R(j, b)) * I[a][b];
      }
    }
  }
  // About B: Σ m (|r|² 1 − r rᵀ) with r = p + R r_L.
  const S trace = local[0] * p.squaredNorm() + 2.0 * (p[0] * h[0] + p[1] * h[1] + p[2] * h[2]);
  auto entry = [&](int i, int j) {
    const S shift = local[0] * (p[i] * p[j]) + p[i] * h[j] + p[j] * h[i];
    return i == j ? S(turned[i][j] + trace - shift) : S(turned[i][j] - shift);
  };
  moved[0] = local[0];
  for (int i = 0; i < 3; ++i) moved[1 + i] = h[i] + local[0] * p[i];
  moved[4] = entry(0, 0);
  moved[5] = entry(0, 1);
  moved[6] = entry(0, 2);
  moved[7] = entry(1, 1);
  moved[8] = entry(1, 2);
  moved[9] = entry(2, 2);
}

}  // namespace

ParameterValues::ParameterValues(const PlantData& plant)
    : plant_(plant), joint_(plant.num_joint_parameters, 0.0), point_(plant.num_point_parameters, 0.0) {
  links_ = plant.tree_model->NominalLinkParameters();
  const model::Link& link = plant.tree_model->link(plant.PayloadLink());
  payload_body_ = link.body;
  payload_frame_ = link.X_BL;
  // What the URDF says of a follower's own joint is no parameter.
  for (int i = 0; i < plant.program.tree.num_ties; ++i) {
    const int k = plant.program.tree.ties[i].follower;
    const int first = plant.program.joints[k].first_parameter;
    joint_[first + integrators::kDamping] = plant.KernelJoint(k).damping;
    joint_[first + integrators::kFriction] = plant.KernelJoint(k).friction;
  }
}

void ParameterValues::Set(const Eigen::VectorXd& values) {
  RG_CHECK(values.size() == plant_.table.size());
  values_ = values;
  // A flexible base and a sloshing mass have no drive: gains of extra joints stay zero.
  for (int i = 0; i < plant_.table.size(); ++i) {
    for (const ParameterUse& use : plant_.uses[i]) {
      switch (use.where) {
        case Where::kLink:
          links_(use.b, use.a) = values[i];
          break;
        case Where::kLaw:
          joint_[plant_.program.joints[use.a].first_parameter + use.b] = values[i];
          break;
        case Where::kPoint:
          point_[plant_.program.point_forces[use.a].first_parameter + use.b] = values[i];
          break;
        default:
          break;
      }
    }
  }
  SetInertias();
  SetGravity();
}

void ParameterValues::SetInertias() {
  phi_ = dynamics::LumpedInertias(*plant_.tree_model, links_);
  if (plant_.rod.hinge >= 0) SetRodInertia();
  if (plant_.payload < 0) return;
  using D = Dual<double, 4>;
  D p[4], local[10] = {}, moved[10];
  for (int i = 0; i < 4; ++i) p[i] = D::Variable(values_[plant_.payload + i], i);
  effects::Payload::AddInertia(p, local);
  MoveInertia(payload_frame_, local, moved);
  for (int i = 0; i < 10; ++i) {
    phi_(i, payload_body_) += moved[i].v;
    for (int k = 0; k < 4; ++k) phi_by_payload_(i, k) = moved[i].d[k];
  }
}

void ParameterValues::SetRodInertia() {
  using D = Dual<double, 3>;
  const Rod& rod = plant_.rod;
  const model::Link& link = plant_.tree_model->link(rod.link);
  D p[3], local[10] = {}, moved[10];
  for (int i = 0; i < 3; ++i) p[i] = D::Variable(values_[rod.parameters[i]], i);
  effects::SloshingPayload::AddRodInertia(p, rod.hinge, local);
  MoveInertia(link.X_BL, local, moved);
  for (int i = 0; i < 10; ++i) {
    phi_(i, link.body) = moved[i].v;
    for (int k = 0; k < 3; ++k) phi_by_rod_(i, k) = moved[i].d[k];
  }
}

void ParameterValues::SetGravity() {
  using D = Dual<double, 6>;
  D g[3], turn[2] = {D(0.0), D(0.0)};
  for (int i = 0; i < 3; ++i) g[i] = D::Variable(values_[i], i);
  if (plant_.gravity_turn >= 0) {
    for (int i = 0; i < 2; ++i) turn[i] = D::Variable(values_[plant_.gravity_turn + i], 3 + i);
    effects::GravityMisalignment::Turn(turn, g);
  }
  for (int i = 0; i < 3; ++i) {
    gravity_[i] = g[i].v;
    for (int k = 0; k < 3; ++k) gravity_by_axes_(i, k) = g[i].d[k];
    for (int k = 0; k < 2; ++k) gravity_by_turn_(i, k) = g[i].d[3 + k];
  }
}

Eigen::Vector3d ParameterValues::GravityDirection(int parameter) const {
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  for (const ParameterUse& use : plant_.uses[parameter]) {
    if (use.where == Where::kGravity) direction += gravity_by_axes_.col(use.a);
    if (use.where == Where::kGravityTurn) direction += gravity_by_turn_.col(use.b);
  }
  return direction;
}

int ParameterValues::InertiaDirection(int parameter, Eigen::Matrix<double, 10, 1>* direction) const {
  for (const ParameterUse& use : plant_.uses[parameter]) {
    if (use.where == Where::kPayload) {
      *direction = phi_by_payload_.col(use.b);
      return payload_body_;
    }
    if (use.where == Where::kRod) {
      *direction = phi_by_rod_.col(use.b);
      return plant_.tree_model->link(plant_.rod.link).body;
    }
    if (use.where == Where::kLink) {
      const int body = plant_.tree_model->link(use.a).body;
      if (body < 0) return -1;
      *direction = dynamics::LumpingJacobian(*plant_.tree_model, use.a, links_.col(use.a)).col(use.b);
      return body;
    }
  }
  return -1;
}

}  // namespace rg::sim::internal
