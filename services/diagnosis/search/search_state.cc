#include "services/diagnosis/search/search_state.h"

#include <algorithm>
#include <cmath>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/free_force.h"

namespace rg::diagnosis {

namespace {

Misfit LeftBy(const Candidate& c, const FitLedger& fits) {
  return {fits.AtStake(c), 0.5 * (c.fit.chi2 - fits.Noise(c)) / fits.noise_scale()};
}

// The nats of its effects by their Wald statistics.
double Worth(const Candidate& c) {
  if (!c.fit.ok || c.fit.information.size() == 0) return effects::kInf;
  double nats = 0;
  for (size_t i = 0; i < c.specs.size(); ++i) nats += 0.5 * std::pow(Strength(c, i), 2);
  return nats;
}

}  // namespace

std::string KeyOfFit(const Candidate& c) {
  return KeyOf(c.specs, c.base) + std::to_string(c.score) + ' ' + std::to_string(c.fit.chi2);
}

double SearchState::Threshold(const Candidate& best) const {
  return acceptance.Needed(best, Explained(best), LeftBy(best, fits));
}

double SearchState::Threshold(const Candidate& best, const Candidate& c) const {
  return acceptance.Needed(best, Explained(best), LeftBy(best, fits), c);
}

// Not more than by the Wald statistics: against a model without the effects, which may be arbitrarily far
// off, errors in their amplitudes would not count.
double SearchState::Explained(const Candidate& c) const {
  const Candidate* without = fits.Known(given, c.base);
  if (FoundNothing(c) || without == nullptr) return 0.0;
  return std::min(c.score - without->score, Worth(c));
}

bool SearchState::FoundNothing(const Candidate& c) const { return KeyOf(c.specs) == KeyOf(given); }

bool SearchState::IsNewForce(const effects::EffectSpec& s) const { return IsUnnamed(s.id) && !IsGiven(s); }

bool SearchState::HasNewForce(const Candidate& c) const {
  return std::ranges::any_of(c.specs, [&](const auto& s) { return IsNewForce(s); });
}

bool SearchState::HasForceInPlace(const Candidate& c) const {
  return place >= 0 && std::ranges::any_of(c.specs, [&](const auto& s) {
           return IsNewForce(s) && s.joints.back() == setting.nominal.joint_names()[place];
         });
}

const MissingForce& SearchState::Force(const Candidate& c) {
  const auto [at, fresh] = forces_.try_emplace(KeyOfFit(c) + ' ' + std::to_string(fits.noise_scale()));
  if (fresh) at->second = EstimatedForce(c);
  return at->second;
}

MissingForce SearchState::EstimatedForce(const Candidate& c) const {
  const FitModel model{*c.plant, c.fit.values, {}};
  const LiftedOptions options = fits.AsFitted(c);
  return EstimateMissingForce(setting.data, model, InitialStates(setting.data, model, options),
                              setting.scales.torque, FreeForce{}.segment_s, options);
}

void SearchState::Tell(const std::string& stage, double done, const std::string& note) const {
  if (progress) progress({stage, done, 1.0, note});
  trace.Stage(stage, note + " after work " + std::to_string(fits.work_share()));
}

void SearchState::TellOfRound(const std::string& stage, const std::string& note) const {
  Tell(stage, 0.1 + 0.2 * round, note);
}

}  // namespace rg::diagnosis
