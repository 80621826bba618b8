#include "services/diagnosis/balance_selection.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "common/model/robot_model.h"
#include "services/diagnosis/candidate.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using Eigen::VectorXd;

const std::vector<std::string> kPlainKinds = {"viscous_friction",    "coulomb_friction", "rotor_inertia",
                                              "quadratic_drag",      "torque_gain",      "position_spring",
                                              "gravity_misalignment"};
const std::vector<std::string> kRefinedKinds = {"offset", "stribeck_friction", "load_dependent_friction",
                                                "thermal_drift"};

namespace {

constexpr double kRareErrors = 3.0;  // of what few have
constexpr double kWorthAName = 0.1;  // of what remains on its joint
constexpr double kSamples = 1.5;     // timing finer than this many samples is the recorder's business
constexpr double kTimingStep = 0.004, kEarliest = -0.032, kLatest = 0.048;  // s

bool Common(const std::string& kind) {
  return kind == "viscous_friction" || kind == "coulomb_friction" || kind == "rotor_inertia" ||
         kind == "offset";
}

bool Positive(const std::string& effect) {
  return effect == "viscous_friction" || effect == "coulomb_friction" || effect == "rotor_inertia" ||
         effect == "quadratic_drag" || effect == "load_dependent_friction";
}

}  // namespace

struct BalanceSelection::Trial {
  std::string kind;
  BalanceModel model;
  double nats = 0;
  std::vector<int> joints;
};

BalanceSelection::BalanceSelection(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                                   int max_effects, TraceFn trace)
    : data_(data),
      nominal_(nominal),
      scales_(scales),
      max_effects_(max_effects),
      trace_(std::move(trace)),
      balance_(MakeTorqueBalance(data, nominal, scales)),
      fit_(balance_),
      timing_(data.n) {
  model_.features.resize(data.n);
}

double BalanceSelection::LogHypotheses() const {
  double count = 1;
  for (const auto& c : balance_.columns) count += static_cast<double>(c.size());
  return std::log(count);
}

std::vector<int> BalanceSelection::ColumnsOf(const std::string& effect, int joint) const {
  std::vector<int> out;
  const auto& all = balance_.columns[joint];
  for (size_t c = 0; c < all.size(); ++c) {
    if (all[c].effect == effect) out.push_back(static_cast<int>(c));
  }
  return out;
}

bool BalanceSelection::Has(const BalanceModel& m, const std::string& effect, int joint) const {
  const auto columns = ColumnsOf(effect, joint);
  return std::any_of(columns.begin(), columns.end(), [&](int c) { return m.features[joint].count(c) > 0; });
}

double BalanceSelection::Coefficient(const BalanceSolution& s, const std::string& effect, int joint) const {
  double sum = 0;
  for (const int c : ColumnsOf(effect, joint)) sum += s.features[joint][c] * balance_.columns[joint][c].scale;
  return sum;
}

void BalanceSelection::Pass(int j, const JointTiming& timing) {
  const BalanceRows& rows = balance_.joints[j];
  fit_.SetResponse(
      j, rows.rigid -
             (timing.seconds == 0 ? rows.effort : TimedEffort(data_, rows, j, timing.kind, timing.seconds)));
}

BalanceModel BalanceSelection::Flexible(BalanceModel m) const {
  for (int j = 0; j < data_.n; ++j) {
    for (const char* e :
         {"viscous_friction", "coulomb_friction", "offset", "rotor_inertia", "unknown_field"}) {
      for (const int c : ColumnsOf(e, j)) m.features[j].insert(c);
    }
  }
  return m;
}

void BalanceSelection::FindTiming() {
  const BalanceModel all = PlainOnAll();
  fit_.SetNoiseFrom(all);
  const BlockCosts plain = fit_.LeaveOut(all);
  std::vector<double> grid;
  for (double t = kEarliest; t < kLatest + 0.5 * kTimingStep; t += kTimingStep) grid.push_back(t);
  Eigen::MatrixXd energy(data_.n, static_cast<long>(grid.size()));
  for (size_t g = 0; g < grid.size(); ++g) {
    for (int j = 0; j < data_.n; ++j) Pass(j, {EffortTiming::kDelay, grid[g], 0});
    energy.col(static_cast<long>(g)) = fit_.Solve(all).energy;
  }
  std::vector<JointTiming> delay(data_.n), lag(data_.n);
  for (int j = 0; j < data_.n; ++j) {
    long at = 0;
    const double least = energy.row(j).minCoeff(&at);
    delay[j].seconds = grid[static_cast<size_t>(at)];
    delay[j].stddev = kTimingStep;
    if (at > 0 && at + 1 < energy.cols()) {
      const double a = energy(j, at - 1), b = energy(j, at), c = energy(j, at + 1), bend = a + c - 2 * b;
      if (bend > 0) {
        delay[j].seconds += 0.5 * kTimingStep * (a - c) / bend;
        const double rows = static_cast<double>(fit_.Moving(balance_.joints[j].effort, j).size());
        delay[j].stddev =
            kTimingStep * std::sqrt(2 * least * fit_.Correlation(j) / bend / std::max(1.0, rows));
      }
    }
    lag[j] = {EffortTiming::kLag, std::max(1e-3, delay[j].seconds), delay[j].stddev};
  }
  for (int j = 0; j < data_.n; ++j) Pass(j, lag[j]);
  const BlockCosts lagged = fit_.LeaveOut(all);
  for (int j = 0; j < data_.n; ++j) Pass(j, delay[j]);
  const BlockCosts shifted = fit_.LeaveOut(all);
  const double period = data_.recordings[0].recording->SamplePeriod();
  for (int j = 0; j < data_.n; ++j) {
    const Gain gain = GainOf(plain, shifted, j);
    const double share = gain.nats / std::max(1e-300, plain.col(j).sum());
    char line[200];
    std::snprintf(line, sizeof line,
                  "  %s: motion lags effort by %.1f ± %.1f ms, gain %.1f ± %.1f nats, share %.3f",
                  nominal_.joint_names()[j].c_str(), 1e3 * delay[j].seconds, 1e3 * delay[j].stddev, gain.nats,
                  gain.stddev, share);
    trace_(line);
    const bool seen = gain.Beyond(kErrors) && gain.nats > LogHypotheses() + kJointPrior &&
                      share > kWorthAName && std::abs(delay[j].seconds) > kSamples * period;
    if (seen && delay[j].seconds < 0) early_.push_back(j);
    if (seen && delay[j].seconds > 0) {
      const double of_lag = GainOf(shifted, lagged, j).nats;
      timing_[j] = of_lag > 0 ? lag[j] : delay[j];
      timing_gain_ += gain.nats + std::max(0.0, of_lag);
      other_timing_gain_ -= std::abs(of_lag);
    }
    Pass(j, timing_[j]);
  }
}

void BalanceSelection::Select(const CancelToken* cancel) {
  // What no law of position and velocity explains is noise, in size and in correlation.
  fit_.SetNoiseFrom(Flexible(model_));
  FindDrive();
  if (!model_.drive.empty()) fit_.SetNoiseFrom(Flexible(model_));
  const auto cancelled = [&] { return cancel != nullptr && cancel->cancelled(); };
  while (!cancelled() && AddKind()) {
  }
  while (!cancelled() && AddRefinement()) {
  }
  Prune();
}

// Models with `effect` on joint j in addition; several where it has shapes.
std::vector<BalanceModel> BalanceSelection::With(const BalanceModel& m, const std::string& effect,
                                                 int j) const {
  std::vector<BalanceModel> out;
  const bool shapes = effect == "stribeck_friction" || effect == "thermal_drift";
  for (const int c : ColumnsOf(effect, j)) {
    BalanceModel with = m;
    with.features[j].insert(c);
    if (effect == "position_spring") {
      for (const int o : ColumnsOf("offset", j)) with.features[j].insert(o);
    }
    out.push_back(with);
    if (!shapes) break;
  }
  return out;
}

bool BalanceSelection::Admissible(const BalanceModel& m, int j) const {
  const BalanceSolution s = fit_.Solve(m);
  for (const int c : m.features[j]) {
    if (Positive(balance_.columns[j][c].effect) && s.features[j][c] <= 0) return false;
  }
  const double level = Coefficient(s, "coulomb_friction", j);
  if (Has(m, "stribeck_friction", j) && Coefficient(s, "stribeck_friction", j) <= 0) return false;
  if (Has(m, "thermal_drift", j) && level + Coefficient(s, "thermal_drift", j) <= 0) return false;
  return !(Has(m, "offset", j) && !Has(m, "position_spring", j) &&
           std::abs(Coefficient(s, "offset", j)) > level);
}

// Whether an addition on joint j is real and takes a part of what remains there that is worth a name.
bool BalanceSelection::Pays(const std::string& kind, const BlockCosts& before, const BlockCosts& after, int j,
                            Gain* gain) const {
  *gain = GainOf(before, after);
  const Gain own = GainOf(before, after, j);
  const double errors = Common(kind) ? kErrors : kRareErrors;
  return gain->Beyond(errors) && own.Beyond(errors) && gain->nats > LogHypotheses() + kJointPrior &&
         own.nats > kWorthAName * before.col(j).sum();
}

// A constant force on each joint does as well where poses hardly change: friction that depends on the
// direction, which needs no tilted base.
bool BalanceSelection::TiltPays(const BlockCosts& before, Gain* gain) const {
  if (model_.tilt) return false;
  BalanceModel tilted = model_, rival = model_;
  tilted.tilt = true;
  for (int j = 0; j < data_.n; ++j) {
    for (const int c : ColumnsOf("offset", j)) rival.features[j].insert(c);
  }
  BalanceModel both = rival;
  both.tilt = true;
  *gain = GainOf(before, fit_.LeaveOut(tilted));
  const Gain beside = GainOf(fit_.LeaveOut(rival), fit_.LeaveOut(both));
  return gain->Beyond(kRareErrors) && gain->nats > LogHypotheses() && beside.Beyond(kRareErrors) &&
         beside.nats > LogHypotheses() && gain->nats > kWorthAName * before.sum();
}

BalanceSelection::Trial BalanceSelection::TryKind(const std::string& kind, const BlockCosts& before) const {
  Trial trial{kind, model_, 0, {}};
  if (kind == "gravity_misalignment") {
    Gain gain;
    if (!TiltPays(before, &gain)) return trial;
    trial.model.tilt = true, trial.nats = gain.nats, trial.joints = {0};
    return trial;
  }
  const bool refinement = std::find(kRefinedKinds.begin(), kRefinedKinds.end(), kind) != kRefinedKinds.end();
  for (int j = 0; j < data_.n; ++j) {
    if (refinement ? Refined(j) : Has(model_, kind, j)) continue;
    BlockCosts from = before;
    if (kind == "position_spring") {
      BalanceModel rival = model_;
      for (const int o : ColumnsOf("offset", j)) rival.features[j].insert(o);
      from = fit_.LeaveOut(rival);
    }
    double best = 0;
    for (const BalanceModel& with : With(model_, kind, j)) {
      Gain gain;
      if (!Pays(kind, from, fit_.LeaveOut(with), j, &gain) || gain.nats <= best || !Admissible(with, j))
        continue;
      best = gain.nats;
      trial.model.features[j] = with.features[j];
    }
    if (best > 0) trial.nats += best, trial.joints.push_back(j);
  }
  return trial;
}

bool BalanceSelection::AddKind() {
  const BlockCosts before = fit_.LeaveOut(model_);
  const size_t kinds = KindsOf(model_).size();
  Trial best;
  for (const std::string& kind : kPlainKinds) {
    const Trial t = TryKind(kind, before);
    if (t.nats <= best.nats) continue;
    const size_t after = KindsOf(t.model).size();
    if (static_cast<int>(after) > max_effects_) continue;
    if (after > kinds && t.nats < kEffectPrior + LogHypotheses()) continue;
    best = t;
  }
  if (best.joints.empty()) return false;
  model_ = best.model;
  // Together they may not all hold.
  for (const int j : best.joints) {
    while (best.kind != "gravity_misalignment" && !Admissible(model_, j) && DropNegative(j)) {
    }
  }
  std::string line = "  + " + best.kind + " on";
  for (const int j : best.joints) line += " " + nominal_.joint_names()[j];
  trace_(line + ": " + std::to_string(best.nats) + " nats; " + StateOf(model_));
  return true;
}

bool BalanceSelection::DropNegative(int j) {
  const BalanceSolution s = fit_.Solve(model_);
  int worst = -1;
  for (const int c : model_.features[j]) {
    const std::string& effect = balance_.columns[j][c].effect;
    const bool finer = std::find(kRefinedKinds.begin(), kRefinedKinds.end(), effect) != kRefinedKinds.end();
    if (Positive(effect) && s.features[j][c] <= 0) worst = c;
    if (finer && worst < 0) worst = c;
  }
  return worst >= 0 && model_.features[j].erase(worst) > 0;
}

// Nothing finer can be said of dry friction on joint j: there is none, or one finer form is in.
bool BalanceSelection::Refined(int j) const {
  return !Has(model_, "coulomb_friction", j) ||
         std::any_of(kRefinedKinds.begin(), kRefinedKinds.end(),
                     [&](const std::string& kind) { return Has(model_, kind, j); });
}

bool BalanceSelection::AddRefinement() {
  const BlockCosts before = fit_.LeaveOut(model_);
  Trial best;
  for (const std::string& kind : kRefinedKinds) {
    const Trial t = TryKind(kind, before);
    if (t.nats > best.nats && static_cast<int>(KindsOf(t.model).size()) <= max_effects_) best = t;
  }
  if (best.joints.empty()) return false;
  model_ = best.model;
  trace_("  refined: " + best.kind + ", " + std::to_string(best.nats) + " nats; " + StateOf(model_));
  return true;
}

// What the whole no longer needs goes, base parameters last.
void BalanceSelection::Prune() {
  bool changed = true;
  while (changed) {
    changed = PruneDrive();
    if (changed) continue;
    const BlockCosts with = fit_.LeaveOut(model_);
    for (int j = 0; j < data_.n && !changed; ++j) {
      for (const int c : model_.features[j]) {
        const std::string effect = balance_.columns[j][c].effect;
        if (effect == "coulomb_friction" && Refined(j)) continue;  // its finer form stands on it
        BalanceModel less = model_;
        less.features[j].erase(c);
        const Gain gain = GainOf(fit_.LeaveOut(less), with);
        if (gain.Beyond(kErrors) && gain.nats > LogHypotheses()) continue;
        trace_("  − " + effect + " " + nominal_.joint_names()[j]);
        model_ = less;
        changed = true;
        break;
      }
    }
  }
  BalanceModel given = model_;
  given.base = false;
  const Gain base = GainOf(fit_.LeaveOut(given), fit_.LeaveOut(model_));
  if (!(base.Beyond(kErrors) && base.nats > LogHypotheses())) model_ = given;
  trace_(std::string("  base parameters ") + (model_.base ? "free: " : "as given: ") +
         std::to_string(base.nats) + " ± " + std::to_string(base.stddev) + " nats");
}

std::string BalanceSelection::StateOf(const BalanceModel& m) const {
  const BalanceSolution s = fit_.Solve(m);
  std::string text = "RMS";
  for (int j = 0; j < data_.n; ++j) {
    char part[60];
    std::snprintf(part, sizeof part, " %.4g", std::sqrt(s.energy[j]));
    text += part;
  }
  return text;
}

}  // namespace rg::diagnosis
