#include "services/diagnosis/search/held_out_checks.h"

#include <algorithm>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/swing_starts.h"

namespace rg::diagnosis {

namespace {

constexpr int kMaxRefusals = 3;
constexpr double kMostOfRest = 0.5;                  // of what a refused model leaves
constexpr size_t kMaxEffectsWithFixedInertials = 2;  // kinds; more do together what other inertials do

}  // namespace

HeldOutChecks::HeldOutChecks(SearchState& state, ForwardStep& step, FurtherSteps& further,
                             Refinement& refinement, Simplifier& simplifier, UnnamedForces& unnamed)
    : state_(state),
      fits_(state.fits),
      step_(step),
      further_(further),
      refinement_(refinement),
      simplifier_(simplifier),
      unnamed_(unnamed) {
  if (state.setting.data.held_out != nullptr)
    judge_.emplace(*state.setting.data.held_out, fits_.lifted(), state.trace,
                   HasPendulum(state.setting.nominal.effects()));
}

// With more than two joints, few effects or one force cannot imitate wrong inertials on held-out recordings;
// with fewer they can.
bool HeldOutChecks::JudgesFewNames() const { return state_.setting.data.n > 2 && judge_; }

bool HeldOutChecks::Predicts(const Candidate& account, double needed) {
  const bool holds = judge_->Holds(account, needed);
  fits_.AddWork(judge_->TakeWork());
  return holds;
}

bool HeldOutChecks::ExplainedWithFixedInertials(const Candidate& before, const Candidate& named) {
  return JudgesFewNames() && fits_.MeetsSensors(named) && !HasUnnamed(named) &&
         fits_.PerRow(before) >= kConsistent &&
         FreshKinds(before, named).size() <= kMaxEffectsWithFixedInertials &&
         named.score > before.score + state_.Threshold(before, named) &&
         Predicts(named, state_.Threshold(before));
}

bool HeldOutChecks::ExplainedByOneForce(const Candidate& before, const Candidate& named, Candidate* out) {
  if (!JudgesFewNames() || fits_.PerRow(named) < kExplained || fits_.Late()) return false;
  const double least = std::max(named.score, before.score) + state_.Threshold(before);
  bool found = false;
  unnamed_.Try(false, kOfPlace, [&](const Candidate& c) {
    found = fits_.MeetsSensors(c) && c.score > least && Predicts(c, state_.Threshold(before));
    if (found) *out = c;
    return found;
  });
  return found;
}

void HeldOutChecks::Run(const Candidate& without, Candidate* best, int* excited_by) {
  if (!judge_) return;
  HeldOutJudge& judge = *judge_;
  if (fits_.PerRow(*best) < kExplained && !SwingsOn(*best, without))
    *excited_by = judge.WorstRecording(*best, state_.Threshold(*best));
  const bool named = !best->specs.empty() && !state_.FoundNothing(*best);
  // Of a force whose place is known the grid is coarse: others would only follow it more closely.
  for (int sent = 0; named && !state_.HasForceInPlace(*best) && sent < kMaxRefusals &&
                     !fits_.Late(kWorkForComparisons) && !judge.Holds(*best, state_.Threshold(*best));
       ++sent) {
    if (!ReplaceRefused(without, sent == 0, best)) break;
  }
  if (judge.Holds(*best, state_.Threshold(*best))) {
    *excited_by = -1;
  } else if (named && !judge.ExplainsMost(*best, without)) {
    state_.Tell("held out", 0.9, KeyOf(best->specs) + "for nothing");
    *best = without;
  }
  fits_.AddWork(judge.TakeWork());
}

// The phase of a freely swinging mass is lost within a recording: what little is left there is no other law.
bool HeldOutChecks::SwingsOn(const Candidate& best, const Candidate& without) {
  return HasKind(best.specs, effects::SwingingMass().id) && judge_->ExplainsMost(best, without);
}

// False: nothing predicts better. `first`: of the models refused.
bool HeldOutChecks::ReplaceRefused(const Candidate& without, bool first, Candidate* best) {
  if (!state_.ordinary) TryUnnamed(best->base, first);
  Candidate with = *best;  // it may lack an effect
  if (first && !HasUnnamed(*best) && !fits_.Late()) AddToRefused(*best, &with);
  const auto rival =
      judge_->Better(*best, fits_.tried(), [&](const Candidate& c) { return state_.Threshold(*best, c); });
  if (!rival) return false;
  state_.Tell("held out", 0.9, KeyOf(best->specs) + "for " + KeyOf(rival->specs));
  *best = HasUnnamed(*rival) ? unnamed_.WithoutCoarse(*rival) : *rival;
  Candidate like = *best;
  if (!HasUnnamed(like) && !fits_.Late()) refinement_.Exchange(without, &like);
  if (judge_->TotalEvidence(like) > judge_->TotalEvidence(*best)) *best = like;
  if (HasFreeStates(*best) && !fits_.Late()) *best = refinement_.Refitted(*best, *best, *best);
  // Effects that were needed in the old model may be superfluous in the new one.
  if (!fits_.Late(kWorkForComparisons)) {
    simplifier_.Run(best);
    *best = refinement_.WithInertialsFreeOrFixed(*best, state_.Threshold(*best));
  }
  return true;
}

// Unnamed forces as rivals, the first time with named effects beside them.
void HeldOutChecks::TryUnnamed(bool base, bool with_names) {
  if (!fits_.Late()) unnamed_.Try(base, kAny, [](const Candidate&) { return false; });
  const Candidate* nameless = unnamed_.Best();
  if (with_names && nameless != nullptr && !fits_.Late()) unnamed_.WithNames(Candidate(*nameless));
}

// It may lack an effect, or have one in the place of another that only the fitted recordings support.
void HeldOutChecks::AddToRefused(const Candidate refused, Candidate* with) {
  step_.Add(refused, kFitsInPlace, with);
  // Beside lags only what a screen promises was tried, and it cannot promise a spring.
  const bool late_drives = HasHiddenStates(refused) && !HasFreeStates(refused);
  if (late_drives && !fits_.MeetsSensors(*with) && !fits_.Late()) step_.AddTransmission(refused, with);
  const auto left = [&](const Candidate& c) { return fits_.PerRow(c) * fits_.noise_scale() - 1; };
  for (const std::string& kind : FreshKinds(Candidate{}, refused)) {
    // What takes most of what is left is the next model to add to.
    if (left(*with) < kMostOfRest * left(refused)) return;
    if (!fits_.Late()) further_.AddWithoutKind(refused, kind, with);
  }
}

void HeldOutChecks::CompareRivals(SearchResult* out) {
  if (!judge_) return;
  if (!fits_.Cancelled())
    judge_->CompareRivals(out,
                          [this](const Candidate& a, const Candidate& b) { return state_.Threshold(a, b); });
  out->swings_on = !fits_.Cancelled() && HasPendulum(out->best.specs) && judge_->SwingContinues(out->best);
  if (out->excited_by >= 0 && judge_->Holds(out->best, state_.Threshold(out->best))) out->excited_by = -1;
}

}  // namespace rg::diagnosis
