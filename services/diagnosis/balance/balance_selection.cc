#include "services/diagnosis/balance/balance_selection.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/base/printf.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

using effects::Regressor;

const std::vector<Regressor> kPlainLaws = {Regressor::kVelocity,     Regressor::kDirection,
                                           Regressor::kAcceleration, Regressor::kSquaredVelocity,
                                           Regressor::kEffort,       Regressor::kPosition};
const std::vector<Regressor> kFinerLaws = {Regressor::kSlowly, Regressor::kUnderLoad, Regressor::kWarmingUp};

namespace {

constexpr double kRareErrors = 3.0;  // standard errors that rare effects must gain
// Losses of every geared drive.
constexpr Regressor kLosses[] = {Regressor::kVelocity, Regressor::kDirection, Regressor::kAcceleration};
constexpr double kPeriods = 2.0;      // of a ripple within the joint's travel, at least
constexpr double kRippleStep = 2.0;   // grid step of cycles, times 1/range
constexpr double kMostRipples = 400;  // grid points
constexpr double kPassed = 0.8;       // highest frequency, over the filter's first zero at RMS speed
constexpr double kLeastLoad = 0.1;    // of the last link's own mass
constexpr double kReach = 0.4;        // m, from the last link's origin to its load's centre of mass
constexpr double kWorthAName = 0.1;   // share of a joint's residual cost that an effect must explain
constexpr double kSamples = 1.5;      // sample periods, below which a delay is attributed to the recorder
constexpr double kTimingStep = 0.004, kEarliest = -0.032, kLatest = 0.048;  // s

bool IsFiner(Regressor law) { return std::ranges::find(kFinerLaws, law) != kFinerLaws.end(); }

// Losses, and an offset of the effort.
bool Common(Regressor law) {
  return law == Regressor::kConstant ||
         std::find(std::begin(kLosses), std::end(kLosses), law) != std::end(kLosses);
}

// Whether the law's own coefficient must be positive.
bool Positive(Regressor law) {
  const auto& terms = effects::InferenceOf(effects::LawOf(law).id).terms;
  return std::ranges::any_of(terms, [&](const effects::Term& t) { return t.regressor == law && t.positive; });
}

}  // namespace

struct BalanceSelection::Trial {
  std::string effect;
  BalanceModel model;
  double nats = 0;
  std::vector<int> joints;
};

BalanceSelection::BalanceSelection(const FitSetting& setting, int max_effects, TraceFn trace)
    : setting_(setting), max_effects_(max_effects), trace_(std::move(trace)) {}

double BalanceSelection::LogHypotheses() const {
  double count = 1;
  for (const auto& c : balance_.columns) count += static_cast<double>(c.size());
  return std::log(count);
}

std::vector<int> BalanceSelection::ColumnsOf(Regressor law, int joint) const {
  std::vector<int> out;
  const auto& all = balance_.columns[joint];
  for (size_t c = 0; c < all.size(); ++c) {
    if (all[c].regressor == law) out.push_back(static_cast<int>(c));
  }
  return out;
}

void BalanceSelection::Insert(std::initializer_list<Regressor> laws, int joint, BalanceModel* m) const {
  for (const Regressor law : laws) {
    for (const int c : ColumnsOf(law, joint)) m->features[joint].insert(c);
  }
}

void BalanceSelection::Erase(Regressor law, int joint, BalanceModel* m) const {
  for (const int c : ColumnsOf(law, joint)) m->features[joint].erase(c);
}

bool BalanceSelection::Has(const BalanceModel& m, Regressor law, int joint) const {
  const auto columns = ColumnsOf(law, joint);
  return std::ranges::any_of(columns, [&](int c) { return m.features[joint].count(c) > 0; });
}

double BalanceSelection::Coefficient(const BalanceSolution& s, Regressor law, int joint) const {
  double sum = 0;
  for (const int c : ColumnsOf(law, joint)) sum += s.features[joint][c] * balance_.columns[joint][c].scale;
  return sum;
}

std::vector<double> BalanceSelection::Coefficients(const BalanceSolution& s, const effects::Inference& effect,
                                                   int joint) const {
  std::vector<double> out;
  for (const effects::Term& t : effect.terms) out.push_back(Coefficient(s, t.regressor, joint));
  return out;
}

void BalanceSelection::Pass(int j, const JointTiming& timing) {
  const BalanceRows& rows = balance_.joints[j];
  fit_.SetResponse(
      j, rows.rigid -
             (timing.seconds == 0 ? rows.effort : TimedEffort(data_, rows, j, timing.kind, timing.seconds)));
}

BalanceModel BalanceSelection::Flexible(BalanceModel m) const {
  using enum Regressor;
  for (int j = 0; j < data_.n; ++j)
    Insert({kVelocity, kDirection, kConstant, kAcceleration, kPositionPiece, kVelocityPiece}, j, &m);
  return m;
}

void BalanceSelection::FindTiming() {
  const BalanceModel all = PlainOnAll();
  fit_.SetNoiseFrom(all);
  const BlockCosts plain = fit_.LeaveOut(all);
  std::vector<double> grid;
  for (double t = kEarliest; t < kLatest + 0.5 * kTimingStep; t += kTimingStep) grid.push_back(t);
  MatrixXd energy(data_.n, static_cast<long>(grid.size()));
  for (size_t g = 0; g < grid.size(); ++g) {
    for (int j = 0; j < data_.n; ++j) Pass(j, {EffortTiming::kDelay, grid[g], 0});
    energy.col(g) = fit_.Solve(all).energy;
  }
  std::vector<JointTiming> delay(data_.n), lag(data_.n);
  for (int j = 0; j < data_.n; ++j) {
    long at = 0;
    const double least = energy.row(j).minCoeff(&at);
    delay[j].seconds = grid[at];
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
    trace_(Printf("  %s: motion lags effort by %.1f ± %.1f ms, gain %.1f ± %.1f nats, share %.3f",
                  nominal_.joint_names()[j].c_str(), 1e3 * delay[j].seconds, 1e3 * delay[j].stddev, gain.nats,
                  gain.stddev, share));
    const bool seen = gain.Beyond(kErrors) && gain.nats > LogHypotheses() + kJointPrior &&
                      share > kWorthAName && std::abs(delay[j].seconds) > kSamples * period;
    if (seen && delay[j].seconds < 0) early_.push_back(j);
    if (seen && delay[j].seconds > 0) {
      const Gain as_lag = GainOf(shifted, lagged, j);
      const double of_lag = as_lag.nats;
      trace_(Printf("  %s: as a lag %.1f ± %.1f nats more", nominal_.joint_names()[j].c_str(), as_lag.nats,
                    as_lag.stddev));
      timing_[j] = as_lag.Beyond(1.0) ? lag[j] : delay[j];
      timing_gain_ += gain.nats + std::max(0.0, of_lag);
      other_timing_gain_ -= std::abs(of_lag);
    }
    Pass(j, timing_[j]);
  }
}

void BalanceSelection::Select(const CancelToken* cancel) {
  // The noise is what no force over position and velocity explains.
  fit_.SetNoiseFrom(Flexible(model_));
  FindDrive();
  if (!model_.drive.empty()) fit_.SetNoiseFrom(Flexible(model_));
  const auto cancelled = [&] { return cancel != nullptr && cancel->cancelled(); };
  BeginWithLosses();
  TryPayload();
  while (!cancelled() && AddKind()) {
  }
  while (!cancelled() && AddRefinement()) {
  }
  for (int j = 0; j < data_.n && !cancelled(); ++j) TryRipple(j);
  Prune();
}

// Group step: losses on every joint together, since base parameters absorb much of a single one. A kind that
// does not pay on all joints together is removed again.
void BalanceSelection::BeginWithLosses() {
  BalanceModel all = model_;
  for (int j = 0; j < data_.n; ++j) Insert({kLosses[0], kLosses[1], kLosses[2]}, j, &all);
  RepairSigns(&all);
  if (!PaysTogether(fit_.LeaveOut(model_), fit_.LeaveOut(all))) return;
  for (bool changed = true; changed;) {
    changed = false;
    const BlockCosts with = fit_.LeaveOut(all);
    for (const Regressor loss : kLosses) {
      BalanceModel less = all;
      for (int j = 0; j < data_.n; ++j) Erase(loss, j, &less);
      if (less.features == all.features || PaysTogether(fit_.LeaveOut(less), with)) continue;
      all = less, changed = true;
      break;
    }
  }
  model_ = all;
  losses_ = all.features;
  trace_("  drives: " + StateOf(model_));
}

// Removes coefficients of the wrong sign, the largest first.
void BalanceSelection::RepairSigns(BalanceModel* m) const {
  for (bool changed = true; changed;) {
    changed = false;
    const BalanceSolution s = fit_.Solve(*m);
    double worst = 0;
    int joint = -1, column = -1;
    for (int j = 0; j < data_.n; ++j) {
      for (const int c : m->features[j]) {
        if (!Positive(balance_.columns[j][c].regressor) || s.features[j][c] >= worst) continue;
        worst = s.features[j][c], joint = j, column = c;
      }
    }
    if (joint >= 0) m->features[joint].erase(column), changed = true;
  }
}

// Whether an addition to several joints is significant: a sign test over blocks and joints, and a gain above
// the number of hypotheses. Blocks differ too much (one joint moves, or all) for the standard error of the
// sum.
bool BalanceSelection::PaysTogether(const BlockCosts& before, const BlockCosts& after) const {
  double better = 0, cells = 0;
  for (Eigen::Index b = 0; b < before.rows(); ++b) {
    for (Eigen::Index j = 0; j < before.cols(); ++j) {
      if (before(b, j) == 0 && after(b, j) == 0) continue;
      ++cells;
      better += after(b, j) < before(b, j) ? 1 : -1;
    }
  }
  return cells > 0 && better > kErrors * std::sqrt(cells) &&
         (before - after).sum() > kEffectPrior + LogHypotheses();
}

// A payload: with wide priors on the last link the base parameters cost far less prior, and left-out blocks
// are not predicted worse.
void BalanceSelection::TryPayload() {
  if (balance_.last_link.size() != model::kLinkParameters || data_.n < 2) return;
  BalanceModel loaded = model_;
  loaded.payload = true;
  const double worse = std::max(0.0, -GainOf(fit_.LeaveOut(model_), fit_.LeaveOut(loaded)).nats);
  const double spared = fit_.PriorCost(model_) - fit_.PriorCost(loaded) - worse;
  if (spared < kEffectPrior + kJointPrior || !PayloadOf(loaded)) return;
  model_ = loaded;
  trace_("  + payload: " + std::to_string(spared) + " nats; " + StateOf(model_));
}

// A ripple, at the number of cycles that explains most of the residual.
void BalanceSelection::TryRipple(int j) {
  const double range = scales_.high[j] - scales_.low[j];
  const std::string& ripple = effects::LawOf(Regressor::kSine).id;
  if (!nominal_.Takes(ripple, j) || scales_.still[j] || !(range > 0)) return;
  const BalanceRows& rows = balance_.joints[j];
  const VectorXd left = fit_.Residual(fit_.Solve(model_), j);
  // Reduction of the squared residual by a wave.
  const auto energy = [&](double cycles) {
    const Eigen::Matrix2Xd wave = RippleWave(rows, cycles, balance_.half_window_s);
    Eigen::Matrix2d xx = 1e-12 * Eigen::Matrix2d::Identity();
    Eigen::Vector2d xy = Eigen::Vector2d::Zero();
    for (long k = 0; k < left.size(); ++k) {
      if (rows.still[k]) continue;
      xx += wave.col(k) * wave.col(k).transpose();
      xy += left[k] * wave.col(k);
    }
    return xy.dot(xx.ldlt().solve(xy));
  };
  const double lowest = std::max(2.0, kPeriods * 2 * M_PI / range), step = kRippleStep / range;
  const double highest =
      lowest + std::min(kMostRipples * step, kPassed * M_PI / (balance_.half_window_s * scales_.speed[j]));
  double best = lowest, most = 0, count = 0;
  for (double cycles = lowest; cycles < highest; cycles += step, ++count) {
    const double e = energy(cycles);
    if (e > most) most = e, best = cycles;
  }
  for (double by = step / 2; by > step / 20; by /= 2) {
    for (const double cycles : {best - by, best + by}) {
      const double e = energy(cycles);
      if (cycles > 0 && e > most) most = e, best = cycles;
    }
  }
  if (count < 1) return;
  balance_.AddRipple(j, best, 0.5 * scales_.torque[j]);
  fit_.TakeColumns(j);
  BalanceModel with = model_;
  const int columns = static_cast<int>(balance_.columns[j].size());
  with.features[j].insert({columns - 2, columns - 1});
  Gain gain;
  const BlockCosts before = fit_.LeaveOut(model_), after = fit_.LeaveOut(with);
  if (!Pays(Regressor::kSine, before, after, j, &gain) ||
      gain.nats < LogHypotheses() + std::log(count) + kEffectPrior)
    return;
  model_ = with;
  trace_("  + " + ripple + " on " + nominal_.joint_names()[j] + ", " + std::to_string(best) +
         " per turn: " + std::to_string(gain.nats) + " nats; " + StateOf(model_));
}

// Empty unless heavier than an error of the URDF and within reach of the hand.
std::optional<EffectSpec> BalanceSelection::PayloadOf(const BalanceModel& m) const {
  if (!m.payload) return std::nullopt;
  const BalanceSolution s = fit_.Solve(m);
  Scored payload;
  payload.effect = effects::EffectOf(effects::Role::kBodyInertia).id;
  for (const int i : balance_.last_link)
    payload.coefficients.push_back(balance_.base[i].prior_stddev * s.base[i]);
  const EffectSpec spec = SpecsFor(payload, nominal_, scales_).front().front();
  const auto& values = spec.values.at("*");
  const double own = nominal_.parameters()[balance_.base[balance_.last_link[0]].index].nominal;
  const double mass = payload.coefficients[0];
  const double out = std::sqrt(std::pow(values.at("com_x"), 2) + std::pow(values.at("com_y"), 2) +
                               std::pow(values.at("com_z"), 2));
  if (mass < kLeastLoad * own || out > kReach) return std::nullopt;
  return spec;
}

// Models with a law on joint j added, one per shape.
std::vector<BalanceModel> BalanceSelection::With(const BalanceModel& m, Regressor law, int j) const {
  std::vector<BalanceModel> out;
  for (const int c : ColumnsOf(law, j)) {
    BalanceModel with = m;
    with.features[j].insert(c);
    if (law == Regressor::kPosition) Insert({Regressor::kConstant}, j, &with);
    out.push_back(with);
  }
  return out;
}

bool BalanceSelection::Admissible(const BalanceModel& m, int j) const {
  const BalanceSolution s = fit_.Solve(m);
  for (const int c : m.features[j]) {
    if (Positive(balance_.columns[j][c].regressor) && s.features[j][c] <= 0) return false;
  }
  return std::ranges::all_of(kFinerLaws, [&](Regressor law) {
    const effects::Inference& effect = effects::InferenceOf(effects::LawOf(law).id);
    return !Has(m, law, j) || effect.plausible(Coefficients(s, effect, j));
  });
}

// Whether an addition on joint j is significant and explains enough of the residual there.
bool BalanceSelection::Pays(Regressor law, const BlockCosts& before, const BlockCosts& after, int j,
                            Gain* gain) const {
  *gain = GainOf(before, after);
  const Gain own = GainOf(before, after, j);
  const double errors = Common(law) ? kErrors : kRareErrors;
  return gain->Beyond(errors) && own.Beyond(errors) && gain->nats > LogHypotheses() + kJointPrior &&
         own.nats > kWorthAName * before.col(j).sum();
}

// Judged also in addition to a constant force on each joint, its rival where poses hardly change.
BalanceSelection::Trial BalanceSelection::TryTilt(const BlockCosts& before) const {
  Trial trial{effects::EffectOf(effects::Role::kGravity).id, model_, 0, {}};
  if (model_.tilt) return trial;
  trial.model.tilt = true;
  BalanceModel rival = model_;
  for (int j = 0; j < data_.n; ++j) Insert({Regressor::kConstant}, j, &rival);
  BalanceModel both = rival;
  both.tilt = true;
  const Gain gain = GainOf(before, fit_.LeaveOut(trial.model)),
             added = GainOf(fit_.LeaveOut(rival), fit_.LeaveOut(both));
  if (gain.Beyond(kRareErrors) && gain.nats > LogHypotheses() && added.Beyond(kRareErrors) &&
      added.nats > LogHypotheses() && gain.nats > kWorthAName * before.sum())
    trial.nats = gain.nats;
  return trial;
}

BalanceSelection::Trial BalanceSelection::TryLaw(Regressor law, const BlockCosts& before) const {
  Trial trial{effects::LawOf(law).id, model_, 0, {}};
  for (int j = 0; j < data_.n; ++j) {
    if (IsFiner(law) ? Refined(j) : Has(model_, law, j)) continue;
    BlockCosts from = before;
    if (law == Regressor::kPosition) {
      BalanceModel rival = model_;
      Insert({Regressor::kConstant}, j, &rival);
      from = fit_.LeaveOut(rival);
    }
    double best = 0;
    for (const BalanceModel& with : With(model_, law, j)) {
      Gain gain;
      if (!Pays(law, from, fit_.LeaveOut(with), j, &gain) || gain.nats <= best || !Admissible(with, j))
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
  const auto consider = [&](const Trial& t) {
    if (t.nats <= best.nats) return;
    const size_t after = KindsOf(t.model).size();
    if (static_cast<int>(after) > max_effects_) return;
    if (after > kinds && t.nats < kEffectPrior + LogHypotheses()) return;
    best = t;
  };
  for (const Regressor law : kPlainLaws) consider(TryLaw(law, before));
  consider(TryTilt(before));
  if (best.nats <= 0) return false;
  model_ = best.model;
  // Jointly some may be inadmissible.
  for (const int j : best.joints) {
    while (!Admissible(model_, j) && DropNegative(j)) {
    }
  }
  std::string line = "  + " + best.effect + (best.joints.empty() ? "" : " on");
  for (const int j : best.joints) line += " " + nominal_.joint_names()[j];
  trace_(line + ": " + std::to_string(best.nats) + " nats; " + StateOf(model_));
  return true;
}

bool BalanceSelection::DropNegative(int j) {
  const BalanceSolution s = fit_.Solve(model_);
  int worst = -1;
  for (const int c : model_.features[j]) {
    const Regressor law = balance_.columns[j][c].regressor;
    if (Positive(law) && s.features[j][c] <= 0) worst = c;
    if (IsFiner(law) && worst < 0) worst = c;
  }
  return worst >= 0 && model_.features[j].erase(worst) > 0;
}

// Whether dry friction on joint j cannot be refined: there is none, or it is refined already.
bool BalanceSelection::Refined(int j) const {
  return !Has(model_, Regressor::kDirection, j) ||
         std::ranges::any_of(kFinerLaws, [&](Regressor law) { return Has(model_, law, j); });
}

bool BalanceSelection::AddRefinement() {
  const BlockCosts before = fit_.LeaveOut(model_);
  Trial best;
  std::vector<Regressor> laws = kFinerLaws;
  laws.push_back(Regressor::kConstant);
  for (const Regressor law : laws) {
    const Trial t = TryLaw(law, before);
    if (t.nats > best.nats && static_cast<int>(KindsOf(t.model).size()) <= max_effects_) best = t;
  }
  if (best.joints.empty()) return false;
  model_ = best.model;
  trace_("  refined: " + best.effect + ", " + std::to_string(best.nats) + " nats; " + StateOf(model_));
  return true;
}

// Backward elimination, base parameters last.
void BalanceSelection::Prune() {
  bool changed = true;
  while (changed) {
    changed = PruneDrive();
    if (changed) continue;
    const BlockCosts with = fit_.LeaveOut(model_);
    for (int j = 0; j < data_.n && !changed; ++j) {
      for (const int c : model_.features[j]) {
        const Regressor law = balance_.columns[j][c].regressor;
        if (law == Regressor::kDirection && Refined(j)) continue;  // its refinement needs it
        BalanceModel less = model_;
        less.features[j].erase(c);
        const Gain gain = GainOf(fit_.LeaveOut(less), with);
        const bool habit = !losses_.empty() && losses_[j].count(c) > 0;
        if (habit ? gain.nats > 0 : gain.Beyond(kErrors) && gain.nats > LogHypotheses()) continue;
        trace_("  − " + effects::LawOf(law).id + " " + nominal_.joint_names()[j]);
        model_ = less;
        changed = true;
        break;
      }
    }
  }
  BalanceModel given = model_;
  given.base = false;
  const BlockCosts without = fit_.LeaveOut(given), free = fit_.LeaveOut(model_);
  const Gain base = GainOf(without, free);
  const bool clearly = base.Beyond(kErrors) && base.nats > LogHypotheses();
  if (!clearly && !PaysTogether(without, free)) model_ = given;
  trace_(std::string("  base parameters ") + (model_.base ? "free: " : "as given: ") +
         std::to_string(base.nats) + " ± " + std::to_string(base.stddev) + " nats");
}

std::string BalanceSelection::StateOf(const BalanceModel& m) const {
  const BalanceSolution s = fit_.Solve(m);
  std::string text = "RMS";
  for (int j = 0; j < data_.n; ++j) text += Printf(" %.4g", std::sqrt(s.energy[j]));
  return text;
}

}  // namespace rg::diagnosis
