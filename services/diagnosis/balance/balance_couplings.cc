// Drives coupled to two joints: step 2 of balance_search.h.
#include <algorithm>
#include <cmath>

#include "common/base/printf.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/balance/balance_selection.h"
#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

using effects::Regressor;

namespace {

// Grid of |κ|: usually one. A drive of (i, j, κ) equals one of (j, i, 1/κ).
constexpr double kRatios[] = {0.5, 0.7, 1.0, 1.4, 2.0};
constexpr double kBetween = 1.5;  // factor to either side of a grid point, for the refinement of κ
constexpr int kGrid = 2 * static_cast<int>(std::size(kRatios));  // either sign
constexpr double kDriveErrors = 3.0;                             // standard errors that it must gain
constexpr double kShareOnEach = 0.1;                             // of the residual cost of either joint
constexpr int kRefinements = 12;

// Minimum of f between low and high by golden-section search.
template <class F>
double LeastBetween(double low, double high, F f) {
  const double golden = 0.5 * (std::sqrt(5.0) - 1);
  double a = high - golden * (high - low), b = low + golden * (high - low), at_a = f(a), at_b = f(b);
  for (int k = 0; k < kRefinements; ++k) {
    if (at_a < at_b) {
      high = b, b = a, at_b = at_a;
      a = high - golden * (high - low), at_a = f(a);
    } else {
      low = a, a = b, at_a = at_b;
      b = low + golden * (high - low), at_b = f(b);
    }
  }
  return 0.5 * (low + high);
}

}  // namespace

// The model with the columns of the coupled drive whose coefficients have the right sign.
BalanceModel BalanceSelection::WithDrive(BalanceModel m) const {
  m.drive = {BalanceDrive::kViscous, BalanceDrive::kCoulomb, BalanceDrive::kRotor};
  while (!m.drive.empty()) {
    const BalanceSolution s = fit_.Solve(m);
    int worst = -1;
    for (const int c : m.drive) {
      if (s.drive[c] <= 0 && (worst < 0 || s.drive[c] < s.drive[worst])) worst = c;
    }
    if (worst < 0) break;
    m.drive.erase(worst);
  }
  return m;
}

// Gain of the coupled drive added to plain losses on all joints; 0 unless it pays on both of its joints.
double BalanceSelection::DrivePays(const BalanceModel& rival, std::string* line) const {
  const BalanceDrive& drive = fit_.drive();
  const BalanceModel with = WithDrive(rival);
  if (with.drive.empty()) return 0;
  const BlockCosts before = fit_.LeaveOut(rival), after = fit_.LeaveOut(with);
  const Gain all = GainOf(before, after);
  const double pairs = std::max(1, data_.n - 1);
  bool pays = all.Beyond(kDriveErrors) &&
              all.nats > kEffectPrior + kJointPrior + LogHypotheses() + std::log(pairs * kGrid);
  *line = Printf("kappa %.3g, %.1f ± %.1f nats", drive.ratio, all.nats, all.stddev);
  for (const int j : {drive.other, drive.joint}) {
    const Gain own = GainOf(before, after, j);
    const double share = own.nats / std::max(1e-300, before.col(j).sum());
    pays = pays && own.Beyond(kErrors) && share > kShareOnEach;
    *line += Printf(", %s %.1f ± %.1f, share %.3f", nominal_.joint_names()[j].c_str(), own.nats, own.stddev,
                    share);
  }
  return pays ? all.nats : 0.0;
}

BalanceModel BalanceSelection::PlainOnAll() const {
  BalanceModel m = model_;
  using enum Regressor;
  for (int j = 0; j < data_.n; ++j) Insert({kVelocity, kDirection, kConstant, kAcceleration}, j, &m);
  return m;
}

BalanceModel BalanceSelection::Uncoupled() const {
  BalanceModel m = model_;
  m.drive.clear();
  for (const int j : {fit_.drive().other, fit_.drive().joint}) {
    if (j >= 0) Insert({Regressor::kVelocity, Regressor::kDirection, Regressor::kAcceleration}, j, &m);
  }
  return m;
}

// Nats gained by the coupled drive on the fitted rows.
double BalanceSelection::FittedGain(const BalanceModel& rival) const {
  const VectorXd less = fit_.Solve(rival).energy - fit_.Solve(WithDrive(rival)).energy;
  double nats = 0;
  for (const int j : {fit_.drive().other, fit_.drive().joint}) {
    const auto rows = static_cast<double>(fit_.Moving(balance_.joints[j].effort, j).size());
    nats += 0.5 * less[j] * rows / (fit_.Variance(j) * fit_.Correlation(j));
  }
  return nats;
}

// For each pair of neighbouring joints the best κ of the grid; of the pairs that pay the best.
void BalanceSelection::FindDrive() {
  const BalanceModel rival = PlainOnAll();
  const std::string& coupling = effects::LawOf(Regressor::kOtherEffort).id;
  BalanceDrive best;
  double most = 0;
  for (int j = 0; j < data_.n; ++j) {
    const int other = nominal_.model().joint(j).parent;
    if (other < 0 || other >= data_.n || !nominal_.Takes(coupling, j) || !nominal_.Takes(coupling, other))
      continue;
    BalanceDrive here;
    double gained = 0;
    for (const double sign : {1.0, -1.0}) {
      for (const double size : kRatios) {
        fit_.SetDrive(MakeBalanceDrive(setting_, balance_, other, j, sign * size));
        const double nats = FittedGain(rival);
        if (nats > gained) gained = nats, here = fit_.drive();
      }
    }
    if (here.joint < 0) continue;
    fit_.SetDrive(here);
    std::string line;
    const double nats = DrivePays(rival, &line);
    trace_("  drive: " + line);
    if (nats > most) most = nats, best = here;
  }
  fit_.SetDrive(best);
  if (most <= 0) return;
  RefineRatio(rival);
  model_.drive = WithDrive(rival).drive;
}

// Refines κ, on rows in which no candidate drive sticks.
void BalanceSelection::RefineRatio(const BalanceModel& rival) {
  const BalanceDrive start = fit_.drive();
  const double sign = start.ratio > 0 ? 1.0 : -1.0, size = std::abs(start.ratio), low = size / kBetween,
               high = size * kBetween;
  const auto drive = [&](double at) {
    return MakeBalanceDrive(setting_, balance_, start.other, start.joint, sign * at);
  };
  std::vector<char> still = start.still;
  for (const double end : {low, high}) {
    const std::vector<char> more = drive(end).still;
    for (size_t k = 0; k < still.size(); ++k) still[k] = still[k] || more[k];
  }
  const auto cost = [&](double at) {
    BalanceDrive d = drive(at);
    d.still = still;
    fit_.SetDrive(std::move(d));
    return -FittedGain(rival);
  };
  const double found = LeastBetween(low, high, cost), step = 0.05 * found, least = cost(found);
  const double bend = (cost(found - step) + cost(found + step) - 2 * least) / (step * step);
  ratio_stddev_ = bend > 0 ? 1 / std::sqrt(bend) : step;
  fit_.SetDrive(drive(found));
  trace_(Printf("  drive: kappa %.4f ± %.4f", sign * found, ratio_stddev_));
}

// Removes columns of the coupled drive that no longer pay.
bool BalanceSelection::PruneDrive() {
  const BlockCosts with = fit_.LeaveOut(model_);
  for (const int c : model_.drive) {
    BalanceModel less = model_;
    less.drive.erase(c);
    const Gain gain = GainOf(fit_.LeaveOut(less), with);
    if (gain.Beyond(kErrors) && gain.nats > LogHypotheses() && fit_.Solve(model_).drive[c] > 0) continue;
    trace_("  − column " + std::to_string(c) + " of the drive");
    model_ = less;
    return true;
  }
  return false;
}

}  // namespace rg::diagnosis
