#include "services/diagnosis/diagnosis.h"

#include <algorithm>
#include <optional>
#include <ranges>
#include <utility>

#include "common/base/parallel.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/balance/balance_search.h"
#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/data/words.h"
#include "services/diagnosis/design/separating_motion.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/swing_starts.h"
#include "services/diagnosis/reporting/data_notes.h"
#include "services/diagnosis/reporting/findings.h"
#include "services/diagnosis/reporting/holdout.h"
#include "services/diagnosis/reporting/set_check.h"
#include "services/diagnosis/search/search.h"
#include "services/sysid/rotor_start.h"
#include "services/sysid/sysid_on_set.h"

namespace rg::diagnosis {

namespace {

constexpr double kAllSearches = 1.6;  // work of a search and its restarts together, over the limit of one
constexpr double kLeastWork = 0.6;    // work of each restart, over that limit, at least

// Where a class has more than one effect: the motion to record next, or that none was found.
void SayWhatToRecord(const SearchResult& search, const FitSetting& setting, const DiagnosisOptions& options,
                     int threads, const CancelToken* cancel, DiagnosisResult* result) {
  const auto separates = [](const Alternative& a) { return !a.separable && a.by_motion; };
  const bool open = std::ranges::any_of(
      result->findings, [&](const Finding& f) { return std::ranges::any_of(f.alternatives, separates); });
  // The balance of torques has no sensor noise to plan with; undriven joints cannot follow a plan.
  const auto undriven = [&](int j) {
    return setting.nominal.IsPrescribed(j) || setting.nominal.IsPassive(j);
  };
  const auto joints = std::views::iota(0, setting.nominal.num_joints());
  if (!open || search.measured.active || std::ranges::any_of(joints, undriven)) return;
  result->motion = ProposeMotion(search, setting, result->findings, options.step_s, threads, cancel);
  for (Finding& f : result->findings) {
    for (Alternative& a : f.alternatives) {
      if (!separates(a)) continue;
      a.experiment = result->motion ? result->motion->description + " (motion.csv)"
                                    : a.experiment +
                                          "; no motion tried within the recorded range and the "
                                          "limits is expected to separate them";
    }
  }
}

// The set with held-out recording `place` among those to fit. If it was the only held-out one, the last
// fitted recording is held out instead. Empty where there are too few.
std::optional<recordings::RecordingSet> WithFitted(const recordings::RecordingSet& set, uint32_t place,
                                                   const FitData& data) {
  std::vector<uint32_t> fitted = data.places;
  if (set.Holdout().size() < 2) fitted.pop_back();
  if (fitted.empty()) return std::nullopt;
  fitted.push_back(place);
  recordings::RecordingSet out = set;
  out.KeepForFit(fitted);
  return out;
}

}  // namespace

Result<DiagnosisResult> Diagnose(const recordings::RecordingSet& given, const DiagnosisOptions& options,
                                 const Clock& clock, const ProgressFn& progress, const CancelToken* cancel) {
  RG_RETURN_IF_ERROR(sysid::CheckTimes(options.window_s, options.step_s));
  const double start = clock.SteadySeconds();
  const int threads = ChooseThreads(options.threads);
  RG_ASSIGN_OR_RETURN(sim::Plant nominal, GivenPlant(given, options.model));
  RG_ASSIGN_OR_RETURN(SetCheck check, CheckSet(given, nominal, options.trust_effort));
  RG_RETURN_IF_ERROR(check.refusal);
  RG_ASSIGN_OR_RETURN(FitData data, PrepareData(given, nominal, options));
  // The balance of torques starts from rigid bodies without effects.
  if (EffortIsMeasured(data) && !nominal.effects().empty()) {
    RG_ASSIGN_OR_RETURN(nominal, sim::Plant::Create(nominal.shared_model(), nominal.options()));
  }
  data.held_out = PrepareHeldOut(given, data, nominal, options);
  MotionScales scales = ScalesOf(data, nominal);
  const FitSetting setting{data, nominal, scales};
  DiagnosisResult result;
  result.notes = std::move(check.warnings);
  const auto search_effects = EffortIsMeasured(data) ? SearchMeasuredEffort : SearchEffects;
  SearchResult search = search_effects(setting, options, threads, clock, progress, cancel);

  // A held-out recording that alone excites something is fitted too: the search is made again with its result
  // as first model, within what is left of the work.
  std::optional<recordings::RecordingSet> exchanged;
  if (search.excited_by >= 0 && !(cancel != nullptr && cancel->cancelled())) {
    const auto unseen = static_cast<size_t>(search.excited_by);
    exchanged = WithFitted(given, data.held_out->places[unseen], data);
    const std::string name = data.held_out->recordings[unseen].recording->name;
    if (exchanged) {
      RG_ASSIGN_OR_RETURN(data, PrepareData(*exchanged, nominal, options));
      data.held_out = PrepareHeldOut(*exchanged, data, nominal, options);
      scales = ScalesOf(data, nominal);
      DiagnosisOptions rest = options;
      const double left = std::clamp(kAllSearches - search.work / options.work_limit, kLeastWork, 1.0);
      rest.work_limit = left * options.work_limit;
      // An unnamed force does not extend to where only the new recording moves.
      if (!search.best.specs.empty() && !HasUnnamed(search.best))
        rest.earlier = std::make_shared<const Candidate>(WithoutStates(search.best));
      search = search_effects(setting, rest, threads, clock, progress, cancel);
      result.notes.push_back(name + " shows what the recordings to fit do not: it was fitted too" +
                             (given.Holdout().size() < 2 ? ", another kept aside in its place" : ""));
    }
  }
  const recordings::RecordingSet& set = exchanged ? *exchanged : given;

  result.window_s = options.window_s;
  result.robot = nominal.model().name();
  result.joints = nominal.joint_names();
  result.effort_measured = search.measured.active;
  for (std::string& note : NotesOnMeasurement(result.joints, search.measured))
    result.notes.push_back(std::move(note));
  Conclude(search, setting, &result);
  if (search.out_of_time)
    result.notes.push_back("the time limit of " + Number(options.time_limit_s) +
                           " s ended the search before all was compared: what it found is unsure");
  if (progress) progress({"what to record next", 0.96, 1.0, result.verdict});
  SayWhatToRecord(search, setting, options, threads, cancel, &result);
  if (progress) progress({"held-out recordings", 0.97, 1.0, result.verdict});
  JudgeHeldOut(set, nominal, search, data, options, threads, &result);
  if (const std::string note = NoteOnFreeSwing(result.holdout); search.swings_on && !note.empty())
    result.notes.push_back(note);
  if (WorseThanCalibrated(result.holdout) && !search.best.specs.empty()) {
    result.notes.push_back("what was found (" + KeyOf(search.best.specs) +
                           ") predicts the recordings kept aside worse than " +
                           "calibrated parameters alone (" + Number(result.holdout.after_rms) + " for " +
                           Number(result.holdout.calibrated_rms) +
                           "): the model given has these alone, and was so chosen on recordings kept aside");
    search.best = search.calibrated;
    result.holdout = {}, result.holdout_plots.clear();
    const std::string verdict = result.verdict;
    const std::vector<Finding> named = std::exchange(result.findings, {});
    Conclude(search, setting, &result);
    if (search.swings_on || search.beside_any_force) {
      result.verdict = verdict, result.findings = named;  // all else is of the model given
    } else {
      result.motion.reset();  // it was to separate what was withdrawn
    }
    JudgeHeldOut(set, nominal, search, data, options, threads, &result);
  }
  if (result.plant) {
    for (std::string& note : sysid::NotesOnRotors(*result.plant, result.values))
      result.notes.push_back(std::move(note));
  }
  result.elapsed_s = clock.SteadySeconds() - start;
  return result;
}

}  // namespace rg::diagnosis
