#include "services/diagnosis/search/forward_step.h"

#include <algorithm>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/hypotheses/rod_screen.h"
#include "services/diagnosis/screening/screen_columns.h"
#include "services/diagnosis/search/pendulum_search.h"
#include "services/diagnosis/search/trials.h"

namespace rg::diagnosis {

namespace {

constexpr double kMost = 0.5;  // of what is left
constexpr double kLeastPromise =
    2.0;  // nats that a screen must promise of a law for a trial beside hidden states
constexpr size_t kPromisedFits = 3;      // of what a screen promises, without a trial
constexpr size_t kFits = 3;              // of a further step on all windows
constexpr size_t kLawFits = 3;           // before hidden states are looked for
constexpr size_t kFitsBesideDrives = 3;  // beside the losses of all drives

}  // namespace

void ForwardStep::SetRound(int round) {
  if (round != round_) ForgetScreens();
  round_ = round;
}

ScreenResult ForwardStep::Screen(const Candidate& current) {
  const std::string key = KeyOfFit(current);
  const auto known = screens_.find(key);
  if (known != screens_.end()) return known->second;
  const bool near = current.fit.ok && fits_.PerRow(current) < kConsistent;
  const LiftedOptions options = fits_.AsFitted(current);
  const ScreenResult screened = ScreenAround(
      setting_, current, {near, fits_.NearestBase(current)}, FeaturesFor(current, near), options,
      Rng(state_.options.seed).Split(static_cast<uint64_t>(round_)), &step_rules_[options.step_s]);
  fits_.AddWork(screened.work);
  return screens_.emplace(key, screened).first->second;
}

FeatureSet ForwardStep::FeaturesFor(const Candidate& current, bool near) const {
  double work = 0;
  FeatureSet all = near ? FeaturesAlongFit(setting_, current, fits_.AsFitted(current), &work) : recorded_;
  fits_.AddWork(work);
  if (HasKind(current.specs, effects::Surface().id)) return OfJoints(all);  // a model has one at most
  return all;
}

std::vector<ScreenResult> ForwardStep::ScreensBesideForce(const Candidate& current, const FreeForce& force,
                                                          const FitData& some,
                                                          const std::vector<uint32_t>& places) {
  const FeatureSet shown = FeaturesFor(current, false);
  FeatureSet features{shown.features, shown.surfaces, {shown.block.joint, {}, {}}};
  for (const uint32_t i : places) {
    features.block.phi.push_back(shown.block.phi[i]);
    if (!shown.block.on_robot.empty()) features.block.on_robot.push_back(shown.block.on_robot[i]);
  }
  const std::vector<ScreenResult> screens = ScreensBeside(
      force, {some, setting_.nominal, setting_.scales}, current, {false, fits_.NearestBase(current)},
      features, fits_.AsFitted(current), Rng(state_.options.seed));
  for (const ScreenResult& screened : screens) {
    fits_.AddWork(screened.work);
    state_.trace.Screen(screened, current.base);
  }
  return screens;
}

ScreenResult ForwardStep::NotedScreen(const Candidate& current) {
  const ScreenResult screened = Screen(current);
  state_.acceptance.Note(screened, setting_.nominal.joint_names());
  state_.trace.Screen(screened, current.base);
  return screened;
}

void ForwardStep::Add(const Candidate& from, Candidate* winner) {
  const ScreenResult screened = Screen(from);
  state_.acceptance.NoteStepRules(screened, setting_.nominal.joint_names());
  state_.trace.Screen(screened, from.base);
  const double needed = state_.Threshold(from);
  AddFrom(from, screened, HasHiddenStates(from) ? std::max(kLeastPromise, needed) : 1.0, needed, kFits,
          winner);
}

// A force without a name follows some of anything while more is missing: it is for what no name takes half
// of.
void ForwardStep::AddPromised(const Candidate& from, Candidate* winner) {
  const ScreenResult screened = Screen(from);
  state_.trace.Screen(screened, from.base);
  ScreenResult named = screened;
  std::erase_if(named.hypotheses, [](const Scored& h) { return IsUnnamed(h.effect); });
  for (const ScreenResult& promised : {named, screened}) {
    AddFrom(from, promised, kLeastPromise, state_.Threshold(from), kFitsBesideDrives, winner);
    if (fits_.Excess(*winner) < kMost * fits_.Excess(from)) return;
  }
}

void ForwardStep::AddTransmission(const Candidate& from, Candidate* winner) {
  const auto nearest = [&](const auto& starts, size_t most) { return fits_.Nearest(from, starts, most); };
  const auto force = [&] { return &state_.Force(from); };
  const auto pool = TransmissionTrials(setting_.data, setting_.nominal, setting_.scales, from, Screen(from),
                                       force, nearest);
  fits_.TryBest(from, pool, {}, kFitsBesideDrives, winner);
}

// The rod, and the law beside it as a screen around the model begins it.
TrialSpecs ForwardStep::WithLaw(const RodStart& start, const ScreenResult& screened) const {
  if (!start.beside) return {start.rod};
  const std::string& law = effects::LawOf(start.beside->regressor).id;
  std::vector<int> on = {start.beside->joint};
  if (start.beside->other >= 0) on.insert(on.begin(), start.beside->other);
  const auto found = std::ranges::find_if(screened.hypotheses,
                                          [&](const Scored& h) { return h.effect == law && h.joints == on; });
  if (found == screened.hypotheses.end()) return {start.rod};
  return Joined({start.rod}, SpecsFor(*found, setting_.nominal, setting_.scales).front());
}

void ForwardStep::AddRods(const Candidate& from, Candidate* winner) {
  double work = 0;
  const auto rods =
      ScreenRods(setting_, state_.Force(from), FeaturesFor(from, false), fits_.lifted().threads, &work);
  fits_.AddWork(work);
  if (rods.empty()) return;
  const ScreenResult screened = Screen(from);
  std::vector<FollowedStart> starts;
  for (const RodStart& start : rods) {
    starts.push_back({WithLaw(start, screened), start});
    state_.trace.Stage("rod of " + std::to_string(start.swing.length) + " m",
                       KeyOf(starts.back().specs) + " leaves " + std::to_string(start.left));
  }
  Candidate found = from;
  PendulumSearch(setting_, fits_, state_.trace, from, {}).Follow(starts, &found);
  if (found.score > winner->score) *winner = found;
}

void ForwardStep::AddMount(const Candidate& from, Candidate* winner) {
  if (HasKind(from.specs, effects::SoftMount().id)) return;
  fits_.TryBest(from, MountStarts(setting_.nominal, setting_.scales), {}, 1, winner);
}

void ForwardStep::AddOnJoint(const Candidate& from, int joint, const TrialSpecs& beside, Candidate* winner) {
  const auto with = [&](std::vector<TrialSpecs> starts) {
    for (TrialSpecs& start : starts) start = Joined(beside, start);
    return starts;
  };
  const auto nearest = [&](const auto& starts, size_t most) {
    return fits_.Nearest(from, with(starts), most);
  };
  const auto force = [&] { return &state_.Force(from); };
  const auto pool = with(TrialsOnJoint(joint, setting_.data, setting_.nominal, setting_.scales, from,
                                       Screen(from), force, nearest));
  fits_.TryBest(from, pool, {}, kLawFits, winner);
}

void ForwardStep::AddFrom(const Candidate& from, const ScreenResult& screened, double least, double needed,
                          size_t count, Candidate* winner) {
  // Where a law of what is recorded leaves nothing, what no screen sees is not looked for.
  if (least <= 1.0 && MostPromised(from, screened) > kMost * fits_.AtStake(from)) {
    const double before = winner->score;
    Try(from, screened, kLeastPromise, needed, count, winner);
    const bool better = winner->score > before;
    if (better && (ExplainedByLaws(from, *winner, needed) || TakesMost(from, *winner))) return;
  }
  Try(from, screened, least, needed, count, winner);
}

bool ForwardStep::AddLaws(const Candidate& from, double needed, Candidate* winner) {
  const ScreenResult screened = NotedScreen(from);
  if (!(MostPromised(from, screened) > kMost * fits_.AtStake(from))) return false;
  Try(from, screened, kLeastPromise, needed, kLawFits, winner);
  return true;
}

void ForwardStep::Try(const Candidate& from, const ScreenResult& screened, double least, double needed,
                      size_t count, Candidate* winner) {
  const FitData& data = setting_.data;
  const auto nearest = [&](const auto& starts, size_t most) { return fits_.Nearest(from, starts, most); };
  const auto force = [&] { return &state_.Force(from); };
  const bool near = from.fit.ok && fits_.PerRow(from) < kConsistent;
  const auto promised =
      Promised(from, screened, setting_.nominal, setting_.scales, near, needed, kPromisedFits);
  const auto pool = Trials(data, setting_.nominal, setting_.scales, from, screened, least, force, nearest);
  fits_.TryBest(from, pool, promised, count, winner);
}

bool ForwardStep::ExplainedByLaws(const Candidate& from, const Candidate& found, double needed) const {
  return found.score > from.score + needed && fits_.MeetsSensors(found) && !HasUnnamed(found) &&
         !HasUnseenStates(found) && Slides(found, setting_.scales);
}

// Whether it takes most of what the losses of all drives leave. What else is missing is then looked for
// beside it, and not among what no screen sees.
bool ForwardStep::TakesMost(const Candidate& from, const Candidate& found) const {
  return state_.ordinary && found.fit.ok && fits_.Excess(found) < kMost * fits_.Excess(from);
}

double ForwardStep::BestGain(const Candidate& from, const ScreenResult& screened) const {
  const auto known = [&](const Scored& h) {
    const bool pair = effects::FindEffect(h.effect)->scope == effects::Scope::kJointPair;
    if (pair || h.joints.size() < 2) return AlreadyIn(from.specs, h, setting_.nominal);
    return std::ranges::all_of(
        h.joints, [&](int j) { return Contains(from.specs, h.effect, setting_.nominal.joint_names()[j]); });
  };
  const auto best = std::ranges::find_if_not(screened.hypotheses, known);
  return best == screened.hypotheses.end() ? 0.0 : best->gain;
}

double ForwardStep::MostPromised(const Candidate& from, const ScreenResult& screened) const {
  const auto known = [&](const Scored& h) { return AlreadyIn(from.specs, h, setting_.nominal); };
  double most = 0;
  for (const Scored& h : screened.hypotheses) {
    const bool sprung =
        effects::IsIn(effects::Slot::kTransmission, h.effect);  // play and mounts look like it
    if (!IsUnnamed(h.effect) && !sprung && !known(h)) most = std::max(most, h.gain);
  }
  for (const auto* list : {&screened.sets, &screened.pairs}) {
    for (const Combination& c : *list) {
      if (std::ranges::none_of(c.parts, known)) most = std::max(most, c.gain);
    }
  }
  return most;
}

}  // namespace rg::diagnosis
