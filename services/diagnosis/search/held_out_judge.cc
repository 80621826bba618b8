#include "services/diagnosis/search/held_out_judge.h"

#include <algorithm>
#include <set>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/hypotheses/rivals.h"

namespace rg::diagnosis {

namespace {

// Share of the deficit of the model without effects that a model may leave. Hidden states fit nearly
// anything: they must predict more.
constexpr double kMayLeave = 0.5, kMayLeaveHidden = 0.1;

std::string Key(const Candidate& c) { return KeyOf(c.specs, c.base); }

// Whether the likelihood alone may decide to put `effect` in the place of `id`: not for hidden states, free
// base parameters or more effects than before, nor between delays of all sensors and of all drives.
bool MayReplace(const std::string& id, const std::string& effect, const Candidate& c,
                const Candidate& model) {
  const auto of_clock = [](const std::string& of) { return effects::IsIn(effects::Slot::kDelay, of); };
  return !HasUnnamed(c) && (!HasFreeStates(c) || HasFreeStates(model)) &&
         !(of_clock(id) && of_clock(effect)) && (!c.base || model.base) &&
         c.specs.size() <= model.specs.size();
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
  return {Key(c), {c.fit.values.begin(), c.fit.values.end()}, options_.noise_scale, c.fit.step_s};
}

const HeldOut& HeldOutJudge::Of(const Candidate& c) {
  const auto [at, fresh] = known_.try_emplace(About(c));
  if (fresh) {
    at->second = PredictHeldOut(data_, c, options_);
    work_ += at->second.work;
    trace_.Stage("held out", Key(c) + " log density " + std::to_string(at->second.log_density) +
                                 ", deficit " + std::to_string(at->second.deficit));
  }
  return at->second;
}

bool HeldOutJudge::Holds(const Candidate& model, double needed) {
  const HeldOut& own = Of(model);
  return SwingContinues(model) || own.deficit < std::max({kZ99OneSided * own.deficit_stddev,
                                                          0.5 * (kExplained - 1) * own.freedom, needed});
}

int HeldOutJudge::WorstRecording(const Candidate& model, double needed) {
  if (Holds(model, needed)) return -1;
  std::vector<double> sums(data_.recordings.size(), 0.0);
  for (size_t w = 0; w < data_.windows.size(); ++w) sums[data_.windows[w].recording] += Of(model).windows[w];
  return static_cast<int>(std::ranges::min_element(sums) - sums.begin());
}

bool HeldOutJudge::ExplainsMost(const Candidate& model, const Candidate& without) {
  const double may_leave = HasHiddenStates(model) ? kMayLeaveHidden : kMayLeave;
  return Of(model).deficit < may_leave * Of(without).deficit;
}

void HeldOutJudge::CompareRivals(SearchResult* search,
                                 const std::function<double(const Candidate&, const Candidate&)>& needed) {
  Candidate& model = search->best;
  while (true) {  // ends: the log evidence rises each time
    model.held_out = Of(model).log_density;
    const Candidate* likelier = nullptr;
    double most = 0;
    std::set<std::string> ids;
    for (const effects::EffectSpec& e : model.specs) ids.insert(e.id);
    for (const std::string& id : ids) {
      for (const Rival& rival : RivalsOf(*search, id)) {
        Candidate& c = search->tried[static_cast<size_t>(rival.candidate - search->tried.data())];
        if (!c.fit.ok) continue;
        c.held_out = Of(c).log_density;
        const double least =
            IsRicherFriction(rival.effect) ? std::max(kSeparable, needed(model, c) - c.form) : kSeparable;
        const double in_all = TotalEvidence(c) - TotalEvidence(model) - least;
        if (in_all > most && MayReplace(id, rival.effect, c, model) && MostBetter(Of(c), Of(model)))
          likelier = &c, most = in_all;
      }
    }
    if (likelier == nullptr) return;
    trace_.Stage("rival", Key(*likelier) + " by " + std::to_string(most) + " more than it needs");
    model = *likelier;
  }
}

}  // namespace rg::diagnosis
