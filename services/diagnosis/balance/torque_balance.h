// The balance of torques along measured motion, for drives whose effort is measured:
//
//   f(t) = RNEA(q, q̇, q̈; URDF) − u(t)  =  Σ c_e φ_e(t) − Y(t) δp + w(t)        per joint
//
// f is the force that the model lacks, φ_e what an effect does per unit of its coefficient c_e, Y δp what
// other base parameters would do, w the effort's own noise and all that has no name; w is neither white nor
// known. Motion comes from the local polynomials of motion.h; both sides then pass the same window (Hann, ±30
// ms), so that they have lost the same frequencies, and are thinned to rows 20 ms apart. Rows in which a
// joint may be stuck
// (`still`) have no say on it: there friction is whatever it takes. Nor have any of a prescribed joint, whose
// effort nobody knows; its motion is in the others' rows.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "services/diagnosis/likelihood/features.h"

namespace rg::diagnosis {

inline constexpr double kTiltPrior = 0.6;  // m/s², one standardised unit of gravity's columns

// A force on one joint per unit of coefficient. The pieces of a force without a name are hats, whose place
// among them is the shape.
struct BalanceColumn {
  effects::Regressor regressor;
  double shape = 0;
  double scale = 1;  // coefficient in SI = scale · standardised one (prior stddev 1)
};

struct BalanceRows {
  Eigen::MatrixXd base;      // R × B, base parameters in units of their prior stddev
  Eigen::MatrixXd features;  // R × F, standardised
  Eigen::VectorXd rigid;     // R, RNEA of the URDF
  Eigen::VectorXd effort;    // R
  Eigen::VectorXd q, v;      // R, the joint's own, averaged as all else
  std::vector<double> t;     // R
  std::vector<int> recording, block;
  std::vector<char> still;
};

struct TorqueBalance {
  int n = 0;
  int blocks = 0;  // parts of the recordings that are left out in turn
  std::vector<sysid::FitParameter> base;
  std::vector<int>
      last_link;  // places in `base` of the last link's parameters, mass first as in LinkParameters
  int tilt = -1;  // first of two columns of `base` that stand for gravity's x and y; after the parameters
  std::vector<std::vector<BalanceColumn>> columns;  // per joint
  std::vector<BalanceRows> joints;

  double half_window_s = 0;  // of what rows are averaged over

  // Appends what a ripple of so many cycles per revolution does to a joint, as two columns (kSine, kCosine)
  // of which a coefficient of 1 makes a force of RMS `unit`.
  void AddRipple(int joint, double cycles, double unit);
  bool IsOfLastLink(int i) const {
    return std::find(last_link.begin(), last_link.end(), i) != last_link.end();
  }
};

// sin and cos of so many cycles per revolution along the rows, less what the averaging takes off.
Eigen::Matrix2Xd RippleWave(const BalanceRows& rows, double cycles, double half_window_s);
// A drive that turns with w = q̇_joint + κ·q̇_other (effects/joint_coupling.h, form kinematic) and what it does
// per unit of its coefficients, which are the same on both joints' rows: −w, −sign(w), −ẇ on the joint's, κ
// times that on the other's.
struct BalanceDrive {
  static constexpr int kViscous = 0, kCoulomb = 1, kRotor = 2, kColumns = 3;
  int other = -1, joint = -1;  // -1: there is none
  double ratio = 0;            // κ
  double scale[kColumns] = {1, 1, 1};
  Eigen::MatrixXd columns;  // R × 3 of the joint's rows, standardised; the other's are κ times these
  std::vector<char> still;  // R: it may be stuck
};

enum class EffortTiming { kDelay, kLag };

TorqueBalance MakeTorqueBalance(const FitData& data, const sim::Plant& plant, const MotionScales& scales);

BalanceDrive MakeBalanceDrive(const FitData& data, const TorqueBalance& balance, const MotionScales& scales,
                              int other, int joint, double ratio);

// The effort rows of joint j as they would be if the drive passed its effort on `seconds` late (negative:
// early), or through a first-order lag.
Eigen::VectorXd TimedEffort(const FitData& data, const BalanceRows& rows, int joint, EffortTiming timing,
                            double seconds);

}  // namespace rg::diagnosis
