// Rigid-body dynamics of a RobotModel: the algorithms of the literature as free functions.
//
//   M(q) q̈ + c(q, v, g) = tau          n equations, joint order of RobotModel
//
// Joints that follow others (model::Follower) have no equation of their own: their bodies' forces are in
// their drivers' (and these functions allocate then).
//
// Mechanism holds what is constant in a simulation (topology, inertias, gravity) and is shared by
// threads; a Workspace is scratch for one thread. Nothing here allocates after both exist.
// Spatial vectors are ordered angular first, linear second (Featherstone), in axes of W about W's
// origin unless a name says otherwise. Shapes are given at each function; a wrong shape is a bug
// (RG_CHECK). Non-finite input gives non-finite output, never a trap.
//
// Body inertia φ_k, the ten barycentric parameters of body k in its own frame B_k:
//   m, m·c_x, m·c_y, m·c_z, I_xx, I_xy, I_xz, I_yy, I_yz, I_zz     (I about B_k's origin)
// in which tau is linear: tau = Y(q, v, q̈, g) φ.
//
// Hot loops that want several states or parameter sets in SIMD lanes use kernels.h directly.
#pragma once

#include <Eigen/Core>
#include <memory>

#include "common/math/isa.h"
#include "common/model/robot_model.h"

namespace rg::dynamics {

inline constexpr int kBodyParameters = 10;
using BodyParameters = Eigen::Matrix<double, kBodyParameters, Eigen::Dynamic>;  // 10 × bodies
using LinkParametersMatrix = Eigen::Matrix<double, model::kLinkParameters, Eigen::Dynamic>;

using VectorIn = Eigen::Ref<const Eigen::VectorXd>;
using VectorOut = Eigen::Ref<Eigen::VectorXd>;
using MatrixOut = Eigen::Ref<Eigen::MatrixXd>;

// Sum over the links of each moving body of the link's parameters, taken to the body's frame.
// `links`: 10 × num_links, as RobotModel::NominalLinkParameters. Result 10 × num_bodies.
BodyParameters LumpedInertias(const model::RobotModel& model, const LinkParametersMatrix& links);

// d(φ of the body)/d(parameters of the link), 10 × 10, at `link`'s parameters; rows as φ, columns as
// model::LinkParameters. Zero effect (the caller skips it) for links of the base, body -1.
// Mass and inertia columns are exact everywhere; the map is quadratic in the centre of mass.
Eigen::Matrix<double, 10, 10> LumpingJacobian(const model::RobotModel& model, int link,
                                              const model::LinkParameters& parameters);

// What is constant during a simulation. Copyable; immutable use is thread-safe.
class Mechanism {
 public:
  // Nominal link parameters, gravity (0, 0, -9.81) m/s² in W. `isa`: instruction set of the kernels.
  explicit Mechanism(const model::RobotModel& model, math::Isa isa = math::DetectIsa());
  ~Mechanism();
  Mechanism(const Mechanism&);
  Mechanism& operator=(const Mechanism&);

  int num_joints() const;
  int num_bodies() const;
  const Eigen::Vector3d& gravity() const;
  void SetGravity(const Eigen::Vector3d& gravity_W);
  const BodyParameters& body_parameters() const;
  void SetBodyParameters(const BodyParameters& parameters);
  // SetBodyParameters(LumpedInertias(model, links)).
  void SetLinkParameters(const model::RobotModel& model, const LinkParametersMatrix& links);

  struct Impl;
  const Impl& impl() const { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

class Workspace {
 public:
  Workspace();
  ~Workspace();
  Workspace(Workspace&&) noexcept;
  Workspace& operator=(Workspace&&) noexcept;

  struct Impl;
  Impl& impl() { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

// Inverse dynamics: tau = M(q) a + c(q, v, g). All n × 1.
void Rnea(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
          const VectorIn& a, VectorOut tau);

// tau that holds the arm at rest: c(q, 0, g). n × 1.
void GravityTorque(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, VectorOut tau);

// Mass matrix M(q), n × n, both triangles.
void Crba(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, MatrixOut M);

// Mass matrix and bias c(q, v, g) in one pass.
void MassMatrixAndBias(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                       MatrixOut M, VectorOut c);

// Forward dynamics by the articulated-body algorithm: a = M⁻¹ (tau - c). n × 1.
// Non-finite where a body has no inertia about its joint.
void Aba(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
         const VectorIn& tau, VectorOut a);

// Derivatives of tau = Rnea(q, v, a) at fixed a: dtau_dq, dtau_dv n × n; dtau_da is M.
void RneaDerivatives(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                     const VectorIn& a, MatrixOut dtau_dq, MatrixOut dtau_dv);

// Derivative of Rnea by gravity, n × 3.
void RneaGravityDerivative(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                           MatrixOut dtau_dg);

// Forward dynamics and its derivatives at fixed tau: a n × 1; da_dq, da_dv, da_dtau = M⁻¹ n × n.
void AbaDerivatives(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                    const VectorIn& tau, VectorOut a, MatrixOut da_dq, MatrixOut da_dv, MatrixOut da_dtau);

// Y with Rnea(q, v, a) = Y φ, n × 10·bodies; column 10 k + i is parameter i of body k.
void TorqueRegressor(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v,
                     const VectorIn& a, MatrixOut Y);

// X_WF of a frame fixed to a body.
model::Pose FramePose(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                      const model::Frame& frame);

// X_WF and the Jacobian J, 6 × n: (ω_WF; ṗ_WF) = J v, angular velocity of F first, then the velocity
// of F's origin (not of the point at W's origin), both in axes of W.
model::Pose FrameKinematics(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                            const model::Frame& frame, MatrixOut J);

// ½ vᵀ M v [J].
double KineticEnergy(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v);
// -Σ m_k gᵀ p_WC(k) over the moving bodies [J]; zero at W's origin.
double PotentialEnergy(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q);

}  // namespace rg::dynamics
