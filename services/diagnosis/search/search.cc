#include "services/diagnosis/search/search.h"

#include <algorithm>
#include <optional>
#include <set>

#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/field_starts.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/own_chi2.h"
#include "services/diagnosis/search/drive_search.h"
#include "services/diagnosis/search/force_locator.h"
#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/further_steps.h"
#include "services/diagnosis/search/held_out_checks.h"
#include "services/diagnosis/search/refinement.h"
#include "services/diagnosis/search/search_state.h"
#include "services/diagnosis/search/simplifier.h"

namespace rg::diagnosis {

namespace {

// Validity and shares.
constexpr double kRivalShare = 0.25;  // of what free inertials explain, that a screen must promise of a rival
constexpr double kNearlyPromised = 0.9;  // of what is left
constexpr double kStair = 0.02;          // s, of a force that follows what is missing
constexpr double kLeastRows = 0.2;       // of all, beyond the unknowns of such a force, that tell the noise
constexpr double kNoisiest = 4.0;  // variance over the sensors' own: more is motion that no force follows
constexpr double kLeftBesideForce = 0.1;  // of an unnamed force's excess, by effects beside it

// How far the search goes.
constexpr size_t kLawsTried = 8, kLawsForInertials = 2;  // in the place of free inertials; of them fitted
constexpr int kNamesBesideForce = 2;                     // one after another
constexpr int kForceIterations = 12;                     // of an unnamed force in the place of effects
constexpr int kWarmStartIterations = 12;                 // from where an earlier search ended
constexpr double kForwardShare = 0.5;                    // of the work limit, that a search of drives leaves

constexpr uint64_t kOwnDraw = 1000;  // its stream of random numbers, beyond the rounds'

class Search {
 public:
  Search(const FitSetting& setting, const DiagnosisOptions& options, int threads, const Clock& clock,
         const ProgressFn& progress, const CancelToken* cancel)
      : state_(setting, options, threads, clock, progress, cancel) {}

  SearchResult Run() {
    MeasureNoise();
    Candidate best = Calibrated();
    TakeEarlier(&best);
    AddDrives(&best);
    AddEffects(&best);
    Simplify(&best);
    ReplaceRefused(&best);
    checks_.Run(Without(), &best, &out_.excited_by);
    Conclude(best);
    return std::move(out_);
  }

 private:
  // The variance that remains when any force is allowed.
  void MeasureNoise() {
    state_.Tell("noise", 0.02, "");
    const FitModel bare{setting_.nominal, setting_.nominal.parameters().Nominal(), {}};
    const MissingForce force =
        ForceOnStairs(bare, InitialStates(setting_.data, bare, fits_.lifted()), fits_.lifted());
    fits_.SetNoiseScale(std::clamp(NoiseBeside(force), 1.0, kNoisiest));
    step_.MakeFeatures();
  }

  // The given effects with base parameters as given and free, whichever is accepted.
  Candidate Calibrated() {
    state_.Tell("calibrate", 0.05, "");
    state_.given =
        SeenEffects(setting_.nominal, [this](const auto& specs) { return fits_.Evaluate(specs, true); });
    out_.nominal = fits_.Evaluate(state_.given, false);
    out_.calibrated = fits_.Calibrated(state_.given);
    if (fits_.PerRow(out_.calibrated) > kConsistent) {
      fits_.FindPieces(state_.given);
      out_.calibrated = Better(out_.calibrated, fits_.Calibrated(state_.given));
    }
    state_.acceptance.NoteBase(setting_.data, out_.calibrated, fits_.AsFitted(out_.calibrated));
    return Gains(out_.calibrated, out_.nominal) ? out_.calibrated : out_.nominal;
  }

  // The losses of all drives together, where the model is far off.
  void AddDrives(Candidate* best) {
    const bool known = earlier_ && earlier_->fit.ok && fits_.PerRow(*earlier_) < kConsistent;
    const bool of_drives = known && std::ranges::any_of(earlier_->specs, [](const EffectSpec& spec) {
                             return IsLossOfDrives(spec.id);
                           });
    if ((!known || of_drives) && fits_.PerRow(*best) > kConsistent && !fits_.Late()) {
      state_.Tell("drives", 0.08, KeyOf(best->specs));
      if (const auto drives = of_drives ? earlier_ : drives_.Run(out_.nominal, out_.calibrated))
        *best = *drives, state_.ordinary = true;
      step_.ForgetStepRule();  // of a model that may be forgotten
      LowerNoise(best);
      if (state_.ordinary) LowerNoiseBesideDrives(best);
      if (state_.ordinary && fits_.MeetsSensors(*best)) simplifier_.Run(best);
      fits_.Grant(kForwardShare);
      state_.Tell("drives", 0.09, KeyOf(best->specs));
    }
    LowerNoise(best);
  }

  // The result of an earlier search, refitted to these recordings.
  void TakeEarlier(Candidate* best) {
    const Candidate* c = options_.earlier.get();
    if (c == nullptr) return;
    LowerNoise(best);
    earlier_ = fits_.Evaluate(Refreshed(*c), c->base, c, kWarmStartIterations, nullptr);
    if (fits_.Late()) *best = Better(*best, *earlier_);
  }

  // Rounds, each of which adds something, until nothing is accepted or one force explains what is left.
  void AddEffects(Candidate* best) {
    std::set<std::string> begun_at;
    int& round = state_.round;
    for (round = 1; round <= options_.max_effects && !fits_.Late(); ++round) {
      // A round that begins at a model where another began ends there too: what it added was removed again.
      step_.SetRound(round);
      if (!begun_at.insert(KeyOf(best->specs, best->base)).second) return;
      fits_.SetRound(round);
      if (!AddOne(best)) return;
      LowerNoise(best);
    }
  }

  // What the rounds left that is not needed, and forces that one without a name does as well.
  void Simplify(Candidate* best) {
    if (state_.ordinary) {
      simplifier_.Run(best);
    } else {
      simplifier_.Prune(best);
    }
    ExchangeEarlier(best);
    OneLawInPlaceOfInertials(best);
    UnnamedInPlaceOfLaw(best);
    if (TakeOneForce(best)) NameBesideForce(best);
  }

  void Conclude(const Candidate& best) {
    out_.best = best;
    out_.out_of_time = fits_.OutOfTime();
    for (const auto& [key, c] : fits_.tried()) out_.tried.push_back(c);
    std::ranges::sort(out_.tried, [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
    out_.null_gain = state_.acceptance.null_gain();
    out_.noise_scale = fits_.noise_scale();
    state_.Tell("locate", 0.95, "");
    out_.threshold = state_.Threshold(out_.nominal, out_.calibrated);
    out_.beside = state_.Threshold(best, out_.calibrated);
    checks_.CompareRivals(&out_);
    out_.beside_any_force = locator_.NameBeside(&out_.best);
    if (out_.beside_any_force) out_.swings_on = false, out_.tried.push_back(out_.best);
    if (!state_.FoundNothing(out_.best) && !fits_.Late(kWorkForComparisons))
      out_.best = fits_.WithExactValues(out_.best);
    out_.work = fits_.work();
    out_.beside = state_.Threshold(out_.best, out_.calibrated);
    const FitModel chosen{*out_.best.plant, out_.best.fit.values, {}};
    out_.own_chi2 = OwnChi2(setting_.data, chosen, out_.best.fit.states, fits_.AsFitted(out_.best),
                            Rng(options_.seed).Split(kOwnDraw));
    out_.missing = state_.Force(Without());
    out_.remaining = state_.Force(out_.best);
  }

  // The better model without effects beyond the given ones.
  const Candidate& Without() const { return Better(out_.nominal, out_.calibrated); }

  // Whether `c` is accepted in the place of `best`.
  bool Gains(const Candidate& c, const Candidate& best) const {
    return c.score > best.score + state_.Threshold(best, c);
  }

  // Force over steps of kStair; its chi2 is over the noise assumed so far.
  MissingForce ForceOnStairs(const FitModel& model, const NodeStates& states,
                             const LiftedOptions& options) const {
    const double stair = std::max(kStair, setting_.data.recordings[0].recording->SamplePeriod());
    return EstimateMissingForce(setting_.data, model, states, setting_.scales.torque, stair, options);
  }
  // Variance over the sensors' own that such a force does not follow.
  double NoiseBeside(const MissingForce& force) const {
    return fits_.noise_scale() * force.chi2 / std::max(1.0, force.rows - force.unknowns);
  }

  // Losses change with every reversal, which a force on stairs cannot follow: they count as noise until the
  // model has them.
  void LowerNoiseBesideDrives(Candidate* best) {
    if (fits_.noise_scale() <= 1 || !best->fit.ok || fits_.MeetsSensors(*best)) return;
    const MissingForce force =
        ForceOnStairs({*best->plant, best->fit.values, {}}, best->fit.states, fits_.AsFitted(*best));
    const bool known = force.lost == 0 && force.rows - force.unknowns > kLeastRows * force.rows;
    if (known) ScaleNoise(NoiseBeside(force), best);
  }

  // A model that fits better than any force on the old one could shows that the noise is less than assumed.
  void LowerNoise(Candidate* best) { ScaleNoise(best->fit.chi2 / std::max(1.0, fits_.Noise(*best)), best); }

  // All scores are brought to the new noise scale, where it is less than the old one.
  void ScaleNoise(double to, Candidate* best) {
    const double scale = std::max(1.0, std::min(fits_.noise_scale(), to));
    if (0.5 * (1.0 / scale - 1.0 / fits_.noise_scale()) < 1e-3) return;
    const double before = fits_.noise_scale();
    fits_.SetNoiseScale(scale);
    step_.ForgetScreens();
    state_.acceptance.RescaleBase(before, scale);
    for (Candidate* c : {best, &out_.nominal, &out_.calibrated}) Rescale(before, scale, c);
    if (earlier_) Rescale(before, scale, &*earlier_);
  }

  // One round. Whether `best` became another model, to which more may be added.
  bool AddOne(Candidate* best) {
    state_.TellOfRound("screen", KeyOf(best->specs));
    Candidate winner = *best, stepped = *best, sprung = *best, laws = *best;
    const bool done = state_.round == 1 &&
                      (ExplainedByEarlier(*best, &winner) || ExplainedByLaws(*best, false, &laws, &winner) ||
                       Located(*best, true, &winner) || ExplainedByLaws(*best, true, &laws, &winner) ||
                       UnseenBesideLaws(*best, &winner, &sprung) || Located(*best, false, &winner));
    // What an unnamed force leaves where any force leaves nothing is its grid's coarseness.
    if (state_.HasForceInPlace(winner)) {
      *best = winner;
      return false;
    }
    bool decided = done;
    for (const bool base : {false, true})
      decided = decided || fits_.Late() || AddWithInertials(base, *best, &winner, &stepped);
    if (Gains(stepped, winner)) winner = stepped;
    if (!done) winner = Better(Better(winner, sprung), laws);
    Refine(best, &winner);
    return Accept(winner, best);
  }

  // Whether laws of what is recorded explain what is missing; else `laws` is the best of them, once it is
  // told from what is easily taken for it.
  bool ExplainedByLaws(const Candidate& best, bool base, Candidate* laws, Candidate* winner) {
    if (further_.ByLaws(best, base, laws, winner)) return true;
    const bool asked = base == best.base || !state_.ordinary;
    if (!asked || fits_.Late() || !(fits_.Excess(*laws) < kPartly * fits_.Excess(best))) return false;
    if (!ToldApart(best, laws)) return false;
    if (!step_.ExplainedByLaws(best, *laws, state_.Threshold(best, *laws))) return false;
    *winner = *laws;
    return true;
  }

  // Which law of friction the drives of an ordinary robot have and how late they are was chosen while `laws`
  // were missing, and is chosen again beside them; its masses were. Elsewhere a law that was found may be one
  // that it is easily taken for, and laws that leave much may lack other masses, which cost less to find than
  // hidden states. False where they are no laws of what is recorded.
  bool ToldApart(const Candidate& best, Candidate* laws) {
    if (state_.ordinary) {
      drives_.Reconsider(best, laws);
      return true;
    }
    if (HasUnnamed(*laws) || HasUnseenStates(*laws)) return false;
    refinement_.Exchange(best, laws);
    if (fits_.PerRow(*laws) > kConsistent) refinement_.ExchangeMasses(best, laws);
    return true;
  }

  // Whether what no screen sees explains what is missing, alone or beside laws: while it is missing too, none
  // of these leaves little. `sprung`: the best spring or play beside laws that leaves more.
  bool UnseenBesideLaws(const Candidate& best, Candidate* winner, Candidate* sprung) {
    const std::string& swinging = effects::SwingingMass().id;
    const bool swings = HasKind(best.specs, swinging) || HasKind(setting_.nominal.effects(), swinging);
    for (const Candidate& from : Plain(best)) {
      if (fits_.PerRow(from) < kExplained || fits_.Late()) continue;
      state_.TellOfRound("unseen", KeyOf(from.specs, from.base));
      if (!swings) step_.AddRods(from, winner);
      // A mount, a spring or play alone is among what is tried in any case.
      const bool law = KeyOf(from.specs) != KeyOf(best.specs);
      if (law) step_.AddMount(from, winner);
      if (fits_.PerRow(*winner) < kExplained && Gains(*winner, best)) return true;
      if (law && fits_.Excess(from) < kPartly * fits_.Excess(best) &&
          TransmissionExplains(from, best, winner, sprung))
        return true;
    }
    // A mount beside free inertials alone is in no trial of several joints.
    const Candidate* freed = fits_.Known(best.specs, true);
    if (setting_.data.n <= 2 || freed == nullptr || !freed->specs.empty() || !freed->fit.ok ||
        fits_.PerRow(*freed) < kExplained || fits_.Late())
      return false;
    step_.AddMount(Candidate(*freed), winner);
    return fits_.PerRow(*winner) < kExplained && Gains(*winner, best);
  }

  // Whether a spring or play beside these laws leaves nothing. What a motor behind it does imitates losses
  // and late drives: one that leaves little, and not nothing, may be these.
  bool TransmissionExplains(const Candidate& from, const Candidate& best, Candidate* winner,
                            Candidate* sprung) {
    Candidate found = from;
    step_.AddTransmission(from, &found);
    if (KeyOf(found.specs) == KeyOf(from.specs)) return false;
    const bool little = fits_.PerRow(found) < kExplained;
    if (!little) *sprung = Better(*sprung, found);
    if (!little || !fits_.LeavesNothing(found) || !Gains(found, best)) return false;
    *winner = Better(*winner, found);
    return true;
  }

  // `best` with inertials as given and free, and the laws that leave least with either.
  std::vector<Candidate> Plain(const Candidate& best) const {
    std::vector<Candidate> out, laws;
    for (const bool base : {false, true}) {
      const Candidate* own = base == best.base ? &best : fits_.Known(best.specs, base);
      if (own == nullptr || !own->fit.ok) continue;
      out.push_back(*own);
      const Candidate* least = own;
      for (const auto& [key, c] : fits_.tried()) {
        if (c.base == base && c.fit.ok && !HasUnseenStates(c) && !HasUnnamed(c) &&
            c.fit.chi2 < least->fit.chi2)
          least = &c;
      }
      if (least != own) laws.push_back(*least);
    }
    out.insert(out.end(), laws.begin(), laws.end());
    return out;
  }

  // Whether a force is missing on one joint, beside effects on others, and `winner` explains it.
  bool Located(const Candidate& best, bool by_name, Candidate* winner) {
    if (setting_.data.n < 2 || fits_.PerRow(best) < kExplained) return false;
    state_.TellOfRound("locate", KeyOf(best.specs));
    return by_name ? locator_.ExplainByName(best, winner) : locator_.Explain(best, winner);
  }

  // Whether the earlier search explains these recordings too. `winner` becomes it where that scores better.
  bool ExplainedByEarlier(const Candidate& best, Candidate* winner) {
    if (!earlier_) return false;
    *winner = Better(*winner, *earlier_);
    if (!(fits_.PerRow(*earlier_) < kExplained)) return false;
    state_.acceptance.Note(step_.Screen(best), setting_.nominal.joint_names());
    return Gains(*winner, best);
  }

  // Adds to the model with free or given inertials what a screen around it promises. `stepped`: the best of
  // several forward steps. Whether the others need not be looked at.
  bool AddWithInertials(bool base, const Candidate& best, Candidate* winner, Candidate* stepped) {
    // Free hidden states and unnamed forces fit nearly anything: models with free inertials are their rivals.
    const bool flexible = best.base && (HasUnnamed(*winner) || HasFreeStates(*winner));
    if (base && !flexible && fits_.PerRow(*winner) < kExplained && Gains(*winner, best)) return true;
    if (base != best.base && fits_.Known(best.specs, base) == nullptr)
      fits_.Evaluate(Refreshed(best), base, &best);
    const Candidate* own = base == best.base ? &best : fits_.Known(best.specs, base);
    if (own == nullptr || !own->fit.ok) return false;
    // Free inertials explain much: only hypotheses that explain it as well with fewer parameters count.
    const bool rival = !base && best.base &&
                       (state_.ordinary || fits_.AtStake(best) < state_.Threshold(best) ||
                        (state_.round > 1 && own->score < best.score - 0.5 * setting_.data.Rows()));
    const Candidate from = *own;
    const ScreenResult screened = step_.NotedScreen(from);
    const double best_gain = step_.BestGain(from, screened);
    const double needed = state_.Threshold(best);
    if (fits_.AtStake(from) < needed && best_gain < needed) return base == best.base;  // nothing is left
    // Around a consistent model a screen is exact; with free inertials it may promise less than what was
    // found without them.
    const bool consistent = fits_.PerRow(from) < kConsistent;
    if (base && state_.round > 1 && !flexible && Gains(*winner, best) && consistent &&
        from.score + best_gain < winner->score)
      return false;
    double least_gain = rival ? kRivalShare * (best.score - from.score) : 1.0;
    // Where a screen around a consistent model promises all that is left, hypotheses of which it promises
    // little are no rivals.
    const double named_gain = step_.MostPromised(from, screened);
    if (consistent && named_gain > kNearlyPromised * fits_.AtStake(from))
      least_gain = std::max(least_gain, kRivalShare * named_gain);
    step_.AddFrom(from, screened, least_gain, needed, base ? 3 : 4, winner);
    if (base || (best.base && state_.round > 1)) return false;
    return StepOnWithFixedInertials(best, winner, stepped);
  }

  // Further forward steps, and whether free inertials are no rival of what was found.
  bool StepOnWithFixedInertials(const Candidate& best, Candidate* winner, Candidate* stepped) {
    further_.BesideBest(best, *winner, stepped);
    if (checks_.ExplainedWithFixedInertials(best, Better(*winner, *stepped))) return true;
    // Where free inertials explain something they are a rival of several effects: URDFs are often off.
    if (!best.base && fits_.PerRow(*stepped) < kExplained && Gains(*stepped, *winner)) *winner = *stepped;
    return false;
  }

  // What was found is compared with what is easily taken for it, fitted longer, and so is the old model.
  void Refine(Candidate* best, Candidate* winner) {
    if (KeyOf(winner->specs) != KeyOf(best->specs)) {
      simplifier_.DropAbsent(winner);
      refinement_.Exchange(*best, winner);
      *winner = refinement_.WithInertialsFreeOrFixed(*winner, state_.Threshold(*best));
    }
    // Fits with hidden states or free inertials end before they converge: the old model is fitted on from the
    // winner's values, or an addition would be credited with what a longer fit alone brings.
    const bool alike = best->base == winner->base;
    if (winner->score > best->score && best->fit.ok && ((best->base && alike) || HasHiddenStates(*best)))
      *best = refinement_.Refitted(*best, alike ? *winner : *best, *winner);
  }

  // Whether it takes the place of `best`; then without what is not needed.
  bool Accept(const Candidate& winner, Candidate* best) {
    const bool same = KeyOf(winner.specs) == KeyOf(best->specs) && winner.base == best->base;
    const double needed = same ? kExchange : state_.Threshold(*best, winner);
    state_.TellOfRound("decide", KeyOf(winner.specs) + " gains " +
                                     std::to_string(winner.score - best->score) + " needs " +
                                     std::to_string(needed));
    if (!(winner.score > best->score + needed)) return false;
    const Candidate justified = refinement_.Justified(*best, winner);
    // Of several effects added at once, what remains may be worth less than none.
    if (!same && justified.score < best->score + state_.Threshold(*best, justified)) return false;
    *best = justified;
    if (state_.ordinary) drives_.Late(best);
    simplifier_.Run(best);
    return true;
  }

  // Free inertials may stand for what one law says in a number or few, as a sensor that reads off.
  void OneLawInPlaceOfInertials(Candidate* best) {
    if (!best->base || state_.FoundNothing(*best) || HasUnnamed(*best) || fits_.PerRow(*best) > kExplained ||
        fits_.Late())
      return;
    const Candidate fixed = fits_.KnownOrFitted(Refreshed(*best), false, best);
    if (!fixed.fit.ok) return;
    std::vector<TrialSpecs> laws;
    for (const Scored& h : step_.Screen(fixed).hypotheses) {
      if (laws.size() < kLawsTried && h.gain > 0 && effects::InferenceOf(h.effect).for_many_bodies &&
          !HasKind(best->specs, h.effect))
        laws.push_back(SpecsFor(h, setting_.nominal, setting_.scales).front());
    }
    Candidate one = fixed;
    if (!laws.empty()) fits_.TryBest(fixed, laws, {}, kLawsForInertials, &one);
    if (!(one.score > best->score + kExchange)) return;
    *best = one;
    simplifier_.Prune(best);
  }

  // A law of position that leaves something may stand for a force of position without a name.
  void UnnamedInPlaceOfLaw(Candidate* best) {
    if (state_.ordinary || state_.HasForceInPlace(*best)) return;
    const std::string& unnamed = effects::LawOf(effects::Regressor::kPositionPiece).id;
    for (const EffectSpec& law : Refreshed(*best)) {
      const effects::EffectInfo& info = *effects::FindEffect(law.id);
      if (info.scope != effects::Scope::kJoint || info.stage == effects::Stage::kSensor ||
          ShowsOver(law) != effects::Variable::kPosition || IsUnnamed(law.id) || state_.IsGiven(law))
        continue;
      const int joint = setting_.nominal.model().FindJoint(law.joints.front());
      if (!setting_.nominal.Takes(unnamed, joint)) continue;
      TrialSpecs others = Refreshed(*best);
      std::erase_if(others, [&](const EffectSpec& other) { return KeyOf({other}) == KeyOf({law}); });
      for (const bool base : {false, true}) {
        if (fits_.PerRow(*best) < kExplained || (best->base && !base) || fits_.Late(kWorkForComparisons))
          continue;
        ForceBeside(others, base, {"position"}, joint, best);
      }
    }
  }

  // A force without a name on `joint` (−1: on any, over positions of two where there are two), over one of
  // these variables, beside `kept` and in the place of all else that `best` has. Whether it is accepted.
  bool ForceBeside(const TrialSpecs& kept, bool base, const std::vector<std::string>& variables, int joint,
                   Candidate* best) {
    const Candidate without = fits_.KnownOrFitted(kept, base, best);
    if (!without.fit.ok) return false;
    const MissingForce& force = state_.Force(without);
    bool taken = false;
    for (const std::string& variable : variables) {
      const auto start =
          joint < 0 ? UnnamedStart(setting_, force, variable) : FieldStart(setting_, force, variable, joint);
      if (!start || fits_.Cancelled()) continue;
      const Candidate c = fits_.KnownOrFitted(Joined(kept, {*start}), base, &without, kForceIterations);
      // It follows some of anything: that free base parameters make place for it is no reason for less.
      if (!Gains(c, *best) || c.score < best->score + state_.Threshold(*best)) continue;
      *best = c, taken = true;
      if (fits_.PerRow(c) < kExplained) break;
    }
    return taken;
  }

  // One unnamed force in the place of all effects found, over two joints' positions or over one of one
  // joint's variables, where that scores better; whether it does. One force cannot stand for the losses of
  // all drives.
  bool TakeOneForce(Candidate* best) {
    const bool explained = fits_.PerRow(*best) < kExplained && (setting_.data.n > 1 || !OfPosition(*best));
    if (explained || state_.ordinary || state_.HasForceInPlace(*best)) return false;
    state_.Tell("flexible", 0.88, KeyOf(best->specs));
    const bool freed = best->base;  // else not with free inertials
    bool taken = ForceBeside(state_.given, false, kFieldVariables, -1, best);
    if (freed && !(taken && fits_.PerRow(*best) < kExplained))
      taken = ForceBeside(state_.given, true, kFieldVariables, -1, best) || taken;
    return taken;
  }

  // In the place of what held-out recordings refuse, one unnamed force with what is beside it, if they do not
  // refuse that too.
  void ReplaceRefused(Candidate* best) {
    if (state_.FoundNothing(*best) || HasUnnamed(*best) || !checks_.Refuses(*best) || fits_.Late()) return;
    Candidate force = Without();
    if (!TakeOneForce(&force)) return;
    NameBesideForce(&force);
    if (!checks_.Refuses(force)) *best = force;
  }

  // Effects beside that force, where they take nine tenths of what it leaves: less is its grid's coarseness.
  void NameBesideForce(Candidate* best) {
    Candidate named = *best;
    for (int more = 0; more < kNamesBesideForce && fits_.PerRow(named) > kExplained; ++more) {
      if (fits_.Late()) break;
      Candidate next = named;
      step_.Add(named, &next);
      if (!Gains(next, named)) break;
      named = next;
    }
    if (!(fits_.Excess(named) < kLeftBesideForce * fits_.Excess(*best))) return;
    simplifier_.Prune(&named);  // the force may have followed what they explain
    *best = named;
  }

  // What was taken for one of several alike effects while others were missing, or with other base parameters,
  // is compared again.
  void ExchangeEarlier(Candidate* best) {
    if (HasUnnamed(*best) || state_.FoundNothing(*best) || refinement_.IsSettled(*best) ||
        fits_.Late(kWorkForComparisons))
      return;
    if (refinement_.Exchange(Candidate{}, best)) simplifier_.Run(best);
  }

  SearchState state_;
  const FitSetting& setting_ = state_.setting;
  const DiagnosisOptions& options_ = state_.options;
  FitLedger& fits_ = state_.fits;
  ForwardStep step_{state_};
  DriveSearch drives_{state_, step_};
  Simplifier simplifier_{state_};
  Refinement refinement_{state_};
  FurtherSteps further_{state_, step_, drives_};
  HeldOutChecks checks_{state_};
  ForceLocator locator_{state_, step_};

  SearchResult out_;
  std::optional<Candidate> earlier_;  // the result of an earlier search, refitted to these recordings
};

}  // namespace

SearchResult SearchEffects(const FitSetting& setting, const DiagnosisOptions& options, int threads,
                           const Clock& clock, const ProgressFn& progress, const CancelToken* cancel) {
  return Search(setting, options, threads, clock, progress, cancel).Run();
}

}  // namespace rg::diagnosis
