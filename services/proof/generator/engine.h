// A robot as it "really" is: DART's rigid bodies, the physics of a Truth, a step of 0.1 to 0.2 ms.
//
// Another integrator than the product's (explicit velocity step with friction impulses found by
// projected Gauss-Seidel, trapezoidal position step), another engine, its own laws.
#pragma once

#include <Eigen/Core>
#include <dart/dynamics/Skeleton.hpp>
#include <deque>
#include <string>
#include <vector>

#include "services/proof/generator/truth.h"

namespace rg::proof {

// Where the last link ends, in its frame: the origin of the link fixed to it, else its own.
Eigen::Vector3d ToolOffset(const dart::dynamics::SkeletonPtr& skeleton, const std::string& last_joint);

// The rigid bodies as they really are: other masses, a payload, gravity that the base is tilted against.
dart::dynamics::SkeletonPtr TrueBodies(const dart::dynamics::SkeletonPtr& nominal,
                                       const std::vector<std::string>& joints, const Truth& truth);

class Engine {
 public:
  Engine(const dart::dynamics::SkeletonPtr& nominal, const std::vector<std::string>& joints,
         const Truth& truth, double dt);

  int n() const { return n_; }
  // At rest in its hidden states (motors with their links, bristles relaxed, drives settled at u).
  void Reset(const Eigen::VectorXd& q, const Eigen::VectorXd& v, const Eigen::VectorXd& u, double time);
  // The same, but everything hidden is taken from `other`, which is in the same instant. Where this robot
  // has no such state or senses otherwise, it is where it is sensed.
  void ResetLike(const Engine& other, const Eigen::VectorXd& sensed_q, const Eigen::VectorXd& sensed_v);
  void Step(const Eigen::VectorXd& command);

  double dt() const { return dt_; }
  Eigen::VectorXd SensedPosition() const;
  Eigen::VectorXd SensedVelocity() const;
  // Not where it ran away, to where DART's transforms are none any more.
  bool finite() const {
    constexpr double kAway = 1e6;  // rad, m, and per second
    return q_.allFinite() && v_.allFinite() && q_.cwiseAbs().maxCoeff() < kAway &&
           v_.cwiseAbs().maxCoeff() < kAway;
  }

 private:
  Eigen::VectorXd Drive(const Eigen::VectorXd& command);
  void AddJointForces(const Eigen::VectorXd& drive, Eigen::VectorXd* tau);
  void AddFieldForces(Eigen::VectorXd* tau);
  void AddContactForce(Eigen::VectorXd* tau);
  Eigen::VectorXd FrictionLimits(const Eigen::VectorXd& v, const Eigen::VectorXd& drive, bool positive) const;
  void SolveFriction(const Eigen::MatrixXd& inverse_mass, const Eigen::VectorXd& drive,
                     Eigen::VectorXd* v) const;
  void SetSkeleton();
  void TakeOverTwist(const Transmission& its, const Transmission& own, int joint);

  Truth truth_;
  dart::dynamics::SkeletonPtr skeleton_;
  dart::dynamics::BodyNode* last_ = nullptr;
  Eigen::Vector3d tool_;
  int n_, dofs_;          // joints with columns, all degrees of freedom of the skeleton
  std::vector<int> dof_;  // skeleton index of joint i
  // What the URDF itself declares, which is no concealed effect: <dynamics damping, friction>, n.
  Eigen::VectorXd declared_damping_, declared_friction_;
  std::vector<int> base_dofs_, slosh_dofs_;  // of a flexible base, of a swinging mass
  double dt_;
  double time_ = 0;
  Eigen::VectorXd q_, v_;  // all dofs
  Eigen::VectorXd motor_q_, motor_v_, lagged_, bristle_;
  std::deque<Eigen::VectorXd> commands_, sensed_q_, sensed_v_;  // newest last
};

}  // namespace rg::proof
