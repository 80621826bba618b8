#include "services/diagnosis/search/refinement.h"

#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "common/effects/inference.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/search/trials.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr int kMaxExchanges = 3;  // of effects that are easily taken for each other

}  // namespace

bool Refinement::Exchange(const Candidate& before, Candidate* winner) {
  int left = kMaxExchanges;
  while (left > 0 && Siblings(before, winner)) --left;
  const bool all = FreshKinds(before, *winner) == FreshKinds(Candidate{}, *winner);
  settled_ = left > 0 && all ? KeyOf(winner->specs, winner->base) : "";
  return left < kMaxExchanges;
}

// Whether exchanging a new kind of effect, or the newest, for one that it is easily taken for scores
// better.
bool Refinement::Siblings(const Candidate& before, Candidate* winner) {
  const std::vector<EffectSpec> specs = Refreshed(*winner);
  if (specs.empty()) return false;
  std::set<std::string> kinds = FreshKinds(before, *winner);
  if (kinds.empty()) kinds = {specs.back().id};
  std::vector<TrialSpecs> others;
  Candidate known_best =
      *winner;  // what scored less while the noise was taken to be more may score better now
  const auto consider = [&](const TrialSpecs& other) {
    if (other.empty()) return;
    const Candidate* known = fits_.Known(other, winner->base);
    if (known == nullptr)
      others.push_back(other);
    else if (known->fit.ok)
      known_best = Better(known_best, *known);
  };
  for (const std::string& kind : kinds) {
    for (const TrialSpecs& other : Exchanges(specs, kind, state_.given, setting_.nominal, setting_.scales))
      consider(other);
  }
  const auto is_new = [&](effects::Regressor law) { return kinds.count(effects::LawOf(law).id) > 0; };
  if (is_new(effects::Regressor::kSine) || is_new(effects::Regressor::kLagging))
    consider(RipplesAcrossLags(specs));
  for (const EffectSpec& s : specs) {
    if (kinds.count(s.id) == 0 || state_.IsGiven(s)) continue;
    consider(PlayHeldClosed(specs, s, setting_.nominal, setting_.scales));
    const auto starts = OtherTransmission(s, setting_.nominal, setting_.scales);
    for (const TrialSpecs& start : fits_.Nearest(*winner, starts, 1)) others.push_back(Joined(specs, start));
  }
  const double before_others = winner->score;
  fits_.TryInPlace(others, winner);
  if (known_best.score > before_others + kExchange) *winner = Better(*winner, known_best);
  if (KeyOf(winner->specs) == KeyOf(specs) || !(winner->score > before_others + kExchange)) return false;
  // Free inertials may have stood for what the exchanged law says.
  if (winner->base) *winner = WithInertialsFreeOrFixed(*winner, 0);
  return true;
}

Candidate Refinement::WithInertialsFreeOrFixed(const Candidate& c, double least) {
  if (!c.base && fits_.AtStake(c) < least) return c;  // not so much is left
  const Candidate twin = fits_.Evaluate(Refreshed(c), !c.base, &c, 6, &c);
  const Candidate &plain = c.base ? twin : c, &freed = c.base ? c : twin;
  return freed.score > plain.score + std::max(least, state_.Threshold(plain, freed)) ? freed : plain;
}

void Refinement::ExchangeMasses(const Candidate& before, Candidate* model) {
  const std::map<std::string, Candidate> kept = fits_.tried();
  Candidate other = WithInertialsFreeOrFixed(*model, 0);
  if (other.base != model->base && fits_.Excess(other) < kPartly * fits_.Excess(*model)) {
    Exchange(before, &other);
    if (fits_.PerRow(other) < kConsistent) {
      *model = other;
      return;
    }
  }
  fits_.tried() = kept;
}

Candidate Refinement::Refitted(const Candidate& c, const Candidate& from, const Candidate& rival) {
  const Candidate longer = fits_.Evaluate(RefreshedFrom(c, rival), c.base, &from, 12, &rival);
  if (longer.score < c.score + kExchange) return Better(c, longer);
  return c.base && HasHiddenStates(c) ? WithInertialsFreeOrFixed(longer, 0) : longer;
}

Candidate Refinement::Justified(const Candidate& before, Candidate winner) {
  while (!fits_.Cancelled()) {
    const std::set<std::string> fresh = FreshKinds(before, winner);
    if (fresh.size() < 2) return winner;
    Candidate fewer = winner, freed = winner;
    fewer.score = kNoScore;
    for (const std::string& id : fresh) {
      const std::vector<EffectSpec> specs = WithoutKind(Refreshed(winner), id);
      const Candidate* known = fits_.Known(specs, winner.base);
      const bool late = fits_.Late();
      if (late && known == nullptr) continue;
      fewer = Better(fewer, late ? *known : fits_.Evaluate(specs, winner.base, &winner, 6, &winner));
      if (winner.base || late) continue;
      const Candidate twin = fits_.Evaluate(specs, true, &winner, 6, &winner);
      if (twin.score > winner.score + state_.Threshold(winner, twin)) freed = Better(freed, twin);
    }
    if (freed.base && !winner.base && freed.score > fewer.score) {
      winner = freed;
    } else if (winner.score > fewer.score + state_.Threshold(fewer, winner)) {
      return winner;
    } else {
      winner = fewer;
    }
  }
  return winner;
}

}  // namespace rg::diagnosis
