#include "services/proof/generator/bodies.h"

#include <cmath>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Joint.hpp>
#include <dart/dynamics/WeldJoint.hpp>
#include <dart/utils/urdf/DartLoader.hpp>
#include <vector>

namespace rg::proof {
namespace {

constexpr double kBeyond = 0.15, kTurns = 3, kTooFast = 4;

bool IsFinger(const std::string& name) { return name.find("finger") != std::string::npos; }

// The manifest names the arm's joints only: everything else is locked at 0.
void LockFingers(const dart::dynamics::SkeletonPtr& skeleton) {
  std::vector<dart::dynamics::BodyNode*> fingers;
  for (auto* body : skeleton->getBodyNodes()) {
    const auto* joint = body->getParentJoint();
    if (joint->getNumDofs() > 0 && IsFinger(joint->getName())) fingers.push_back(body);
  }
  for (auto* body : fingers) {
    const auto* joint = body->getParentJoint();
    dart::dynamics::WeldJoint::Properties weld;
    weld.mName = joint->getName();
    weld.mT_ParentBodyToJoint = joint->getTransformFromParentBodyNode();
    weld.mT_ChildBodyToJoint = joint->getTransformFromChildBodyNode();
    body->changeParentJointType<dart::dynamics::WeldJoint>(weld);
  }
}

}  // namespace

Result<dart::dynamics::SkeletonPtr> ParseBodies(const std::string& urdf) {
  dart::utils::DartLoader::Options options;
  options.mDefaultInertia =
      dart::dynamics::Inertia(1e-9, Eigen::Vector3d::Zero(), 1e-12 * Eigen::Matrix3d::Identity());
  options.mDefaultRootJointType = dart::utils::DartLoader::RootJointType::FIXED;
  dart::utils::DartLoader loader(options);
  dart::dynamics::SkeletonPtr skeleton = loader.parseSkeletonString(urdf, "");
  if (!skeleton) return InvalidError("DART cannot read this URDF");
  LockFingers(skeleton);
  skeleton->setGravity(Eigen::Vector3d(0, 0, -9.81));
  return skeleton;
}

bool BeyondStops(const dart::dynamics::SkeletonPtr& bodies, const std::vector<std::string>& joints,
                 const Eigen::VectorXd& home, const Eigen::VectorXd& q, const Eigen::VectorXd& v) {
  for (Eigen::Index i = 0; i < q.size(); ++i) {
    const auto* dof = bodies->getJoint(joints[static_cast<size_t>(i)])->getDof(0);
    const double low = dof->getPositionLowerLimit(), high = dof->getPositionUpperLimit();
    const double margin = kBeyond * (high - low);
    const bool away = std::isfinite(margin) ? q[i] < low - margin || q[i] > high + margin
                                            : std::abs(q[i] - home[i]) > kTurns * 2 * M_PI;
    if (away || std::abs(v[i]) > kTooFast * dof->getVelocityUpperLimit()) return true;
  }
  return false;
}

}  // namespace rg::proof
