#include "services/diagnosis/screening/acceptance.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/screen.h"

namespace rg::diagnosis {

namespace {

constexpr double kFormError = 0.01;  // ε: share of what effects explain, that a law's idealisation may leave
constexpr double kAmplitude = 1e-4;  // share of the same, for an error of 1 % in an amplitude
constexpr double kMostOfIt = 0.5;    // share of the misfit left, that suffices in spite of an idealisation
constexpr double kNearlyAllOfIt = 0.75;  // the same in spite of an error in an amplitude,
constexpr double kSignificant = 3.0;     // where the misfit is so many standard deviations of ½ χ²
constexpr double kFar = 10.0;  // χ² per row beyond noise, above which a model is far from the recordings
constexpr double kSimplerOdds = 3.0;  // nats: odds of 20 to 1

std::string WithSpaces(const std::set<std::string>& joints) {
  std::string out;
  for (const std::string& joint : joints) out += " " + joint;
  return out;
}

// Effects with the joints that are new in `c`.
std::map<std::string, std::set<std::string>> Added(const Candidate& best, const Candidate& c) {
  std::map<std::string, std::set<std::string>> fresh;
  for (const EffectSpec& s : c.specs) {
    if (s.joints.empty() && !Contains(best.specs, s.id, "")) fresh[s.id];
    for (const std::string& joint : s.joints) {
      if (!Contains(best.specs, s.id, joint)) fresh[s.id].insert(joint);
    }
  }
  return fresh;
}

// Whether all that `c` has and `best` has not are losses and timings, of kinds that `best` has on other
// joints.
bool HasOnlyMoreOfDrives(const Candidate& best, const Candidate& c) {
  const auto fresh = Added(best, c);
  return std::ranges::all_of(fresh, [&](const auto& added) {
    const std::string& id = added.first;
    return HasKind(best.specs, id) && (IsLossOfDrives(id) || IsTiming(id));
  });
}

// Whether all kinds of effects that `c` has, `best` has on one joint or another, and all have a name.
bool HasOnlyKindsOf(const Candidate& best, const Candidate& c) {
  return !HasUnnamed(c) &&
         std::ranges::all_of(c.specs, [&](const EffectSpec& s) { return HasKind(best.specs, s.id); });
}

// The standard deviation of ½ χ².
double Scatter(const Candidate& c) { return std::sqrt(0.5 * c.fit.rows); }

}  // namespace

void Acceptance::Note(const ScreenResult& screened, const std::vector<std::string>& joint_names) {
  null_gain_ = std::max(screened.null_gain, 3.0);
  NoteStepRules(screened, joint_names);
}

void Acceptance::NoteStepRules(const ScreenResult& screened, const std::vector<std::string>& joint_names) {
  for (const Scored& h : screened.hypotheses) {
    std::set<std::string> joints;
    for (const int j : h.joints) joints.insert(joint_names[j]);
    double& known = step_rule_[h.effect + WithSpaces(joints)];
    known = std::max(known, std::sqrt(2 * std::max(0.0, h.step_rule)));
  }
}

void Acceptance::NoteBase(const FitData& data, const Candidate& calibrated, const LiftedOptions& options) {
  if (!calibrated.fit.ok) return;
  const FitModel model{*calibrated.plant, calibrated.fit.values, calibrated.parameters};
  base_rule_ = std::sqrt(2 * std::max(0.0, StepRuleGain(data, model, calibrated.fit.states, options)));
}

double Acceptance::Needed(const Candidate& best, double explained, Misfit misfit) const {
  return NeededWithRule(best, explained, misfit, 0.0);
}

double Acceptance::NeededWithRule(const Candidate& best, double explained, Misfit misfit, double rule) const {
  const auto with_rule = [&](double nats) {
    const double amplitude = std::sqrt(2 * nats) + rule;
    return 0.5 * amplitude * amplitude;
  };
  const double scatter = Scatter(best), left = std::max(0.0, misfit.at_stake) + scatter;
  // Far from the recordings windows diverge, and so do their differences between step rules.
  const double most = left > 0.5 * kFar * best.fit.rows ? kMostOfIt * left : effects::kInf;
  const double chance = std::max(1.0, null_gain_ - kEffectPrior);
  if (best.specs.empty() || explained <= 0) return std::min(with_rule(chance), most);
  const double form = std::min(with_rule(kFormError * explained), kMostOfIt * left);
  // Where noise alone is left, what an addition takes is the error of an amplitude.
  const bool significant = misfit.beyond_sensors > kSignificant * scatter;
  const double nearly_all = significant ? kNearlyAllOfIt * (misfit.beyond_sensors + scatter) : effects::kInf;
  const double amplitude = std::min(with_rule(kAmplitude * explained), nearly_all);
  return std::min(std::max({form, amplitude, with_rule(chance)}), most);
}

double Acceptance::Needed(const Candidate& best, double explained, Misfit misfit, const Candidate& c) const {
  double rule = c.base && !best.base ? base_rule_ : 0;
  for (const auto& [id, joints] : Added(best, c)) rule = std::max(rule, StepRule(id, WithSpaces(joints)));
  // The base parameters do not keep what they may owe to the step rule beyond the effect's share.
  if (best.base && !c.base && best.specs.empty())
    return kSimplerOdds - 0.5 * std::max(0.0, base_rule_ * base_rule_ - rule * rule);
  const bool explains_all = misfit.beyond_sensors <= kSignificant * Scatter(best);
  if (best.base && !c.base && (HasOnlyMoreOfDrives(best, c) || (explains_all && HasOnlyKindsOf(best, c))))
    return kSimplerOdds;
  return NeededWithRule(best, explained, misfit, rule);
}

// For joints that were not screened together: the largest of that effect. For effects that the screen cannot
// see: the largest of all.
double Acceptance::StepRule(const std::string& id, const std::string& joints) const {
  const auto at = step_rule_.find(id + joints);
  if (at != step_rule_.end()) return at->second;
  double same = -1, any = 0;
  for (const auto& [key, value] : step_rule_) {
    if (key.rfind(id, 0) == 0) same = std::max(same, value);
    any = std::max(any, value);
  }
  return same >= 0 ? same : any;
}

}  // namespace rg::diagnosis
