#include "services/diagnosis/search/held_out_judge.h"

#include <algorithm>
#include <set>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/hypotheses/rivals.h"

namespace rg::diagnosis {

namespace {

// Of what a model without an account is short of noise by, that it may be short of itself. States that no
// sensor reads follow nearly anything that they are fitted to: they are there where they predict.
constexpr double kMayLeave = 0.5, kMayLeaveHidden = 0.1;

// Whether a force without a name is all that it has.
bool Nameless(const Candidate& c) {
  return !c.specs.empty() && std::all_of(c.specs.begin(), c.specs.end(),
                                         [](const effects::EffectSpec& e) { return IsUnnamed(e.id); });
}

std::string Key(const Candidate& c) { return KeyOf(c.specs, c.base); }

// Whether `effect` in the place of `id` is a matter of which is likelier, and of no more than that: states
// that no sensor reads take more to be believed; all sensors late are all drives late.
bool MayReplace(const std::string& id, const std::string& effect, const Candidate& c,
                const Candidate& account) {
  const auto of_clock = [](const std::string& of) { return effects::IsIn(effects::Slot::kDelay, of); };
  return !HasUnnamed(c) && (!HasFreeStates(c) || HasFreeStates(account)) &&
         !(of_clock(id) && of_clock(effect)) && (!c.base || account.base) &&
         c.specs.size() <= account.specs.size();
}

// Whether `a` predicts most windows better than `b`.
bool MostBetter(const HeldOut& a, const HeldOut& b) {
  long better = 0;
  if (a.windows.size() != b.windows.size()) return false;
  for (size_t w = 0; w < a.windows.size(); ++w) better += a.windows[w] > b.windows[w] ? 1 : -1;
  return better > 0;
}

}  // namespace

HeldOutJudge::Question HeldOutJudge::About(const Candidate& c) const {
  return {Key(c), {c.fit.values.begin(), c.fit.values.end()}, options_.noise_scale};
}

const HeldOut& HeldOutJudge::Of(const Candidate& c) {
  const auto [at, fresh] = known_.try_emplace(About(c));
  if (fresh) {
    at->second = Predicted(data_, c, options_);
    work_ += at->second.work;
    trace_.Stage("held out", Key(c) + " " + std::to_string(at->second.log_density) + ", short of noise by " +
                                 std::to_string(at->second.short_of_noise));
  }
  return at->second;
}

bool HeldOutJudge::Holds(const Candidate& account, double needed) {
  const HeldOut& own = Of(account);
  return (own.swings_on && !rod_given_) ||
         own.short_of_noise <
             std::max({kOnePercent * own.scatter, 0.5 * (kExplained - 1) * own.free, needed});
}

int HeldOutJudge::Refusing(const Candidate& account, double needed) {
  if (Holds(account, needed)) return -1;
  std::vector<double> sums(data_.recordings.size(), 0.0);
  for (size_t w = 0; w < data_.windows.size(); ++w)
    sums[static_cast<size_t>(data_.windows[w].recording)] += Of(account).windows[w];
  return static_cast<int>(std::min_element(sums.begin(), sums.end()) - sums.begin());
}

bool HeldOutJudge::ExplainsMost(const Candidate& account, const Candidate& without) {
  const double may_leave = HasHiddenStates(account) ? kMayLeaveHidden : kMayLeave;
  return Of(account).short_of_noise < may_leave * Of(without).short_of_noise;
}

std::optional<Candidate> HeldOutJudge::Better(const Candidate& account,
                                              std::map<std::string, Candidate>& tried,
                                              const std::function<double(const Candidate&)>& needed) {
  const HeldOut own = Of(account);
  std::vector<const Candidate*> others;
  for (const auto& [key, c] : tried) {
    if (c.fit.ok && key != Key(account)) others.push_back(&c);
  }
  std::sort(others.begin(), others.end(),
            [](const Candidate* a, const Candidate* b) { return a->score > b->score; });
  std::optional<Candidate> best;
  double most = 0;
  for (const Candidate* c : others) {
    // Where an account does not hold and what has no law predicts better than it, its law is none, however
    // much better it was made to fit.
    const double behind = needed(*c) + (Nameless(*c) ? 0.0 : account.score - c->score);
    // What nothing on these recordings could make up for.
    if (behind > own.short_of_noise + kOnePercent * own.scatter) continue;
    const HeldOut& theirs = Of(*c);
    const double odds = theirs.log_density - own.log_density - behind;
    if (!(odds > most)) continue;
    // What strikes few windows is none the less refuted by names that hold throughout. A force without one
    // pays nothing for its own fit, and windows may run away from what is true.
    if (PredictsMore(theirs, own) || (!HasUnnamed(*c) && Holds(*c, needed(*c)))) most = odds, best = *c;
  }
  if (!best) return best;
  const double reached = Of(*best).log_density;
  for (auto& [key, c] : tried) {
    const auto known = known_.find(About(c));
    if (known == known_.end()) continue;
    const double worse = std::max(0.0, reached - known->second.log_density);
    c.score -= worse, c.docked += worse;
  }
  return best;
}

void HeldOutJudge::WeighRivals(SearchResult* search,
                               const std::function<double(const Candidate&, const Candidate&)>& needed) {
  Candidate& account = search->best;
  while (true) {  // each is likelier than the one before: it ends
    account.held_out = Of(account).log_density;
    const Candidate* likelier = nullptr;
    double most = 0;
    std::set<std::string> ids;
    for (const effects::EffectSpec& e : account.specs) ids.insert(e.id);
    for (const std::string& id : ids) {
      for (const Rival& rival : RivalsOf(*search, id)) {
        Candidate& c = search->tried[static_cast<size_t>(rival.candidate - search->tried.data())];
        if (!c.fit.ok) continue;
        c.held_out = Of(c).log_density;
        const double least =
            IsRicherFriction(rival.effect) ? std::max(kSeparable, needed(account, c) - c.form) : kSeparable;
        const double in_all = InAll(c) - InAll(account) - least;
        if (in_all > most && MayReplace(id, rival.effect, c, account) && MostBetter(Of(c), Of(account)))
          likelier = &c, most = in_all;
      }
    }
    if (likelier == nullptr) return;
    trace_.Stage("likelier in all", Key(*likelier) + " by " + std::to_string(most) + " more than it needs");
    account = *likelier;
  }
}

}  // namespace rg::diagnosis
