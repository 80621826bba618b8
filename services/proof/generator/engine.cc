#include "services/proof/generator/engine.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/RevoluteJoint.hpp>
#include <dart/dynamics/UniversalJoint.hpp>
#include <dart/dynamics/WeldJoint.hpp>

#include "services/proof/generator/fields.h"

namespace rg::proof {
namespace {

using dart::dynamics::BodyNode;
using dart::dynamics::SkeletonPtr;
using Eigen::VectorXd;

constexpr double kHistorySeconds = 0.3;

void ChangeLinks(const std::map<std::string, LinkChange>& changes, const SkeletonPtr& skeleton) {
  for (const auto& [name, change] : changes) {
    BodyNode* body = skeleton->getBodyNode(name);
    if (body == nullptr) continue;
    dart::dynamics::Inertia inertia = body->getInertia();
    const Eigen::Matrix3d moment = inertia.getMoment() * change.inertia_factor;
    inertia.setMass(inertia.getMass() * change.mass_factor);
    inertia.setLocalCOM(inertia.getLocalCOM() +
                        Eigen::Vector3d(change.com_shift[0], change.com_shift[1], change.com_shift[2]));
    inertia.setMoment(moment);
    body->setInertia(inertia);
  }
}

void AddPayload(const Truth& truth, const SkeletonPtr& skeleton, BodyNode* last) {
  if (truth.payload_mass <= 0) return;
  dart::dynamics::WeldJoint::Properties weld;
  weld.mName = "payload_joint";
  BodyNode::Properties body;
  body.mName = "payload";
  body.mInertia = dart::dynamics::Inertia(
      truth.payload_mass, Eigen::Vector3d(truth.payload_com[0], truth.payload_com[1], truth.payload_com[2]),
      Eigen::Matrix3d::Identity() * 1e-9);
  skeleton->createJointAndBodyNodePair<dart::dynamics::WeldJoint>(last, weld, body);
}

// Degrees of freedom that a springy base or a swinging mass adds.
std::vector<int> DofsOf(const dart::dynamics::Joint* joint) {
  std::vector<int> dofs;
  for (size_t i = 0; i < joint->getNumDofs(); ++i)
    dofs.push_back(static_cast<int>(joint->getDof(i)->getIndexInSkeleton()));
  return dofs;
}

void AddSloshing(const Truth& truth, const SkeletonPtr& skeleton, BodyNode* last,
                 const Eigen::Vector3d& tool) {
  if (truth.slosh_mass <= 0) return;
  dart::dynamics::UniversalJoint::Properties joint;
  joint.mName = "slosh_joint";
  joint.mT_ParentBodyToJoint.translation() = tool;
  BodyNode::Properties body;
  body.mName = "slosh";
  body.mInertia = dart::dynamics::Inertia(truth.slosh_mass, Eigen::Vector3d(0, 0, -truth.slosh_length),
                                          Eigen::Matrix3d::Identity() * (1e-3 * truth.slosh_mass));
  skeleton->createJointAndBodyNodePair<dart::dynamics::UniversalJoint>(last, joint, body);
}

Eigen::Vector3d Gravity(const Truth& truth) {
  return 9.81 * Eigen::Vector3d(std::sin(truth.tilt) * std::cos(truth.azimuth),
                                std::sin(truth.tilt) * std::sin(truth.azimuth), -std::cos(truth.tilt));
}

// What of a twist is beyond the gap.
double Stretch(double twist, double gap) {
  const double half = 0.5 * gap;
  return std::abs(twist) <= half ? 0.0 : twist - std::copysign(half, twist);
}

}  // namespace

Eigen::Vector3d ToolOffset(const SkeletonPtr& skeleton, const std::string& last_joint) {
  const BodyNode* last = skeleton->getJoint(last_joint)->getChildBodyNode();
  for (size_t i = 0; i < last->getNumChildBodyNodes(); ++i) {
    const BodyNode* child = last->getChildBodyNode(i);
    if (child->getParentJoint()->getNumDofs() == 0 && child->getName().find("finger") == std::string::npos)
      return child->getTransform(last).translation();
  }
  return Eigen::Vector3d::Zero();
}

SkeletonPtr TrueBodies(const SkeletonPtr& nominal, const std::vector<std::string>& joints,
                       const Truth& truth) {
  const SkeletonPtr skeleton = nominal->cloneSkeleton("truth");
  ChangeLinks(truth.links, skeleton);
  AddPayload(truth, skeleton, skeleton->getJoint(joints.back())->getChildBodyNode());
  skeleton->setGravity(Gravity(truth));
  return skeleton;
}

Engine::Engine(const SkeletonPtr& nominal, const std::vector<std::string>& joints, const Truth& truth,
               double dt)
    : truth_(truth),
      skeleton_(TrueBodies(nominal, joints, truth)),
      tool_(ToolOffset(nominal, joints.back())),
      n_(static_cast<int>(joints.size())),
      dt_(dt) {
  last_ = skeleton_->getJoint(joints.back())->getChildBodyNode();
  AddSloshing(truth, skeleton_, last_, tool_);
  if (truth.base_stiffness > 0) {
    base_dofs_ =
        DofsOf(skeleton_->getRootBodyNode()->changeParentJointType<dart::dynamics::UniversalJoint>());
  }
  if (truth.slosh_mass > 0) slosh_dofs_ = DofsOf(skeleton_->getJoint("slosh_joint"));
  dofs_ = static_cast<int>(skeleton_->getNumDofs());
  for (const std::string& name : joints) {
    dof_.push_back(static_cast<int>(skeleton_->getJoint(name)->getDof(0)->getIndexInSkeleton()));
  }
  declared_damping_ = declared_friction_ = VectorXd::Zero(n_);
  for (int i = 0; i < n_; ++i) {
    const auto* dof = skeleton_->getDof(static_cast<size_t>(dof_[i]));
    declared_damping_[i] = dof->getDampingCoefficient();
    declared_friction_[i] = dof->getCoulombFriction();
  }
  q_ = v_ = VectorXd::Zero(dofs_);
  motor_q_ = motor_v_ = lagged_ = bristle_ = VectorXd::Zero(n_);
}

void Engine::SetSkeleton() {
  skeleton_->setPositions(q_);
  skeleton_->setVelocities(v_);
}

void Engine::Reset(const VectorXd& q, const VectorXd& v, const VectorXd& u, double time) {
  time_ = time;
  q_.setZero();
  v_.setZero();
  for (int i = 0; i < n_; ++i) q_[dof_[i]] = q[i], v_[dof_[i]] = v[i];
  motor_q_ = q;
  motor_v_ = v;
  lagged_ = u;
  bristle_.setZero();
  commands_.assign(static_cast<size_t>(std::lround(kHistorySeconds / dt_)) + 2, u);
  sensed_q_.assign(commands_.size(), VectorXd(motor_q_));
  sensed_v_.assign(commands_.size(), VectorXd(motor_v_));
}

void Engine::ResetLike(const Engine& other, const VectorXd& sensed_q, const VectorXd& sensed_v) {
  time_ = other.time_;
  q_.setZero(), v_.setZero();
  const auto take = [&](const std::vector<int>& own, const std::vector<int>& its) {
    for (size_t i = 0; i < std::min(own.size(), its.size()); ++i)
      q_[own[i]] = other.q_[its[i]], v_[own[i]] = other.v_[its[i]];
  };
  take(dof_, other.dof_), take(base_dofs_, other.base_dofs_), take(slosh_dofs_, other.slosh_dofs_);
  motor_q_ = other.motor_q_, motor_v_ = other.motor_v_, lagged_ = other.lagged_, bristle_ = other.bristle_;
  commands_ = other.commands_, sensed_q_ = other.sensed_q_, sensed_v_ = other.sensed_v_;
  const VectorXd dq = sensed_q - other.SensedPosition(), dv = sensed_v - other.SensedVelocity();
  for (int i = 0; i < n_; ++i) {
    const JointTruth &own = truth_.joint[static_cast<size_t>(i)],
                     &its = other.truth_.joint[static_cast<size_t>(i)];
    double &q = q_[dof_[i]], &v = v_[dof_[i]];
    q += dq[i], v += dv[i];
    motor_q_[i] += dq[i], motor_v_[i] += dv[i];
    if (its.sensor_delay != own.sensor_delay)
      q = motor_q_[i] = sensed_q[i] - own.encoder_offset, v = motor_v_[i] = sensed_v[i];
    if (its.transmission.stiffness > 0) TakeOverTwist(its.transmission, own.transmission, i);
  }
}

// The side that is sensed stays; the spring's deflection stays, the gap is this robot's.
void Engine::TakeOverTwist(const Transmission& its, const Transmission& own, int joint) {
  double &q = q_[dof_[joint]], &v = v_[dof_[joint]], &motor_q = motor_q_[joint], &motor_v = motor_v_[joint];
  const bool rigid = own.stiffness <= 0;
  if (!rigid && own.gap == its.gap) return;
  const double stretch = Stretch(motor_q - q, its.gap),
               twist = rigid || stretch == 0.0 ? 0.0 : stretch + std::copysign(0.5 * own.gap, stretch);
  if (its.sensor_on_motor) {
    q = motor_q - twist;
    if (rigid) v = motor_v;
  } else {
    motor_q = q + twist;
    if (rigid) motor_v = v;
  }
}

// command -> delay -> gain -> dead band -> limit -> offset and ripple -> lag
VectorXd Engine::Drive(const VectorXd& command) {
  commands_.push_back(command);
  commands_.pop_front();
  VectorXd drive(n_);
  for (int i = 0; i < n_; ++i) {
    const JointTruth& j = truth_.joint[static_cast<size_t>(i)];
    const size_t back = static_cast<size_t>(std::lround(j.delay / dt_));
    double u = commands_[commands_.size() - 1 - back][i] * j.gain;
    if (j.deadband > 0) u = std::abs(u) < j.deadband ? 0.0 : u - std::copysign(j.deadband, u);
    u = std::clamp(u, -j.saturation, j.saturation) + j.torque_offset;
    if (j.ripple_amplitude > 0) {
      const double angle = j.transmission.stiffness > 0 ? motor_q_[i] : q_[dof_[i]];
      u += j.ripple_amplitude * std::sin(j.ripple_cycles * angle + j.ripple_phase);
    }
    lagged_[i] = j.lag > 0 ? u + (lagged_[i] - u) * std::exp(-dt_ / j.lag) : u;
    drive[i] = lagged_[i];
  }
  return drive;
}

void Engine::AddJointForces(const VectorXd& drive, VectorXd* tau) {
  for (int i = 0; i < n_; ++i) {
    const JointTruth& j = truth_.joint[static_cast<size_t>(i)];
    const double q = q_[dof_[i]], v = v_[dof_[i]];
    double force = drive[i];
    if (j.transmission.stiffness > 0) {
      const Transmission& t = j.transmission;
      const double stretch = Stretch(motor_q_[i] - q, t.gap);
      double spring = 0;
      if (stretch != 0.0 || t.gap == 0.0) {
        spring = t.stiffness * stretch + t.damping * (motor_v_[i] - v);
        if (t.gap > 0 && spring * stretch < 0) spring = 0;  // a contact pushes, it never pulls
      }
      motor_v_[i] += dt_ / t.motor_inertia * (drive[i] - spring);
      motor_q_[i] += dt_ * motor_v_[i];
      force = spring;
    }
    force -= (declared_damping_[i] + j.viscous) * v + j.quadratic * v * std::abs(v);
    const double away = q - j.spring_center;
    force -= j.spring_stiffness * away + j.spring_cubic * away * away * away;
    if (j.bristle.stiffness > 0) {
      const Bristle& b = j.bristle;
      const double rate = v - b.stiffness * std::abs(v) / b.coulomb * bristle_[i];
      bristle_[i] += dt_ * rate;
      force -= b.stiffness * bristle_[i] + b.damping * rate;
    }
    (*tau)[dof_[i]] += force;
  }
  if (truth_.coupling_to >= 0)
    (*tau)[dof_[truth_.coupling_to]] += truth_.coupling * drive[truth_.coupling_from];
}

void Engine::AddFieldForces(VectorXd* tau) {
  if (truth_.disturbed >= 0 && time_ >= truth_.disturbance_start && time_ < truth_.disturbance_end) {
    (*tau)[dof_[truth_.disturbed]] += truth_.disturbance;
  }
  for (int d : base_dofs_) (*tau)[d] -= truth_.base_stiffness * q_[d] + truth_.base_damping * v_[d];
  if (truth_.field.on < 0) return;
  VectorXd q(n_), v(n_);
  for (int i = 0; i < n_; ++i) q[i] = q_[dof_[i]], v[i] = v_[dof_[i]];
  (*tau)[dof_[truth_.field.on]] += FieldForce(truth_.field, q, v, time_);
}

void Engine::AddContactForce(VectorXd* tau) {
  if (truth_.contact_stiffness <= 0) return;
  const double depth = truth_.contact_height - (last_->getTransform() * tool_).z();
  if (depth <= 0) return;
  const double speed = last_->getLinearVelocity(tool_).z();
  const double force = std::max(0.0, truth_.contact_stiffness * depth - truth_.contact_damping * speed);
  const auto jacobian = skeleton_->getLinearJacobian(last_, tool_);
  *tau += jacobian.row(2).transpose() * force;
}

VectorXd Engine::FrictionLimits(const VectorXd& v, const VectorXd& drive, bool positive) const {
  VectorXd limit = VectorXd::Zero(dofs_);
  for (int i = 0; i < n_; ++i) {
    const DryFriction& f = truth_.joint[static_cast<size_t>(i)].dry;
    if (!f.any() && declared_friction_[i] <= 0) continue;
    const double ratio = v[dof_[i]] / f.stribeck_velocity;
    limit[dof_[i]] = declared_friction_[i] + (positive ? f.coulomb_positive : f.coulomb_negative) +
                     f.static_extra * std::exp(-ratio * ratio) + f.load_coefficient * std::abs(drive[i]) +
                     f.thermal_extra * std::exp(-time_ / f.thermal_time);
  }
  return limit;
}

// v = v_free + M⁻¹·p with impulses p that oppose motion: |p_i| <= h·limit, p_i < limit only at rest.
void Engine::SolveFriction(const Eigen::MatrixXd& inverse_mass, const VectorXd& drive, VectorXd* v) const {
  const VectorXd forward = dt_ * FrictionLimits(v_, drive, true),
                 backward = dt_ * FrictionLimits(v_, drive, false);
  if (forward.maxCoeff() <= 0 && backward.maxCoeff() <= 0) return;
  VectorXd impulse = VectorXd::Zero(dofs_);
  for (int sweep = 0; sweep < 60; ++sweep) {
    double change = 0;
    for (int i = 0; i < dofs_; ++i) {
      if (forward[i] <= 0 && backward[i] <= 0) continue;
      const double wanted = std::clamp(impulse[i] - (*v)[i] / inverse_mass(i, i), -forward[i], backward[i]);
      const double delta = wanted - impulse[i];
      impulse[i] = wanted;
      *v += inverse_mass.col(i) * delta;
      change = std::max(change, std::abs(delta));
    }
    if (change < 1e-14) break;
  }
}

void Engine::Step(const VectorXd& command) {
  if (!finite()) return;  // it ran away: DART ends the process at a pose that is none
  SetSkeleton();
  const VectorXd drive = Drive(command);
  VectorXd tau = -skeleton_->getCoriolisAndGravityForces();
  AddJointForces(drive, &tau);
  AddFieldForces(&tau);
  AddContactForce(&tau);
  Eigen::MatrixXd mass = skeleton_->getMassMatrix();
  for (int i = 0; i < n_; ++i) mass(dof_[i], dof_[i]) += truth_.joint[static_cast<size_t>(i)].armature;
  const Eigen::MatrixXd inverse = mass.llt().solve(Eigen::MatrixXd::Identity(dofs_, dofs_));
  VectorXd next = v_ + dt_ * (inverse * tau);
  SolveFriction(inverse, drive, &next);
  q_ += 0.5 * dt_ * (v_ + next);
  v_ = next;
  time_ += dt_;
  VectorXd q(n_), v(n_);
  for (int i = 0; i < n_; ++i) {
    const bool motor = truth_.joint[static_cast<size_t>(i)].transmission.sensor_on_motor;
    q[i] = motor ? motor_q_[i] : q_[dof_[i]];
    v[i] = motor ? motor_v_[i] : v_[dof_[i]];
  }
  sensed_q_.push_back(q), sensed_q_.pop_front();
  sensed_v_.push_back(v), sensed_v_.pop_front();
}

VectorXd Engine::SensedPosition() const {
  VectorXd q(n_);
  for (int i = 0; i < n_; ++i) {
    const JointTruth& j = truth_.joint[static_cast<size_t>(i)];
    q[i] = sensed_q_[sensed_q_.size() - 1 - static_cast<size_t>(std::lround(j.sensor_delay / dt_))][i] +
           j.encoder_offset;
  }
  return q;
}

VectorXd Engine::SensedVelocity() const {
  VectorXd v(n_);
  for (int i = 0; i < n_; ++i) {
    const JointTruth& j = truth_.joint[static_cast<size_t>(i)];
    v[i] = sensed_v_[sensed_v_.size() - 1 - static_cast<size_t>(std::lround(j.sensor_delay / dt_))][i];
  }
  return v;
}

}  // namespace rg::proof
