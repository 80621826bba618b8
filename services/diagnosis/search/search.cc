#include "services/diagnosis/search/search.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <set>

#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/own_chi2.h"
#include "services/diagnosis/likelihood/swing_starts.h"
#include "services/diagnosis/screening/acceptance.h"
#include "services/diagnosis/search/drive_search.h"
#include "services/diagnosis/search/fit_ledger.h"
#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/held_out_judge.h"
#include "services/diagnosis/search/refinement.h"
#include "services/diagnosis/search/simplifier.h"
#include "services/diagnosis/search/trace.h"
#include "services/diagnosis/search/trials.h"
#include "services/diagnosis/search/unnamed_forces.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

// Validity and shares.
constexpr double kRivalShare = 0.25;  // of what free inertials explain, that a screen must promise of a rival
constexpr double kNearlyAll = 0.9;    // of what is left
constexpr double kMost = 0.5;         // of what is left
constexpr double kNoisiest = 4.0;     // variance over the sensors' own: more is motion that no force follows

// How far the search goes.
constexpr int kMaxRefusals = 3;                      // by held-out recordings
constexpr int kMaxForwardSteps = 2;                  // beside a first effect, before inertials are freed
constexpr size_t kMaxEffectsWithFixedInertials = 2;  // kinds; more do together what other inertials do
constexpr size_t kNamesBesideUnnamed = 3;            // fits of effects beside a force without a name
constexpr size_t kFitsInPlace = 2;                   // in the place of a kind, or beside what is refused
constexpr int kWarmStartIterations = 12;             // from where an earlier search ended

// Shares of the work limit.
constexpr double kWorkForForwardSteps = 0.5;  // after which no such step, nor a substitute, begins

class Search {
 public:
  Search(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
         const DiagnosisOptions& options, int threads, const Clock& clock, const ProgressFn& progress,
         const CancelToken* cancel)
      : data_(data),
        nominal_(nominal),
        scales_(scales),
        setting_{data, nominal, scales},
        options_(options),
        progress_(progress),
        trace_(clock),
        fits_(setting_, options, threads, trace_, cancel),
        simplifier_(
            setting_, fits_, needs_, [this](const Candidate& c) { return Threshold(c); },
            [this](const Candidate& c) { return Explained(c); }),
        drives_(
            setting_, fits_, given_, needs_,
            [this](const Candidate& c, Candidate* best) { step_.AddPromised(c, best); },
            [this](const Candidate& c, Candidate* best) { step_.AddTransmission(c, best); }),
        unnamed_(
            setting_, fits_, given_, [this](const Candidate& c) { return Force(c); }, needs_,
            [this](const Candidate& c, Candidate* best) { step_.Add(c, kNamesBesideUnnamed, best); }) {
    if (data.held_out != nullptr)
      judge_.emplace(*data.held_out, fits_.lifted(), trace_, HasPendulum(nominal.effects()));
  }

  SearchResult Run() {
    SearchResult out;
    Tell("noise", 0.02, "");
    const FitModel bare{nominal_, nominal_.parameters().Nominal(), {}};
    const double stair = std::max(0.02, data_.recordings[0].recording->SamplePeriod());
    MissingForce missing = EstimateMissingForce(data_, bare, InitialStates(data_, bare, fits_.lifted()),
                                                scales_.torque, stair, fits_.lifted());
    fits_.SetNoiseScale(
        std::clamp(missing.chi2 / std::max(1.0, missing.rows - missing.unknowns), 1.0, kNoisiest));
    step_.MakeFeatures();
    Tell("calibrate", 0.05, "");
    given_ = SeenEffects(nominal_, [this](const auto& specs) { return fits_.Evaluate(specs, true); });
    out.nominal = fits_.Evaluate(given_, false);
    out.calibrated = fits_.Calibrated(given_);
    if (fits_.PerRow(out.calibrated) > kConsistent) {
      fits_.FindPieces(given_);
      out.calibrated = Better(out.calibrated, fits_.Calibrated(given_));
    }
    acceptance_.NoteBase(data_, out.calibrated, fits_.lifted());
    Candidate best = out.calibrated.score > out.nominal.score + Threshold(out.nominal, out.calibrated)
                         ? out.calibrated
                         : out.nominal;
    if (options_.earlier == nullptr && fits_.PerRow(best) > kConsistent && !fits_.Late()) {
      Tell("drives", 0.08, KeyOf(best.specs));
      if (const auto drives = drives_.Run(out.nominal, out.calibrated)) best = *drives, ordinary_ = true;
      step_.ForgetStepRule();  // of a model that may be forgotten
      LowerNoise(&best, &out);
      if (ordinary_ && fits_.MeetsSensors(best)) simplifier_.Run(&best);
      fits_.Grant(kForwardShare);
      Tell("drives", 0.09, KeyOf(best.specs));
    }
    LowerNoise(&best, &out);
    if (const Candidate* c = options_.earlier.get())
      earlier_ = fits_.Evaluate(Refreshed(*c), c->base, c, kWarmStartIterations, nullptr);
    if (earlier_ && fits_.Late()) best = Better(best, *earlier_);
    std::set<std::string> begun_at;
    for (round_ = 1; round_ <= options_.max_effects && !fits_.Late(); ++round_) {
      // A round that begins at a model where another began ends there too: what it added was removed again.
      step_.SetRound(round_);
      if (!begun_at.insert(KeyOf(best.specs, best.base)).second) break;
      fits_.SetRound(round_);
      const bool added = AddOne(&best);
      if (fits_.shorter_windows() != nullptr) return RestartWithShorterWindows(std::move(out));
      if (!added || one_force_) break;
      // With less noise, a fit that seemed to explain everything may turn out to be a local optimum.
      if (LowerNoise(&best, &out) && !fits_.MeetsSensors(best) && !fits_.Late()) {
        if (refinement_.Exchange(Candidate{}, &best)) simplifier_.Run(&best);
        if (!ordinary_) SubstituteAll(&best);
      }
      // What little a force over a position grid leaves is the grid's coarseness, not a further effect.
      const double nothing = 0.98 + 0.02 * std::min(fits_.PerRow(out.nominal), fits_.PerRow(out.calibrated));
      if ((round_ == 1 || OfPosition(best)) && TryOneForce(&best, std::max(kExplained, nothing), kOfPlace))
        break;
    }
    if (ordinary_) {
      // An ordinary robot mostly lacks more than its drives' losses: substitutes are looked for when forward
      // steps find nothing more.
      SubstituteAll(&best);
      simplifier_.Run(&best);
    } else {
      simplifier_.Prune(&best);
    }
    ExchangeEarlier(&best);
    if ((fits_.PerRow(best) > kExplained || OfPosition(best)) && TryOneForce(&best, effects::kInf, kAny))
      best = unnamed_.WithNames(best);
    if (judge_ && fits_.shorter_windows() == nullptr)
      CheckHeldOut(Better(out.nominal, out.calibrated), &best, &out.excited_by);
    if (fits_.shorter_windows() != nullptr) return RestartWithShorterWindows(std::move(out));
    out.best = best;
    for (const auto& [key, c] : fits_.tried()) out.tried.push_back(c);
    std::sort(out.tried.begin(), out.tried.end(),
              [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
    out.null_gain = acceptance_.null_gain();
    out.noise_scale = fits_.noise_scale(), out.work = fits_.work();
    Tell("locate", 0.95, "");
    const Candidate without = Better(out.nominal, out.calibrated);
    out.threshold = Threshold(out.nominal, out.calibrated);
    out.beside = Threshold(best, out.calibrated);
    if (judge_ && !fits_.Cancelled()) judge_->CompareRivals(&out, needs_);
    out.beside = Threshold(out.best, out.calibrated);
    if (out.excited_by >= 0 && judge_->Holds(out.best, Threshold(out.best))) out.excited_by = -1;
    const FitModel chosen{*out.best.plant, out.best.fit.values, {}};
    out.own_chi2 =
        OwnChi2(data_, chosen, out.best.fit.states, fits_.lifted(), Rng(options_.seed).Split(kOwnDraw));
    out.missing = Force(without);
    out.remaining = Force(out.best);
    return out;
  }

 private:
  // Variables of an unnamed force. One over speed may follow two friction laws: it comes last.
  inline static const std::vector<std::string> kOfPlace = {"position", "drag"};
  inline static const std::vector<std::string> kAny = {"position", "drag", "velocity"};
  static constexpr double kSegment = 0.05;      // s
  static constexpr double kForwardShare = 0.5;  // of the work limit, that a search of drives leaves
  static constexpr uint64_t kOwnDraw = 1000;    // its stream of random numbers, beyond the rounds'

  // The search ends: it is made again over windows of half the length.
  SearchResult RestartWithShorterWindows(SearchResult out) const {
    out.shorter_windows = fits_.shorter_windows(), out.work = fits_.work();
    return out;
  }

  // A model that fits better than any force on the old one could shows that the noise is less than assumed.
  // All scores are brought to the new noise scale.
  bool LowerNoise(Candidate* best, SearchResult* out) {
    const double own = best->fit.chi2 / std::max(1.0, fits_.Noise(*best));
    const double scale = std::max(1.0, std::min(fits_.noise_scale(), own));
    if (0.5 * (1.0 / scale - 1.0 / fits_.noise_scale()) < 1e-3) return false;
    const double before = fits_.noise_scale();
    fits_.SetNoiseScale(scale);
    step_.ForgetScreens();
    for (Candidate* c : {best, &out->nominal, &out->calibrated}) Rescale(before, scale, c);
    return true;
  }

  void Tell(const std::string& stage, double done, const std::string& note) const {
    if (progress_) progress_({stage, done, 1.0, note});
    trace_.Stage(stage, note + " after work " + std::to_string(fits_.work_share()));
  }
  static const Candidate& Better(const Candidate& a, const Candidate& b) { return b.score > a.score ? b : a; }
  MissingForce Force(const Candidate& c) {
    const FitModel model{*c.plant, c.fit.values, {}};
    return EstimateMissingForce(data_, model, InitialStates(data_, model, fits_.lifted()), scales_.torque,
                                kSegment, fits_.lifted());
  }

  Misfit Left(const Candidate& c) const {
    return {fits_.AtStake(c), 0.5 * (c.fit.chi2 - fits_.Noise(c)) / fits_.noise_scale()};
  }
  double Threshold(const Candidate& best) const {
    return acceptance_.Needed(best, Explained(best), Left(best));
  }
  double Threshold(const Candidate& best, const Candidate& c) const {
    return acceptance_.Needed(best, Explained(best), Left(best), c);
  }
  // Log evidence of the effects of a candidate.
  double Explained(const Candidate& c) const {
    const Candidate* without = fits_.Known(given_, c.base);
    if (FoundNothing(c) || without == nullptr) return 0.0;
    return std::min(c.score - without->score, Worth(c));
  }
  // The same by the Wald statistics of its effects: against a model without them, which may be arbitrarily
  // far off, errors in their amplitudes would not count.
  static double Worth(const Candidate& c) {
    if (!c.fit.ok || c.fit.information.size() == 0) return effects::kInf;
    double nats = 0;
    for (size_t i = 0; i < c.specs.size(); ++i) nats += 0.5 * std::pow(Strength(c, i), 2);
    return nats;
  }
  bool FoundNothing(const Candidate& c) const { return KeyOf(c.specs) == KeyOf(given_); }

  bool AddOne(Candidate* best) {
    Tell("screen", 0.1 + 0.2 * round_, KeyOf(best->specs));
    Candidate winner = *best, stepped = *best;
    bool done = false;  // the earlier search explains these recordings too
    if (round_ == 1 && earlier_) {
      winner = Better(winner, *earlier_);
      done = fits_.PerRow(*earlier_) < kExplained;
      if (done) acceptance_.Note(step_.Screen(*best, best->base), nominal_.joint_names());
      done = done && winner.score > best->score + Threshold(*best, winner);
    }
    done = done || (round_ == 1 && ByLaws(*best, &winner));
    for (const bool base : {false, true}) {
      if (fits_.Late() || done) break;
      // Free hidden states and unnamed forces fit nearly anything: models with free inertials are their
      // rivals.
      const bool flexible = best->base && (HasUnnamed(winner) || HasFreeStates(winner));
      if (base && !flexible && fits_.PerRow(winner) < kExplained &&
          winner.score > best->score + Threshold(*best, winner))
        break;
      if (base != best->base && fits_.Known(best->specs, base) == nullptr)
        fits_.Evaluate(Refreshed(*best), base, best);
      const Candidate* own = base == best->base ? best : fits_.Known(best->specs, base);
      if (own == nullptr || !own->fit.ok) continue;
      // Free inertials explain much: only hypotheses that explain it as well with fewer parameters count.
      const bool rival = !base && best->base &&
                         (ordinary_ || fits_.AtStake(*best) < Threshold(*best) ||
                          (round_ > 1 && own->score < best->score - 0.5 * data_.Rows()));
      const Candidate from = *own;
      if (round_ == 1) stepped_from_.insert(KeyOf(from.specs, base));
      const ScreenResult screened = step_.NotedScreen(from, base);
      const double best_gain = screened.hypotheses.empty() ? 0.0 : screened.hypotheses.front().gain;
      if (fits_.AtStake(from) < Threshold(*best) && best_gain < Threshold(*best)) {
        if (base == best->base) break;  // nothing is left
        continue;
      }
      // Around a consistent model a screen is exact; with free inertials it may promise less than what was
      // found without them.
      const bool found = winner.score > best->score + Threshold(*best, winner);
      if (base && round_ > 1 && !flexible && found && fits_.PerRow(from) < kConsistent &&
          from.score + best_gain < winner.score)
        continue;
      double least_gain = rival ? kRivalShare * (best->score - from.score) : 1.0;
      // Where a screen around a consistent model promises all that is left, hypotheses of which it promises
      // little are no rivals.
      const double named_gain = ForwardStep::MostPromised(screened);
      if (fits_.PerRow(from) < kConsistent && named_gain > kNearlyAll * fits_.AtStake(from))
        least_gain = std::max(least_gain, kRivalShare * named_gain);
      step_.AddFrom(from, screened, least_gain, Threshold(*best), base ? 3 : 4, &winner);
      if (fits_.shorter_windows() != nullptr) return false;
      if (base || (best->base && round_ > 1)) continue;
      for (const Candidate& start : ForwardStarts(*best, winner)) {
        stepped = Better(stepped, ForwardSteps(start));
        if (fits_.PerRow(stepped) < kExplained) break;
      }
      if (round_ == 1 && ExplainedByOneForce(*best, Better(winner, stepped), &winner)) {
        one_force_ = true, *best = winner;
        return true;
      }
      if (ExplainedWithFixedInertials(*best, Better(winner, stepped))) break;
      // Where free inertials explain something they are a rival of several effects: URDFs are often off.
      if (!best->base && fits_.PerRow(stepped) < kExplained &&
          stepped.score > winner.score + Threshold(winner, stepped))
        winner = stepped;
    }
    if (stepped.score > winner.score + Threshold(winner, stepped)) winner = stepped;
    // In the place of an unnamed force two effects may do that hold together only beside free inertials: it
    // is enough that they score better.
    if (HasUnnamed(winner) && !one_force_) {
      if (const Candidate* c = BestFreed(fits_.tried(), *best)) winner = Better(winner, ForwardSteps(*c));
    }
    if (KeyOf(winner.specs) == KeyOf(best->specs) && FoundNothing(*best)) {
      if (const Candidate* c = AsGoodAsFreed(fits_.tried(), *best, needs_)) winner = *c;
    }
    if (KeyOf(winner.specs) != KeyOf(best->specs)) {
      Restart(&winner);
      simplifier_.DropAbsent(&winner);
      refinement_.Exchange(*best, &winner);
      winner = refinement_.OrRivalWithFreeInertials(
          *best, refinement_.WithInertialsFreeOrFixed(winner, Threshold(*best)));
    }
    if (const Candidate* c = FewerNames(fits_.tried(), *best, winner, needs_))
      winner = refinement_.Refitted(*c, *c, *c);
    // Fits with hidden states or free inertials end before they converge: the old model is fitted on from the
    // winner's values, or an addition would be credited with what a longer fit alone brings.
    const bool alike = best->base == winner.base;
    if (winner.score > best->score && best->fit.ok && ((best->base && alike) || HasHiddenStates(*best)))
      *best = refinement_.Refitted(*best, alike ? winner : *best, winner);
    if (AddsNothing(*best, winner)) winner = *best;
    // For the same effects, fitted better, a better score is enough.
    const bool same = KeyOf(winner.specs) == KeyOf(best->specs) && winner.base == best->base;
    const double needed = same ? 1.0 : Threshold(*best, winner);
    Tell("decide", 0.1 + 0.2 * round_,
         KeyOf(winner.specs) + " gains " + std::to_string(winner.score - best->score) + " needs " +
             std::to_string(needed));
    const bool accept = winner.score > best->score + needed;
    if (accept) {
      const Candidate justified = refinement_.Justified(*best, winner);
      // Of several effects added at once, what remains may be worth less than none.
      if (!same && justified.score < best->score + Threshold(*best, justified)) return false;
      *best = justified;
      if (ordinary_) drives_.Late(best);
      simplifier_.Run(best);
      if (!ordinary_) SubstituteAll(best);
    }
    return accept;
  }

  // Laws of what is recorded come first, with inertials as given or free: where they leave nothing, hidden
  // states are not looked for. On an ordinary robot inertials stay as the drives left them. Laws that leave
  // little with inertials as given may lack one more, which costs less to find than free inertials.
  bool ByLaws(const Candidate& before, Candidate* winner) {
    Candidate found = *winner;
    for (const bool base : {false, true}) {
      if (ordinary_ && base != before.base) continue;
      const Candidate* own = base == before.base ? &before : fits_.Known(before.specs, base);
      if (own == nullptr || !own->fit.ok || fits_.AtStake(*own) < Threshold(before) || fits_.Late()) continue;
      const Candidate from = *own;
      if (!step_.AddLaws(from, base, Threshold(before), &found)) continue;
      const bool nearly = !base && fits_.Excess(found) < (1 - kNearlyAll) * fits_.Excess(from);
      if (nearly && !found.base && !HasUnnamed(found)) found = Better(found, FurtherLaws(found));
      if (!step_.ExplainedByLaws(before, found, Threshold(before, found))) continue;
      *winner = found;
      return true;
    }
    return false;
  }

  // Where forward steps with fixed inertials begin: the best model, and the best with hidden states.
  std::vector<Candidate> ForwardStarts(const Candidate& before, const Candidate& winner) {
    std::vector<Candidate> out;
    if (fits_.Late(kWorkForForwardSteps) || fits_.PerRow(winner) < kExplained) return out;
    const auto lacks = [&](const Candidate& c) {
      return c.fit.ok && !c.base && !HasUnnamed(c) && fits_.PerRow(c) > kExplained;
    };
    if (lacks(winner) && winner.score > before.score + Threshold(before, winner)) out.push_back(winner);
    const Candidate* hidden = nullptr;
    for (const auto& [key, c] : fits_.tried()) {
      const bool fresh = c.round == round_ && lacks(c) && HasHiddenStates(c) &&
                         !HasKind(c.specs, effects::SwingingMass().id) && IsPart(before.specs, c.specs);
      if (fresh && (hidden == nullptr || c.score > hidden->score)) hidden = &c;
    }
    if (hidden != nullptr && (out.empty() || KeyOf(hidden->specs) != KeyOf(out[0].specs)))
      out.push_back(*hidden);
    return out;
  }

  // Forward steps with fixed inertials until nothing is missing: cheaper than freeing inertials.
  Candidate ForwardSteps(const Candidate& account) {
    return Steps(account, [this](const Candidate& from, Candidate* with) { step_.Add(from, 3, with); });
  }

  // The same by laws of what is recorded alone.
  Candidate FurtherLaws(const Candidate& account) {
    return Steps(account, [this](const Candidate& from, Candidate* with) {
      step_.AddLaws(from, from.base, Threshold(from), with);
    });
  }

  // Before each step the drives are reconsidered: a further law would absorb a part of what late ones leave.
  Candidate Steps(Candidate account, const std::function<void(const Candidate&, Candidate*)>& step) {
    for (int more = 0; more < kMaxForwardSteps && !fits_.Late(kWorkForForwardSteps); ++more) {
      if (ordinary_) drives_.Late(&account);
      if (!(fits_.PerRow(account) > kExplained)) break;
      Candidate with = account;
      step(account, &with);
      Tell("forward step", 0.1 + 0.2 * round_,
           KeyOf(with.specs) + " gains " + std::to_string(with.score - account.score));
      if (HasUnnamed(with) || with.score <= account.score + Threshold(account, with)) break;
      account = with;
    }
    return account;
  }

  void SubstituteAll(Candidate* best) {
    while (Substitute(best)) simplifier_.Run(best);
  }

  // A law bends towards what another, missing one leaves, and hides it: each kind of effect in turn is
  // removed and a forward step made without it.
  bool Substitute(Candidate* best) {
    const std::set<std::string> kinds = FreshKinds(Candidate{}, *best);
    if (kinds.size() < 2 || HasUnnamed(*best) || fits_.MeetsSensors(*best)) return false;
    for (const std::string& kind : kinds) {
      if (fits_.Late(kWorkForForwardSteps)) return false;
      if (ordinary_ && OfAllJoints(*best, kind)) continue;
      Candidate winner = *best;
      AddWithoutKind(*best, kind, &winner);
      if (KeyOf(winner.specs) == KeyOf(best->specs)) continue;
      const bool more = HasKind(given_, kind) || FreshKinds(Candidate{}, winner).size() > kinds.size();
      Tell("substitute", 0.1 + 0.2 * round_,
           KeyOf(winner.specs) + " for " + kind + " gains " + std::to_string(winner.score - best->score));
      if (winner.score <= best->score + (more ? Threshold(*best, winner) : kLeastGainOfExchange)) continue;
      *best = winner;
      return true;
    }
    return false;
  }

  static bool OfAllJoints(const Candidate& c, const std::string& kind) {
    for (size_t i = 0; i < c.specs.size(); ++i) {
      if (c.specs[i].id == kind && diagnosis::OfAllJoints(c, i)) return true;
    }
    return false;
  }

  // A forward step from the model without one kind of effect, once for each such model.
  void AddWithoutKind(const Candidate& account, const std::string& kind, Candidate* winner) {
    const std::vector<EffectSpec> specs = WithoutKind(Refreshed(account), kind);
    if (!stepped_from_.insert(KeyOf(specs, account.base)).second) return;
    const Candidate from = fits_.KnownOrFitted(specs, account.base, &account);
    if (from.fit.ok) step_.Add(from, kFitsInPlace, winner);
  }

  // One unnamed force in the place of all effects found, over two joints' positions or over one of the
  // `variables` of one joint; taken where it leaves less than `worst` χ² per row and scores better.
  bool TryOneForce(Candidate* best, double worst, const std::vector<std::string>& variables) {
    // One force cannot stand for the losses of all drives.
    if (fits_.Cancelled() || ordinary_ || (fits_.PerRow(*best) < kExplained && data_.n > 1)) return false;
    Tell("flexible", 0.3 + 0.15 * round_, KeyOf(best->specs));
    bool taken = false;
    // With free inertials only where the present model has them.
    unnamed_.Try(best->base, variables, [&](const Candidate& c) {
      if (c.score > best->score + Threshold(*best) && fits_.PerRow(c) < worst) *best = c, taken = true;
      return taken && fits_.PerRow(*best) < kExplained;
    });
    return taken;
  }

  // With more than two joints, few effects or one force cannot imitate wrong inertials on held-out
  // recordings; with fewer they can.
  bool JudgesFewNames() const { return data_.n > 2 && judge_; }
  bool PredictsHeldOut(const Candidate& account, double needed) {
    const bool holds = judge_->Holds(account, needed);
    fits_.AddWork(judge_->TakeWork());
    return holds;
  }

  // Whether few effects with fixed inertials explain the recordings and the held-out ones to within their
  // noise: then free inertials are no rival.
  bool ExplainedWithFixedInertials(const Candidate& before, const Candidate& named) {
    return JudgesFewNames() && fits_.MeetsSensors(named) && !HasUnnamed(named) &&
           fits_.PerRow(before) >= kConsistent &&
           FreshKinds(before, named).size() <= kMaxEffectsWithFixedInertials &&
           named.score > before.score + Threshold(before, named) && PredictsHeldOut(named, Threshold(before));
  }

  // The same of one unnamed force that scores better than what has names: then nothing is looked for with
  // free inertials.
  bool ExplainedByOneForce(const Candidate& before, const Candidate& named, Candidate* out) {
    if (!JudgesFewNames() || fits_.PerRow(named) < kExplained || fits_.Late()) return false;
    const double least = std::max(named.score, before.score) + Threshold(before);
    bool found = false;
    unnamed_.Try(false, kOfPlace, [&](const Candidate& c) {
      found = fits_.MeetsSensors(c) && c.score > least && PredictsHeldOut(c, Threshold(before));
      if (found) *out = c;
      return found;
    });
    return found;
  }

  // A model must predict held-out recordings to within their noise. Where it does not, whatever was fitted,
  // or a forward step finds beside it, that predicts them better takes its place; a model that explains less
  // than half of what is missing there is dropped.
  void CheckHeldOut(const Candidate& without, Candidate* best, int* excited_by) {
    HeldOutJudge& judge = *judge_;
    // The phase of a freely swinging mass is lost within a recording: what little is left there is no other
    // law.
    const auto swings_on = [&] {
      return HasKind(best->specs, effects::SwingingMass().id) && judge.ExplainsMost(*best, without);
    };
    if (fits_.PerRow(*best) < kExplained && !swings_on())
      *excited_by = judge.WorstRecording(*best, Threshold(*best));
    const bool named = !best->specs.empty() && !FoundNothing(*best);
    for (int sent = 0; named && sent < kMaxRefusals && !fits_.Late(kWorkForComparisons) &&
                       !judge.Holds(*best, Threshold(*best));
         ++sent) {
      if (!ordinary_) TryUnnamed(best->base, sent == 0);
      Candidate with = *best;  // it may lack an effect
      if (sent == 0 && !HasUnnamed(*best) && !fits_.Late()) AddToRefused(*best, &with);
      const auto rival =
          judge.Better(*best, fits_.tried(), [&](const Candidate& c) { return Threshold(*best, c); });
      if (!rival) break;
      Tell("held out", 0.9, KeyOf(best->specs) + "for " + KeyOf(rival->specs));
      *best = HasUnnamed(*rival) ? unnamed_.WithoutCoarse(*rival) : *rival;
      Candidate like = *best;
      if (!HasUnnamed(like) && !fits_.Late()) refinement_.Exchange(without, &like);
      if (judge.TotalEvidence(like) > judge.TotalEvidence(*best)) *best = like;
      if (HasFreeStates(*best) && !fits_.Late()) *best = refinement_.Refitted(*best, *best, *best);
      // Effects that were needed in the old model may be superfluous in the new one.
      if (!fits_.Late(kWorkForComparisons)) {
        simplifier_.Run(best);
        *best = refinement_.WithInertialsFreeOrFixed(*best, Threshold(*best));
      }
    }
    if (judge.Holds(*best, Threshold(*best))) {
      *excited_by = -1;
    } else if (named && !judge.ExplainsMost(*best, without)) {
      Tell("held out", 0.9, KeyOf(best->specs) + "for nothing");
      *best = without;
    }
    fits_.AddWork(judge.TakeWork());
  }

  // Unnamed forces as rivals, the first time with named effects beside them.
  void TryUnnamed(bool base, bool with_names) {
    if (!fits_.Late()) unnamed_.Try(base, kAny, [](const Candidate&) { return false; });
    const Candidate* nameless = unnamed_.Best();
    if (with_names && nameless != nullptr && !fits_.Late()) unnamed_.WithNames(Candidate(*nameless));
  }

  // It may lack an effect, or have one in the place of another that only the fitted recordings support.
  void AddToRefused(const Candidate refused, Candidate* with) {
    step_.Add(refused, kFitsInPlace, with);
    // Beside lags only what a screen promises was tried, and it cannot promise a spring.
    const bool late_drives = HasHiddenStates(refused) && !HasFreeStates(refused);
    if (late_drives && !fits_.MeetsSensors(*with) && !fits_.Late()) step_.AddTransmission(refused, with);
    const auto left = [&](const Candidate& c) { return fits_.PerRow(c) * fits_.noise_scale() - 1; };
    for (const std::string& kind : FreshKinds(Candidate{}, refused)) {
      // What takes most of what is left is the next model to add to.
      if (left(*with) < kMost * left(refused)) return;
      if (!fits_.Late()) AddWithoutKind(refused, kind, with);
    }
  }

  // A model inconsistent with the noise may be a local optimum that free inertials led to: it is fitted again
  // from nominal inertials over short pieces of the recordings.
  void Restart(Candidate* winner) {
    if (fits_.PerRow(*winner) > kConsistent && !fits_.Late()) *winner = Better(*winner, fits_.Anew(*winner));
  }

  // What was taken for one of several alike effects while others were missing is compared again.
  void ExchangeEarlier(Candidate* best) {
    if (HasUnnamed(*best) || FoundNothing(*best) || FreshKinds(Candidate{}, *best).size() < 2 ||
        fits_.Late(kWorkForComparisons))
      return;
    if (refinement_.Exchange(Candidate{}, best)) simplifier_.Run(best);
  }

  const FitData& data_;
  const sim::Plant& nominal_;
  const MotionScales& scales_;
  FitSetting setting_;
  const DiagnosisOptions& options_;
  const ProgressFn& progress_;
  Trace trace_;
  FitLedger fits_;
  const std::function<double(const Candidate&, const Candidate&)> needs_ =
      [this](const Candidate& a, const Candidate& b) { return Threshold(a, b); };
  Simplifier simplifier_;
  DriveSearch drives_;
  UnnamedForces unnamed_;
  Refinement refinement_{setting_, fits_, needs_};
  Acceptance acceptance_;
  ForwardStep step_{setting_,
                    fits_,
                    acceptance_,
                    trace_,
                    options_.seed,
                    [this](const Candidate& c) { return Threshold(c); },
                    [this](const Candidate& c) { return Force(c); },
                    [this] { return ordinary_; }};
  std::optional<HeldOutJudge> judge_;  // where recordings are kept aside
  int round_ = 0;
  std::optional<Candidate> earlier_;    // the result of an earlier search, refitted to these recordings
  bool ordinary_ = false;               // the losses of all drives were found together
  bool one_force_ = false;              // one unnamed force explains all recordings
  std::set<std::string> stepped_from_;  // models, by key, that a forward step was made from
  std::vector<EffectSpec> given_;       // that the model has which the search starts from
};

}  // namespace

SearchResult SearchEffects(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                           const DiagnosisOptions& options, int threads, const Clock& clock,
                           const ProgressFn& progress, const CancelToken* cancel) {
  return Search(data, nominal, scales, options, threads, clock, progress, cancel).Run();
}

}  // namespace rg::diagnosis
