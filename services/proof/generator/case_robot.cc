// The robot of a case: its bodies, how it is driven and recorded, and what is asked about it.
#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Joint.hpp>
#include <dart/dynamics/PrismaticJoint.hpp>
#include <dart/dynamics/RevoluteJoint.hpp>

#include "services/proof/generator/bodies.h"
#include "services/proof/generator/case_maker.h"
#include "services/proof/generator/engine.h"
#include "services/proof/generator/robots.h"
#include "services/proof/generator/urdf_text.h"

namespace rg::proof {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

namespace {

constexpr double kApart = 1e-9;  // of a joint's own inertia, that couples it to none

}  // namespace

Status CaseMaker::LoadRobot() {
  original_urdf_ = request_.urdf;
  if (original_urdf_.empty()) {
    RG_ASSIGN_OR_RETURN(original_urdf_, DrawRobot(request_.kind, request_.robots, rng_.Split(2)));
  }
  RG_ASSIGN_OR_RETURN(skeleton_, ParseBodies(original_urdf_));
  if (request_.ordinary) {  // whose damping is part of what it is about
    for (size_t i = 0; i < skeleton_->getNumJoints(); ++i) {
      const auto* joint = skeleton_->getJoint(i);
      if (joint->getNumDofs() == 1) original_urdf_ = WithLosses(original_urdf_, joint->getName(), 0, 0);
    }
    RG_ASSIGN_OR_RETURN(skeleton_, ParseBodies(original_urdf_));
  }
  urdf_ = original_urdf_;
  nominal_ = skeleton_;
  for (size_t i = 0; i < skeleton_->getNumJoints(); ++i) {
    auto* joint = skeleton_->getJoint(i);
    if (joint->getNumDofs() != 1) continue;
    joints_.push_back(joint->getName());
    links_.push_back(joint->getChildBodyNode()->getName());
    at_.push_back(static_cast<Eigen::Index>(joint->getDof(0)->getIndexInSkeleton()));
    scales_.prismatic.push_back(joint->getType() == dart::dynamics::PrismaticJoint::getStaticType());
  }
  return joints_.empty() ? InvalidError(request_.kind + ": no movable joint") : Status::Ok();
}

// How fast a small deviation grows under gravity at constant torque, 1/s; 0: stable.
double CaseMaker::GravityGrowth(const VectorXd& q) const {
  const int n = static_cast<int>(joints_.size());
  MatrixXd stiffness(n, n);
  for (int i = 0; i < n; ++i) {
    VectorXd up = q, down = q;
    up[i] += 1e-4, down[i] -= 1e-4;
    stiffness.col(i) = (Gravity(up) - Gravity(down)) / 2e-4;
  }
  Gravity(q);
  const VectorXd eigenvalues =
      -(Select(skeleton_->getMassMatrix()).llt().solve(stiffness)).eigenvalues().real();
  return std::sqrt(std::max(0.0, eigenvalues.maxCoeff()));
}

// A pose round which the arm hangs calmly, so that a second of open-loop prediction says something
// about the model and not only about the noise of the restart.
VectorXd CaseMaker::CalmHome(Rng rng) const {
  const int n = static_cast<int>(joints_.size());
  VectorXd best;
  double best_growth = 1e9;
  for (int attempt = 0; attempt < 3000; ++attempt) {
    VectorXd q(n);
    for (int i = 0; i < n; ++i) {
      const auto* dof = skeleton_->getJoint(joints_[static_cast<size_t>(i)])->getDof(0);
      const double low = std::max(-3.1, dof->getPositionLowerLimit()),
                   high = std::min(6.2, dof->getPositionUpperLimit());
      const double margin = std::min(0.6, 0.3 * (high - low));
      q[i] = rng.Uniform(low + margin, high - margin);
    }
    double growth = GravityGrowth(q);
    for (int i = 0; i < n && growth < best_growth; ++i) {
      for (const double side : {-0.45, 0.45}) {
        VectorXd beside = q;
        beside[i] += side;
        growth = std::max(growth, GravityGrowth(beside));
      }
    }
    if (growth < best_growth) best = q, best_growth = growth;
  }
  return best;
}

void CaseMaker::ChooseMotion() {
  const int n = static_cast<int>(joints_.size());
  limits_.home = limits_.amplitude = limits_.velocity = effort_ = VectorXd::Zero(n);
  Rng rng = rng_.Split(1);
  const VectorXd home = CalmHome(rng.Split(0));
  for (int i = 0; i < n; ++i) {
    const auto* dof = skeleton_->getJoint(joints_[static_cast<size_t>(i)])->getDof(0);
    const double low = std::max(-10.0, dof->getPositionLowerLimit()),
                 high = std::min(10.0, dof->getPositionUpperLimit());
    const bool bounded = high - low < 12.0;
    limits_.home[i] = home[i];
    const double room = bounded ? std::min(home[i] - low, high - home[i]) : 3.0;
    const double reach = scales_.prismatic[static_cast<size_t>(i)] ? 0.25 : n > 2 ? 0.45 : 0.9;
    limits_.amplitude[i] = std::min(room, reach) * rng.Uniform(0.7, 1.0);
    // Arms of one or two joints may swing fast, as far as their speed limit lets them.
    limits_.velocity[i] = std::min(n > 2 ? 1.2 : 5.0, dof->getVelocityUpperLimit());
    effort_[i] = dof->getForceUpperLimit();
  }
  dt_ = n > 2 ? 2e-4 : 1e-4;
  style_ = DrawStyle(request_.rate_hz, request_.with_velocity, rng_.Split(3));
  const double control_hz = request_.rate_hz / style_.rows_per_command;
  wn_ = control_hz < 40 ? 5 : control_hz < 150 ? 7.5 : 9;
  noise_ = {rng.Uniform(2e-4, 8e-4), rng.Uniform(3e-3, 1e-2), rng.Uniform(1e-4, 4e-4)};
  if (rng.Uniform() < 0.15) noise_.position = 1e-4, noise_.resolution = rng.Uniform(8e-4, 1.5e-3);
  // A linear axis is measured more finely in metres than an arm in radians.
  const auto linear = std::count(scales_.prismatic.begin(), scales_.prismatic.end(), true);
  const double finer = linear == n ? 0.15 : linear > 0 ? 0.4 : 1.0;
  noise_.position *= finer, noise_.velocity *= finer, noise_.resolution *= finer;
}

VectorXd CaseMaker::Gravity(const VectorXd& q) const {
  VectorXd full = VectorXd::Zero(static_cast<Eigen::Index>(skeleton_->getNumDofs()));
  for (size_t i = 0; i < joints_.size(); ++i) full[at_[i]] = q[static_cast<Eigen::Index>(i)];
  skeleton_->setPositions(full);
  skeleton_->setVelocities(VectorXd::Zero(full.size()));
  return skeleton_->getGravityForces()(at_);
}

MatrixXd CaseMaker::Select(const MatrixXd& full) const { return full(at_, at_); }

VectorXd CaseMaker::Controller(const VectorXd& q, const VectorXd& v, const VectorXd& q_ref,
                               const VectorXd& v_ref) const {
  const VectorXd gravity = Gravity(q);
  const VectorXd wish = wn_ * wn_ * (q_ref - q) + 2 * 0.8 * wn_ * (v_ref - v);
  VectorXd torque = Select(skeleton_->getMassMatrix()) * wish + gravity;
  constexpr double kSlow = 0.05;  // rad/s or m/s, at which dry friction is not fed forward with a jump
  for (size_t i = 0; i < servo_.joint.size(); ++i) {
    const JointTruth& j = servo_.joint[i];
    const auto at = static_cast<Eigen::Index>(i);
    const double dry = 0.5 * (j.dry.coulomb_positive + j.dry.coulomb_negative);
    torque[at] +=
        j.armature * wish[at] + compensated_ * (j.viscous * v_ref[at] + dry * std::tanh(v_ref[at] / kSlow));
  }
  return torque.cwiseMax(-effort_).cwiseMin(effort_);
}

Track CaseMaker::Record(const Truth& truth, const std::string& kind, double duration, uint64_t stream,
                        bool regular) const {
  const int n = static_cast<int>(joints_.size());
  Rng rng = rng_.Split(100 + stream);
  const Reference reference = MakeReference(kind, limits_, duration, request_.rate_hz, rng.Split(0));
  const RowPlan plan = PlanRows(style_, regular, duration, request_.rate_hz, dt_, rng.Split(1));
  const auto rows = static_cast<Eigen::Index>(std::count(plan.written.begin(), plan.written.end(), true));
  Track track{VectorXd(rows),    MatrixXd(n, rows), MatrixXd(n, rows),
              MatrixXd(n, rows), MatrixXd(n, rows), MatrixXd(n, rows)};
  Engine engine(skeleton_, joints_, truth, dt_);
  const VectorXd zero = VectorXd::Zero(n);
  VectorXd q(n), v(n), u = Controller(reference.q.col(0), zero, reference.q.col(0), zero);
  engine.Reset(reference.q.col(0), zero, u, 0.0);
  long fine = 0;
  Eigen::Index row = 0;
  for (size_t k = 0; k < plan.time.size(); ++k) {
    const VectorXd true_q = engine.SensedPosition(), true_v = engine.SensedVelocity();
    for (int i = 0; i < n; ++i) {
      const double noisy = true_q[i] + noise_.position * rng.Normal();
      q[i] = std::round(noisy / noise_.resolution) * noise_.resolution;
      v[i] = true_v[i] + noise_.velocity * rng.Normal();
    }
    if (plan.commands[k]) {
      const double at =
          std::min(plan.time[k] * request_.rate_hz, static_cast<double>(reference.q.cols() - 1));
      const auto low = static_cast<Eigen::Index>(at);
      const Eigen::Index high = std::min(low + 1, reference.q.cols() - 1);
      const double part = at - static_cast<double>(low);
      u = Controller(q, v, (1 - part) * reference.q.col(low) + part * reference.q.col(high),
                     (1 - part) * reference.v.col(low) + part * reference.v.col(high));
      for (int i = 0; i < n; ++i) u[i] = std::round(u[i] * 1e6) * 1e-6;  // as the file has it
    }
    if (plan.written[k]) {
      track.t[row] = plan.time[k];
      track.q.col(row) = q, track.v.col(row) = v, track.u.col(row) = u;
      track.true_q.col(row) = true_q, track.true_v.col(row) = true_v;
      ++row;
    }
    if (k + 1 == plan.time.size()) break;
    for (const long end = std::lround(plan.time[k + 1] / dt_); fine < end; ++fine) engine.Step(u);
    if (!engine.finite() || BeyondStops(skeleton_, joints_, limits_.home, true_q, true_v)) {
      track.ok = false;
      return track;
    }
  }
  return track;
}

Status CaseMaker::MeasureScales(const Truth& truth) {
  const int n = static_cast<int>(joints_.size());
  const Track track = Record(truth, "multisine", 7.0, 50, true);
  if (!track.ok) return InternalError("the robot ran away");
  scales_.joints = joints_;
  scales_.links = links_;
  scales_.home = limits_.home;
  scales_.amplitude = limits_.amplitude;
  const double rows = static_cast<double>(track.u.cols());
  scales_.torque = (track.u.rowwise().squaredNorm() / rows).cwiseSqrt();
  scales_.peak_torque = track.u.cwiseAbs().rowwise().maxCoeff();
  scales_.velocity = (track.true_v.rowwise().squaredNorm() / rows).cwiseSqrt();
  const Eigen::Vector3d tool = ToolOffset(skeleton_, joints_.back());
  scales_.tool = {tool[0], tool[1], tool[2]};
  MatrixXd motion(n, track.u.cols());
  scales_.tip_low = 1e9, scales_.tip_high = -1e9;
  for (Eigen::Index k = 0; k < track.u.cols(); ++k) {
    motion.col(k) = track.u.col(k) - Controller(track.true_q.col(k), VectorXd::Zero(n), track.true_q.col(k),
                                                VectorXd::Zero(n));
    const double tip = (skeleton_->getBodyNode(links_.back())->getTransform() * tool).z();
    scales_.tip_low = std::min(scales_.tip_low, tip);
    scales_.tip_high = std::max(scales_.tip_high, tip);
  }
  scales_.motion_torque = (motion.rowwise().squaredNorm() / rows).cwiseSqrt();
  scales_.zero_matters = VectorXd::Zero(n);
  for (int i = 0; i < n; ++i) {
    VectorXd beside = limits_.home;
    beside[i] += 0.05;
    const VectorXd here = Gravity(limits_.home);
    const MatrixXd mass = Select(skeleton_->getMassMatrix());
    const VectorXd there = Gravity(beside);
    scales_.zero_matters[i] =
        ((there - here).cwiseQuotient(scales_.torque.cwiseMax(1e-9))).cwiseAbs().maxCoeff() +
        0.5 * (Select(skeleton_->getMassMatrix()) - mass)
                  .diagonal()
                  .cwiseQuotient(mass.diagonal())
                  .cwiseAbs()
                  .maxCoeff();
  }
  Gravity(limits_.home);
  scales_.inertia = Select(skeleton_->getMassMatrix()).diagonal();
  scales_.last_mass = skeleton_->getBodyNode(links_.back())->getMass();
  scales_.duration_s = 7.0;
  return Status::Ok();
}

// By the mass matrix and gravity in some poses.
std::set<std::string> CaseMaker::JointsApart() const {
  const auto n = static_cast<Eigen::Index>(joints_.size());
  std::set<std::string> apart(joints_.begin(), joints_.end());
  MatrixXd mass;
  VectorXd gravity;
  for (int pose = 0; pose < 3; ++pose) {
    const VectorXd here = Gravity(limits_.home + 0.3 * pose * limits_.amplitude);
    const MatrixXd now = Select(skeleton_->getMassMatrix());
    if (pose == 0) mass = now, gravity = here;
    for (Eigen::Index i = 0; i < n; ++i) {
      const double least = kApart * now(i, i), sum = now.row(i).cwiseAbs().sum();
      const bool alone = sum - now(i, i) < least && std::abs(now(i, i) - mass(i, i)) < least &&
                         std::abs(here[i] - gravity[i]) < kApart * (1 + std::abs(gravity[i]));
      if (!alone) apart.erase(joints_[static_cast<size_t>(i)]);
    }
  }
  Gravity(limits_.home);
  return apart;
}

RobotFacts CaseMaker::Facts(const Truth& truth) const {
  RobotFacts facts;
  facts.joints = static_cast<int>(joints_.size());
  facts.first_joint = joints_.front();
  facts.linear = scales_.prismatic[0];
  for (const std::string& name : joints_) {
    if (nominal_->getJoint(name)->getDof(0)->getDampingCoefficient() > 0) facts.damped.insert(name);
  }
  facts.upright_plane = true;
  Eigen::Vector3d first = Eigen::Vector3d::Zero();
  for (size_t i = 0; i < joints_.size(); ++i) {
    const auto* joint = dynamic_cast<const dart::dynamics::RevoluteJoint*>(skeleton_->getJoint(joints_[i]));
    if (joint == nullptr) {
      facts.upright_plane = false;
      break;
    }
    const Eigen::Vector3d axis = joint->getChildBodyNode()->getTransform().linear() * joint->getAxis();
    if (i == 0) first = axis;
    facts.upright_plane = facts.upright_plane && std::abs(axis.z()) < 1e-6 && axis.cross(first).norm() < 1e-6;
  }
  if (facts.joints > 1) {
    facts.apart = JointsApart();
    return facts;
  }
  const auto inertia = [&](const dart::dynamics::SkeletonPtr& bodies) {
    VectorXd q = VectorXd::Zero(1);
    bodies->setPositions(q);
    return bodies->getMassMatrix()(0, 0);
  };
  facts.heavier =
      (inertia(TrueBodies(skeleton_, joints_, truth)) + truth.joint[0].armature) / truth.joint[0].gain >
      inertia(nominal_->cloneSkeleton("urdf"));
  return facts;
}

}  // namespace rg::proof
