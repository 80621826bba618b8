#include "services/diagnosis/search/held_out_checks.h"

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/swing_starts.h"

namespace rg::diagnosis {

namespace {

constexpr size_t kMaxEffectsWithFixedInertials = 2;  // kinds; more do together what other inertials do

}  // namespace

HeldOutChecks::HeldOutChecks(SearchState& state) : state_(state), fits_(state.fits) {
  if (state.setting.data.held_out != nullptr)
    judge_.emplace(*state.setting.data.held_out, fits_.lifted(), state.trace,
                   HasPendulum(state.setting.nominal.effects()));
}

// With more than two joints few effects cannot imitate wrong inertials on held-out recordings; with fewer
// they can.
bool HeldOutChecks::ExplainedWithFixedInertials(const Candidate& before, const Candidate& named) {
  return state_.setting.data.n > 2 && judge_ && fits_.MeetsSensors(named) && !HasUnnamed(named) &&
         fits_.PerRow(before) >= kConsistent &&
         FreshKinds(before, named).size() <= kMaxEffectsWithFixedInertials &&
         named.score > before.score + state_.Threshold(before, named) &&
         Holds(named, state_.Threshold(before));
}

bool HeldOutChecks::Holds(const Candidate& model, double needed) {
  const bool holds = judge_->Holds(model, needed);
  fits_.AddWork(judge_->TakeWork());
  return holds;
}

bool HeldOutChecks::Refuses(const Candidate& model) {
  return judge_ && !Holds(model, state_.Threshold(model));
}

void HeldOutChecks::Run(const Candidate& without, Candidate* best, int* excited_by) {
  if (!judge_) return;
  const double needed = state_.Threshold(*best);
  if (fits_.PerRow(*best) < kExplained && !SwingsOn(*best, without))
    *excited_by = judge_->WorstRecording(*best, needed);
  const bool named = !best->specs.empty() && !state_.FoundNothing(*best);
  if (named && !judge_->Holds(*best, needed) && !judge_->ExplainsMost(*best, without)) {
    state_.Tell("held out", 0.9, KeyOf(best->specs) + "for nothing");
    *best = without;
  }
  fits_.AddWork(judge_->TakeWork());
}

// The phase of a freely swinging mass is lost within a recording: what little is left there is no other law.
bool HeldOutChecks::SwingsOn(const Candidate& best, const Candidate& without) {
  return HasKind(best.specs, effects::SwingingMass().id) && judge_->ExplainsMost(best, without);
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
