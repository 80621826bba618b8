// The balance of torques along measured motion, for drives whose effort is measured:
//
//   f(t) = RNEA(q, q̇, q̈; URDF) − u(t)  =  Σ c_e φ_e(t) − Y(t) δp + w(t)        per joint
//
// f: force that the model lacks; φ_e: signature of an effect with coefficient c_e; Y δp: change of base
// parameters; w: noise of the effort and all forces without a law, of unknown size and correlation. Motion
// comes from the local polynomials of motion.h; both sides pass the same filter (Hann window, ±30 ms) and are
// sampled every 20 ms. Rows in which a joint may stick (`still`) are left out of its regression, since
// sticking friction takes any value; so are all rows of a prescribed joint, whose effort is unknown.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

inline constexpr double kTiltPrior = 0.6;  // m/s², one standardised unit of gravity's columns

// A signature on one joint. The pieces of an unnamed force are hat functions, with their index as shape.
struct BalanceColumn {
  effects::Regressor regressor;
  double shape = 0;
  double scale = 1;  // coefficient in SI = scale · standardised one (prior stddev 1)
};

struct BalanceRows {
  MatrixXd base;          // R × B, base parameters in units of their prior stddev
  MatrixXd features;      // R × F, standardised
  VectorXd rigid;         // R, RNEA of the URDF
  VectorXd effort;        // R
  VectorXd q, v;          // R, the joint's own, filtered
  std::vector<double> t;  // R
  std::vector<int> recording, block;
  std::vector<char> still;
};

struct TorqueBalance {
  int n = 0;
  int blocks = 0;  // folds of the cross-validation
  std::vector<sysid::FitParameter> base;
  std::vector<int>
      last_link;  // indices in `base` of the last link's parameters, in the order of LinkParameters
  int tilt = -1;  // index of the first of two columns for gravity's x and y, after those of `base`
  std::vector<std::vector<BalanceColumn>> columns;  // per joint
  std::vector<BalanceRows> joints;

  double half_window_s = 0;  // of the filter

  // Appends the signatures (kSine, kCosine) of a ripple of so many cycles per revolution to a joint; a
  // coefficient of 1 makes a force of RMS `unit`.
  void AddRipple(int joint, double cycles, double unit);
  bool IsOfLastLink(int i) const { return std::ranges::find(last_link, i) != last_link.end(); }
};

// sin and cos of so many cycles per revolution along the rows, attenuated as by the filter.
Eigen::Matrix2Xd RippleWave(const BalanceRows& rows, double cycles, double half_window_s);
// A drive that turns with w = q̇_joint + κ·q̇_other (effects/joint_coupling.h, form kinematic). Its signatures
// are −w, −sign(w), −ẇ on the joint's rows and κ times these on the other joint's.
struct BalanceDrive {
  static constexpr int kViscous = 0, kCoulomb = 1, kRotor = 2, kColumns = 3;
  int other = -1, joint = -1;  // -1: there is none
  double ratio = 0;            // κ
  double scale[kColumns] = {1, 1, 1};
  MatrixXd columns;         // R × 3 of the joint's rows, standardised; the other's are κ times these
  std::vector<char> still;  // R: the drive may stick
};

enum class EffortTiming { kDelay, kLag };

TorqueBalance MakeTorqueBalance(const FitSetting& setting);

BalanceDrive MakeBalanceDrive(const FitSetting& setting, const TorqueBalance& balance, int other, int joint,
                              double ratio);

// The effort rows of joint j behind a delay of `seconds` (negative: ahead), or a first-order lag.
VectorXd TimedEffort(const FitData& data, const BalanceRows& rows, int joint, EffortTiming timing,
                     double seconds);

}  // namespace rg::diagnosis
