// Where fits of a motor behind a spring or play start: what the record, taken as it is, already says of them.
//
// One side of the transmission is measured. It drives a simulation of the other side alone, which it also
// holds: whatever the parameters, that simulation stays near the record, so it can go over whole recordings
// where a simulation of the robot would be lost after a moment.
//
//   sensor on the link:  J·θ̈ = u − T(θ − q),       T must be the torque τ that the measured motion needs
//   sensor on the motor: M·q̈ = T(θ − q) − (τ − M·θ̈),  u − T must be J·θ̈ for some J
//
// with T the law of spring or play, τ by inverse dynamics at the measured motion, M its inertia about the
// joint alone. What is left, averaged over spans of the smooth motion, is made small over a grid and then
// step by step.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/candidate.h"
#include "services/diagnosis/hypotheses.h"

namespace rg::diagnosis {

class TransmissionRecord {
 public:
  // `from`: the model whose bodies the torque is of.
  TransmissionRecord(const FitData& data, const Candidate& from, const MotionScales& scales, int joint);

  // "joint_elasticity" or "backlash": for either place of the sensor the best two starts that differ in
  // stiffness or gap.
  std::vector<std::vector<effects::EffectSpec>> Starts(const std::string& effect) const;

 private:
  struct Side {
    double dt = 0;
    Eigen::VectorXd u, q, v, a, torque, inertia;  // F each
  };
  struct Values {
    double inertia = 0, stiffness = 0, damping = 0, gap = 0;
    double left = 1e300;  // sum of squares
  };

  double Left(Values* values, bool on_motor) const;
  double LeftOf(const Side& side, const Values& values, bool on_motor, double* aa, double* ae) const;
  Values Refined(Values values, bool play, bool on_motor) const;
  Values Guess(double share_of_inertia, double hertz, double gap) const;

  std::string name_;
  double inertia_ = 0;  // kg·m² or kg, in the middle of the motion
  double range_ = 0;    // rad or m, of the motion
  std::vector<Side> sides_;
};

}  // namespace rg::diagnosis
