#include "services/diagnosis/search/further_steps.h"

#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

namespace {

constexpr double kNearlyAll = 0.9;            // of what is left
constexpr int kMaxForwardSteps = 2;           // beside a first effect, before inertials are freed
constexpr double kWorkForForwardSteps = 0.5;  // of the limit, after which no step begins

}  // namespace

// Laws that leave little with inertials as given may lack one more, which costs less to find than free
// inertials.
bool FurtherSteps::ByLaws(const Candidate& before, bool base, Candidate* laws, Candidate* winner) {
  if (state_.ordinary && base != before.base) return false;
  const Candidate* own = base == before.base ? &before : fits_.Known(before.specs, base);
  const double needed = state_.Threshold(before);
  if (own == nullptr || !own->fit.ok || fits_.AtStake(*own) < needed || fits_.Late()) return false;
  const Candidate from = *own;
  Candidate& found = *laws;
  if (!step_.AddLaws(from, needed, &found)) return false;
  const bool nearly = !base && fits_.Excess(found) < (1 - kNearlyAll) * fits_.Excess(from);
  if (nearly && !found.base && !HasUnnamed(found)) found = Better(found, FurtherLaws(found));
  if (!step_.ExplainedByLaws(before, found, state_.Threshold(before, found))) return false;
  *winner = found;
  return true;
}

std::vector<Candidate> FurtherSteps::Starts(const Candidate& before, const Candidate& winner) const {
  std::vector<Candidate> out;
  if (fits_.Late(kWorkForForwardSteps) || fits_.PerRow(winner) < kExplained) return out;
  const auto lacks = [&](const Candidate& c) {
    return c.fit.ok && !c.base && !HasUnnamed(c) && fits_.PerRow(c) > kExplained;
  };
  if (lacks(winner) && winner.score > before.score + state_.Threshold(before, winner)) out.push_back(winner);
  const Candidate* hidden = nullptr;
  for (const auto& [key, c] : fits_.tried()) {
    const bool fresh = c.round == state_.round && lacks(c) && HasHiddenStates(c) &&
                       !HasKind(c.specs, effects::SwingingMass().id) && IsPart(before.specs, c.specs);
    if (fresh && (hidden == nullptr || c.score > hidden->score)) hidden = &c;
  }
  if (hidden != nullptr && (out.empty() || KeyOf(hidden->specs) != KeyOf(out[0].specs)))
    out.push_back(*hidden);
  return out;
}

void FurtherSteps::BesideBest(const Candidate& before, const Candidate& winner, Candidate* best) {
  for (const Candidate& start : Starts(before, winner)) {
    *best = Better(*best,
                   Steps(start, [this](const Candidate& from, Candidate* with) { step_.Add(from, with); }));
    if (fits_.PerRow(*best) < kExplained) return;
  }
}

// By laws of what is recorded alone.
Candidate FurtherSteps::FurtherLaws(const Candidate& account) {
  return Steps(account, [this](const Candidate& from, Candidate* with) {
    step_.AddLaws(from, state_.Threshold(from), with);
  });
}

// Before each step the drives are reconsidered: a further law would absorb a part of what late ones leave.
Candidate FurtherSteps::Steps(Candidate account,
                              const std::function<void(const Candidate&, Candidate*)>& step) {
  for (int more = 0; more < kMaxForwardSteps && !fits_.Late(kWorkForForwardSteps); ++more) {
    if (state_.ordinary) drives_.Late(&account);
    if (!(fits_.PerRow(account) > kExplained)) break;
    Candidate with = account;
    step(account, &with);
    state_.TellOfRound("forward step",
                       KeyOf(with.specs) + " gains " + std::to_string(with.score - account.score));
    if (HasUnnamed(with) || with.score <= account.score + state_.Threshold(account, with)) break;
    account = with;
  }
  return account;
}

}  // namespace rg::diagnosis
