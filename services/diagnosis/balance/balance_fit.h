// Least squares on a torque balance, judged by cross-validation over blocks of the recordings.
//
// w of the balance is coloured, of unknown size: its variance per joint is that of the residual, and the
// number of rows is divided by its integrated autocorrelation, so that costs are in nats. A hypothesis is
// judged by its gain on left-out blocks: the sum, with a standard error over blocks that needs no model of
// the noise.
#pragma once

#include <Eigen/Core>
#include <set>
#include <vector>

#include "services/diagnosis/balance/torque_balance.h"

namespace rg::diagnosis {

// Which columns are in the model: signatures per joint by their index in TorqueBalance::columns, and base
// parameters.
struct BalanceModel {
  bool base = true;
  bool tilt = false;
  bool payload = false;                 // the last link carries a load: wide priors on its parameters
  std::vector<std::set<int>> features;  // per joint
  std::set<int> drive;                  // columns of the fit's BalanceDrive
};

struct BalanceSolution {
  VectorXd base;                   // B + 2, standardised, 0 where not in
  std::vector<VectorXd> features;  // per joint: F, standardised, 0 where not in
  VectorXd drive;                  // of BalanceDrive, standardised, 0 where not in
  VectorXd energy;                 // n, mean square of the residual

  std::vector<VectorXd*> Coefficients() {
    std::vector<VectorXd*> out = {&base, &drive};
    for (VectorXd& f : features) out.push_back(&f);
    return out;
  }
};

// Costs ½ SSR/(s² c) of left-out blocks: blocks × n.
using BlockCosts = MatrixXd;

class BalanceFit {
 public:
  explicit BalanceFit(const TorqueBalance& balance);

  // y per joint: rigid − effort.
  void SetResponse(int joint, const VectorXd& y);
  // After columns were appended to a joint of the balance.
  void TakeColumns(int joint);
  // The coupled drive whose columns models may have; rows in which it may stick are left out on its joints,
  // so that costs with different drives are not comparable.
  void SetDrive(BalanceDrive drive);
  const BalanceDrive& drive() const { return drive_; }
  // Estimates variance and correlation of w per joint from this model's residuals.
  void SetNoiseFrom(const BalanceModel& model);

  BalanceSolution Solve(const BalanceModel& model, int without_block = -1) const;
  BlockCosts LeaveOut(const BalanceModel& model) const;
  double PriorCost(const BalanceModel& model) const;  // nats, of its base parameters fitted to all blocks
  VectorXd Residual(const BalanceSolution& solution, int joint) const;
  // Stddev of the standardised coefficients by the jackknife over blocks.
  BalanceSolution Jackknife(const BalanceModel& model) const;
  double Variance(int joint) const { return variance_[joint]; }
  double Correlation(int joint) const { return correlation_[joint]; }
  int EffectiveRows() const;
  // The entries of rows in which the joint cannot stick.
  VectorXd Moving(const VectorXd& x, int joint) const;

 private:
  struct Gram {
    MatrixXd xx;  // columns: base, features, drive
    VectorXd xy;
    double yy = 0;
    double rows = 0;
  };
  double PriorPrecision(const BalanceModel& model, int base) const;
  void FillColumns(int joint);
  void FillResponse(int joint);
  MatrixXd DriveOn(int joint) const;  // R × 3; zero on joints that are not the drive's
  bool Still(int joint, size_t row) const;
  double Cost(const Gram& g, const VectorXd& x) const;
  VectorXd Stacked(const BalanceSolution& s, int joint) const;

  const TorqueBalance& balance_;
  int base_ = 0;
  BalanceDrive drive_;
  std::vector<VectorXd> y_;
  std::vector<std::vector<Gram>> gram_;  // [block][joint]
  VectorXd variance_, correlation_;
};

// Nats gained on left-out blocks, with standard error.
struct Gain {
  double nats = 0, stddev = 0;
  bool Beyond(double errors) const { return nats > errors * stddev; }
};
// joint −1: all.
Gain GainOf(const BlockCosts& before, const BlockCosts& after, int joint = -1);

}  // namespace rg::diagnosis
