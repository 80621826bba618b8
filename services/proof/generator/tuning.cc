#include "services/proof/generator/tuning.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Joint.hpp>

#include "services/proof/generator/engine.h"
#include "services/proof/generator/urdf_text.h"

namespace rg::proof {
namespace {

using dart::dynamics::SkeletonPtr;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kSamples = 250, kTuningRounds = 4;
constexpr double kFactorPrior = 0.25, kShiftPrior = 0.03, kFurthestTuned = 3;

std::vector<Eigen::Index> Indices(const SkeletonPtr& skeleton, const std::vector<std::string>& joints) {
  std::vector<Eigen::Index> at;
  for (const std::string& name : joints)
    at.push_back(static_cast<Eigen::Index>(skeleton->getJoint(name)->getDof(0)->getIndexInSkeleton()));
  return at;
}

// Torque of the rigid bodies along the motion, without damping; n × samples.
MatrixXd BodyTorque(const SkeletonPtr& skeleton, const std::vector<Eigen::Index>& at, const Motion& m,
                    const std::vector<Eigen::Index>& samples) {
  MatrixXd torque(static_cast<Eigen::Index>(at.size()), static_cast<Eigen::Index>(samples.size()));
  VectorXd full = VectorXd::Zero(static_cast<Eigen::Index>(skeleton->getNumDofs()));
  const auto spread = [&](const MatrixXd& x, Eigen::Index k) {
    for (size_t i = 0; i < at.size(); ++i) full[at[i]] = x(static_cast<Eigen::Index>(i), k);
    return full;
  };
  for (size_t s = 0; s < samples.size(); ++s) {
    skeleton->setPositions(spread(m.q, samples[s]));
    skeleton->setVelocities(spread(m.v, samples[s]));
    const VectorXd bias = skeleton->getCoriolisAndGravityForces();
    torque.col(static_cast<Eigen::Index>(s)) =
        (skeleton->getMassMatrix() * spread(m.a, samples[s]) + bias)(at);
  }
  return torque;
}

}  // namespace

VectorXd LinkPriors(size_t links) {
  VectorXd prior(static_cast<Eigen::Index>(links) * kPerLink);
  for (Eigen::Index k = 0; k < prior.size(); ++k) prior[k] = k % kPerLink < 2 ? kFactorPrior : kShiftPrior;
  return prior;
}

LinkChange ChangeOf(const VectorXd& theta, size_t link) {
  const auto* p = theta.data() + static_cast<Eigen::Index>(link) * kPerLink;
  LinkChange change;
  change.mass_factor = std::exp(p[0]);
  change.inertia_factor = std::exp(p[1]);
  for (int k = 0; k < 3; ++k) change.com_shift[k] = p[2 + k];
  return change;
}

TunedPart PartThatHides(const std::string& effect) {
  static const char* const in_bodies[] = {"torque_gain",      "payload",         "rotor_inertia",
                                          "sloshing_payload", "position_spring", "gravity_misalignment",
                                          "torque_offset",    "encoder_offset",  "torque_saturation",
                                          "joint_coupling",   "contact",         "base_flexibility",
                                          "unknown_field"};
  return std::any_of(std::begin(in_bodies), std::end(in_bodies), [&](const char* x) { return effect == x; })
             ? TunedPart::kBodies
             : TunedPart::kDamping;
}

LinkChange Changed(const LinkChange& first, const LinkChange& then) {
  LinkChange out = first;
  out.mass_factor *= then.mass_factor;
  out.inertia_factor *= then.inertia_factor;
  for (int k = 0; k < 3; ++k) out.com_shift[k] += then.com_shift[k];
  return out;
}

std::vector<std::string> LinksBeside(const std::vector<std::string>& on,
                                     const std::vector<std::string>& joints,
                                     const std::vector<std::string>& links) {
  size_t middle = links.size() - 1;
  if (!on.empty())
    middle = static_cast<size_t>(std::find(joints.begin(), joints.end(), on[0]) - joints.begin());
  const size_t first = middle > 0 ? middle - 1 : 0, end = std::min(links.size(), middle + 2);
  return {links.begin() + static_cast<long>(first), links.begin() + static_cast<long>(end)};
}

Tuning Tune(const SkeletonPtr& nominal, const std::vector<std::string>& joints,
            const std::vector<std::string>& links, const Motion& motion, TunedPart part) {
  const std::vector<Eigen::Index> at = Indices(nominal, joints);
  const auto n = static_cast<Eigen::Index>(joints.size());
  std::vector<Eigen::Index> samples;
  const Eigen::Index step = std::max<Eigen::Index>(1, motion.q.cols() / kSamples);
  for (Eigen::Index k = 0; k < motion.q.cols(); k += step) samples.push_back(k);
  MatrixXd u(n, static_cast<Eigen::Index>(samples.size())), v = u;
  for (size_t s = 0; s < samples.size(); ++s) {
    u.col(static_cast<Eigen::Index>(s)) = motion.u.col(samples[s]);
    v.col(static_cast<Eigen::Index>(s)) = motion.v.col(samples[s]);
  }
  Tuning tuning;
  for (const std::string& name : joints)
    tuning.damping.push_back(nominal->getJoint(name)->getDof(0)->getDampingCoefficient());
  const VectorXd declared = Eigen::Map<const VectorXd>(tuning.damping.data(), n);
  MatrixXd missing = u - declared.asDiagonal() * v - BodyTorque(nominal, at, motion, samples);
  if (part == TunedPart::kDamping) {
    for (Eigen::Index i = 0; i < n; ++i) {
      const double more = missing.row(i).dot(v.row(i)) / std::max(1e-12, v.row(i).squaredNorm());
      tuning.damping[static_cast<size_t>(i)] = std::max(0.0, declared[i] + more);
    }
    return tuning;
  }
  // Gauss-Newton with priors; each joint weighs by what is missing there at first.
  const VectorXd weight =
      (missing.rowwise().squaredNorm() / missing.cols()).cwiseSqrt().cwiseMax(1e-9).cwiseInverse();
  const VectorXd prior = LinkPriors(links.size());
  const Eigen::Index p = prior.size();
  VectorXd theta = VectorXd::Zero(p);
  const auto residual = [&](const VectorXd& at_theta) -> VectorXd {
    Truth bodies;
    for (size_t l = 0; l < links.size(); ++l) bodies.links[links[l]] = ChangeOf(at_theta, l);
    const MatrixXd left =
        u - declared.asDiagonal() * v - BodyTorque(TrueBodies(nominal, joints, bodies), at, motion, samples);
    const MatrixXd weighted = weight.asDiagonal() * left;
    return weighted.reshaped();
  };
  VectorXd best = theta;
  double least = residual(theta).squaredNorm();
  for (int round = 0; round < kTuningRounds; ++round) {
    const VectorXd r = residual(theta);
    MatrixXd jacobian(r.size(), p);
    for (Eigen::Index k = 0; k < p; ++k) {
      VectorXd beside = theta;
      const double h = 1e-3 * prior[k];
      beside[k] += h;
      jacobian.col(k) = (residual(beside) - r) / h;
    }
    MatrixXd normal = jacobian.transpose() * jacobian;
    normal.diagonal() += prior.cwiseAbs2().cwiseInverse();
    theta -= normal.ldlt().solve(jacobian.transpose() * r + theta.cwiseQuotient(prior.cwiseAbs2()));
    theta = theta.cwiseMin(kFurthestTuned * prior).cwiseMax(-kFurthestTuned * prior);
    const double left = residual(theta).squaredNorm();
    if (left < least) least = left, best = theta;
  }
  for (size_t l = 0; l < links.size(); ++l) tuning.links[links[l]] = ChangeOf(best, l);
  return tuning;
}

std::string WithTuning(const std::string& urdf, const SkeletonPtr& nominal,
                       const std::vector<std::string>& joints, const Tuning& tuning) {
  std::string text = urdf;
  Truth bodies;
  bodies.links = tuning.links;
  const SkeletonPtr tuned = TrueBodies(nominal, joints, bodies);
  for (const auto& [name, change] : tuning.links) {
    const dart::dynamics::Inertia& inertia = tuned->getBodyNode(name)->getInertia();
    text = WithInertial(text, name, {inertia.getMass(), inertia.getLocalCOM(), inertia.getMoment()});
  }
  for (size_t i = 0; i < joints.size(); ++i) {
    const double declared = nominal->getJoint(joints[i])->getDof(0)->getDampingCoefficient();
    if (tuning.damping[i] != declared) text = WithLosses(text, joints[i], tuning.damping[i], 0);
  }
  return text;
}

}  // namespace rg::proof
