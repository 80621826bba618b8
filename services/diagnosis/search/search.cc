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
#include "services/diagnosis/screening/screen_columns.h"
#include "services/diagnosis/search/drive_search.h"
#include "services/diagnosis/search/fit_ledger.h"
#include "services/diagnosis/search/held_out_judge.h"
#include "services/diagnosis/search/simplifier.h"
#include "services/diagnosis/search/trace.h"
#include "services/diagnosis/search/trials.h"
#include "services/diagnosis/search/unnamed_forces.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using Eigen::VectorXd;

namespace {

constexpr double kRivalShare = 0.25;  // of what parameters explain, by the screen's linear estimate
constexpr double kNearlyAll = 0.9;    // of what is left
constexpr double kMostly = 0.5;       // of what is left
constexpr double kNoisiest = 4.0;     // variance over the sensors' own: more is motion that no force follows
constexpr size_t kPromised = 3;       // by a screen, that are fitted without a trial
constexpr int kSentBack = 3;          // times that recordings kept aside may refuse an account
constexpr int kExchanged = 3;         // times that what is easily taken for each other changes places
constexpr int kDeeper = 2;            // kinds beside a first one, before parameters are freed
constexpr size_t kFew = 2;            // names: many together do what bodies do
constexpr double kDeep = 0.5;         // of all work, after which none of that, nor a substitute, is begun
constexpr size_t kByLaws = 3;         // that are fitted before hidden states are looked for
constexpr size_t kBesideUnnamed = 3;  // names that are fitted beside a force without one
constexpr size_t kBesideDrives = 3;   // that are fitted beside the losses of all drives
constexpr size_t kInPlace = 2;        // that are fitted in the place of a kind, or beside what is refused
constexpr double kPromise = 2.0;  // nats that a screen must promise of a law for a trial beside hidden states
constexpr size_t kPlainRivals = 2;  // without states of their own, that are fitted with free base parameters
constexpr int kEarlier = 12;        // iterations, of what an earlier search came to, or begins elsewhere
constexpr double kToWeigh = 1.3;    // of all work, to weigh what was tried
constexpr double kBetter = 1.0;     // nats: as many names need only be the better account

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
            [this](const Candidate& c, Candidate* best) { TakePromised(c, best); },
            [this](const Candidate& c, Candidate* best) { TakeTransmission(c, best); }),
        unnamed_(
            setting_, fits_, given_, [this](const Candidate& c) { return Force(c); }, needs_,
            [this](const Candidate& c, Candidate* best) { LookBeside(c, kBesideUnnamed, best); }) {
    if (data.held_out != nullptr)
      judge_.emplace(*data.held_out, fits_.lifted(), trace_, HasRod(nominal.effects()));
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
    features_ = MakeFeatures(data_, nominal_, scales_);
    Tell("calibrate", 0.05, "");
    given_ = SeenEffects(nominal_, [this](const auto& specs) { return fits_.Evaluate(specs, true); });
    out.nominal = fits_.Evaluate(given_, false);
    out.calibrated = fits_.Calibrated(given_);
    if (fits_.PerRow(out.calibrated) > kHolds) {
      fits_.FindPieces(given_);
      out.calibrated = Better(out.calibrated, fits_.Calibrated(given_));
    }
    acceptance_.NoteBase(data_, out.calibrated, fits_.lifted());
    Candidate best = out.calibrated.score > out.nominal.score + Threshold(out.nominal, out.calibrated)
                         ? out.calibrated
                         : out.nominal;
    if (options_.earlier == nullptr && fits_.PerRow(best) > kHolds && !fits_.Late()) {
      Tell("drives", 0.08, KeyOf(best.specs));
      if (const auto drives = drives_.Run(out.nominal, out.calibrated)) best = *drives, of_drives_ = true;
      step_rule_.clear();  // of an account that may be forgotten
      LowerNoise(&best, &out);
      if (of_drives_ && MeetsSensors(best)) simplifier_.Run(&best);
      Tell("drives", 0.09, KeyOf(best.specs));
    }
    LowerNoise(&best, &out);
    if (const Candidate* c = options_.earlier.get())
      earlier_ = fits_.Evaluate(Refreshed(*c), c->base, c, kEarlier, nullptr);
    if (earlier_ && fits_.Late()) best = Better(best, *earlier_);
    std::set<std::string> begun_at;
    for (round_ = 1; round_ <= options_.max_effects && !fits_.Late(); ++round_) {
      // A round that begins where another did ends where that did: what it added was taken out again.
      if (!begun_at.insert(KeyOf(best.specs, best.base)).second) break;
      fits_.SetRound(round_);
      const bool added = AddOne(&best);
      if (EndsForHalves(&out)) return out;
      if (!added || nameless_) break;
      if (of_drives_) drives_.Late(&best);
      // What had seemed to leave nothing may have ended on its way.
      if (LowerNoise(&best, &out) && !MeetsSensors(best) && !fits_.Late()) {
        if (Siblings(Candidate{}, &best)) simplifier_.Run(&best);
        if (!of_drives_) SubstituteAll(&best);
      }
      // What little a surface leaves is its own coarseness, and no further name.
      const double nothing = 0.98 + 0.02 * std::min(fits_.PerRow(out.nominal), fits_.PerRow(out.calibrated));
      if ((round_ == 1 || OfPosition(best)) && Flexible(&best, std::max(kExplained, nothing), kOfPlace))
        break;
    }
    if (of_drives_) {
      // On an ordinary robot more is missing as a rule: what is in the place of something else is not looked
      // for before nothing more is found.
      SubstituteAll(&best);
      simplifier_.Run(&best);
    } else {
      simplifier_.Prune(&best);
    }
    ExchangeEarlier(&best);
    if ((fits_.PerRow(best) > kExplained || OfPosition(best)) && Flexible(&best, effects::kInf, kAny))
      best = unnamed_.WithNames(best);
    if (judge_ && !EndsForHalves(&out)) SendBack(Better(out.nominal, out.calibrated), &best, &out.unseen_in);
    if (EndsForHalves(&out)) return out;
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
    if (judge_ && !fits_.Cancelled()) judge_->WeighRivals(&out, needs_);
    out.beside = Threshold(out.best, out.calibrated);
    if (out.unseen_in >= 0 && judge_->Holds(out.best, Threshold(out.best))) out.unseen_in = -1;
    const FitModel chosen{*out.best.plant, out.best.fit.values, {}};
    out.own_chi2 =
        OwnChi2(data_, chosen, out.best.fit.states, fits_.lifted(), Rng(options_.seed).Split(kOwnDraw));
    out.missing = Force(without);
    out.remaining = Force(out.best);
    return out;
  }

 private:
  // What an unnamed force may be over. Over speed two names of friction may be what it follows: it waits for
  // them.
  inline static const std::vector<std::string> kOfPlace = {"position", "drag"};
  inline static const std::vector<std::string> kAny = {"position", "drag", "velocity"};
  static constexpr double kSegment = 0.05;    // s
  static constexpr uint64_t kOwnDraw = 1000;  // its stream of random numbers, beyond the rounds'

  bool EndsForHalves(SearchResult* out) const {
    out->over_halves = fits_.over_halves(), out->work = fits_.work();
    return out->over_halves != nullptr;
  }

  // A model that fits better than any force on the old one could: the noise is less than was thought. All
  // scores are brought to it.
  bool LowerNoise(Candidate* best, SearchResult* out) {
    const double own = best->fit.chi2 / std::max(1.0, Noise(*best));
    const double scale = std::max(1.0, std::min(fits_.noise_scale(), own));
    if (0.5 * (1.0 / scale - 1.0 / fits_.noise_scale()) < 1e-3) return false;
    const double before = fits_.noise_scale();
    fits_.SetNoiseScale(scale);
    screens_.clear();
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

  // Once a round around each.
  ScreenResult Screened(const Candidate& current, bool base) {
    const Candidate* values = base ? fits_.pieces() : nullptr;
    if (fits_.PerRow(current) < kHolds) values = &current;
    const std::string key =
        KeyOf(current.specs, base) + std::to_string(current.score) + ' ' + std::to_string(current.fit.chi2);
    if (screened_round_ != round_) screens_.clear(), screened_round_ = round_;
    const auto known = screens_.find(key);
    if (known != screens_.end()) return known->second;
    const ScreenResult screened =
        ScreenAround(setting_, current, base, values, features_, fits_.lifted(),
                     Rng(options_.seed).Split(static_cast<uint64_t>(round_)), &step_rule_);
    return screens_.emplace(key, screened).first->second;
  }

  double Threshold(const Candidate& best) const {
    return acceptance_.Needed(best, Explained(best), AtStake(best));
  }
  double Threshold(const Candidate& best, const Candidate& c) const {
    return acceptance_.Needed(best, Explained(best), AtStake(best), c);
  }
  // Log evidence that the effects of a candidate bring.
  double Explained(const Candidate& c) const {
    const Candidate* without = fits_.Known(given_, c.base);
    if (FoundNothing(c) || without == nullptr) return 0.0;
    return std::min(c.score - without->score, Worth(c));
  }
  // What it would lose around itself: a model without its effects may be as far off as it likes, and says
  // nothing of what an error in their amplitudes makes.
  static double Worth(const Candidate& c) {
    if (!c.fit.ok || c.fit.information.size() == 0) return effects::kInf;
    double nats = 0;
    for (size_t i = 0; i < c.specs.size(); ++i) nats += 0.5 * std::pow(Strength(c, i), 2);
    return nats;
  }
  bool FoundNothing(const Candidate& c) const { return KeyOf(c.specs) == KeyOf(given_); }

  double Noise(const Candidate& c) const {  // χ² that it alone leaves
    return c.fit.rows - 2.0 * data_.judged() * static_cast<double>(data_.windows.size());
  }
  // The most that any addition could bring: half of χ² above what noise alone leaves.
  double AtStake(const Candidate& c) const { return 0.5 * (c.fit.chi2 / fits_.noise_scale() - Noise(c)); }

  bool AddOne(Candidate* best) {
    Tell("screen", 0.1 + 0.2 * round_, KeyOf(best->specs));
    Candidate winner = *best, deeper = *best;
    bool done = false;  // what an earlier search came to leaves nothing of these recordings
    if (round_ == 1 && earlier_) {
      winner = Better(winner, *earlier_);
      done = fits_.PerRow(*earlier_) < kExplained;
      if (done) acceptance_.Note(Screened(*best, best->base), nominal_.joint_names());
      done = done && winner.score > best->score + Threshold(*best, winner);
    }
    done = done || (round_ == 1 && ByLaws(*best, &winner));
    for (const bool base : {false, true}) {
      if (fits_.Late() || done) break;
      // Hidden states that the commands alone do not settle, and unnamed forces, fit nearly anything: an account
      // with them has those with free parameters as its rivals.
      const bool flexible = best->base && (HasUnnamed(winner) || HasFreeStates(winner));
      if (base && !flexible && fits_.PerRow(winner) < kExplained &&
          winner.score > best->score + Threshold(*best, winner))
        break;
      if (base != best->base && fits_.Known(best->specs, base) == nullptr)
        fits_.Evaluate(Refreshed(*best), base, best);
      const Candidate* own = base == best->base ? best : fits_.Known(best->specs, base);
      if (own == nullptr || !own->fit.ok) continue;
      // Parameters explain much: only what explains it as well with less is of interest.
      const bool rival = !base && best->base &&
                         (of_drives_ || AtStake(*best) < Threshold(*best) ||
                          (round_ > 1 && own->score < best->score - 0.5 * data_.Rows()));
      const Candidate from = *own;
      if (round_ == 1) looked_beside_.insert(KeyOf(from.specs, base));
      const ScreenResult screened = Screened(from, base);
      acceptance_.Note(screened, nominal_.joint_names());
      trace_.Screen(screened, base);
      const double best_gain = screened.hypotheses.empty() ? 0.0 : screened.hypotheses.front().gain;
      if (AtStake(from) < Threshold(*best) && best_gain < Threshold(*best)) {
        if (base == best->base) break;  // nothing is left; freed parameters would leave less
        continue;
      }
      // Around a model that holds a screen is right: what it promises with free parameters may come nowhere
      // near what was found without them.
      const bool found = winner.score > best->score + Threshold(*best, winner);
      if (base && round_ > 1 && !flexible && found && fits_.PerRow(from) < kHolds &&
          from.score + best_gain < winner.score)
        continue;
      double wanted = rival ? kRivalShare * (best->score - from.score) : 1.0;
      // Where a screen around a model that holds promises all that is left, hypotheses of which it promises
      // little, or nothing, are no rivals.
      const double named_gain = MostPromised(screened);
      if (fits_.PerRow(from) < kHolds && named_gain > kNearlyAll * AtStake(from))
        wanted = std::max(wanted, kRivalShare * named_gain);
      TryAround(from, screened, wanted, Threshold(*best), base ? 3 : 4, &winner);
      if (fits_.over_halves() != nullptr) return false;
      if (base || (best->base && round_ > 1)) continue;
      for (const Candidate& start : Beginnings(*best, winner)) {
        deeper = Better(deeper, Deeper(start));
        if (fits_.PerRow(deeper) < kExplained) break;
      }
      if (round_ == 1 && Nameless(*best, Better(winner, deeper), &winner)) {
        nameless_ = true, *best = winner;
        return true;
      }
      if (Settled(*best, Better(winner, deeper))) break;
      // Where parameters alone explain something, several names have theirs as rivals: a URDF is off oftener.
      if (!best->base && fits_.PerRow(deeper) < kExplained &&
          deeper.score > winner.score + Threshold(winner, deeper))
        winner = deeper;
    }
    if (deeper.score > winner.score + Threshold(winner, deeper)) winner = deeper;
    // Where a force without a name would be the account, two names may be that only together hold beside free
    // base parameters: they need only be the better one.
    if (HasUnnamed(winner) && !nameless_) {
      if (const Candidate* c = BestFreed(fits_.tried(), *best)) winner = Better(winner, Deeper(*c));
    }
    if (KeyOf(winner.specs) == KeyOf(best->specs) && FoundNothing(*best)) {
      if (const Candidate* c = AsGoodAsFreed(fits_.tried(), *best, needs_)) winner = *c;
    }
    if (KeyOf(winner.specs) != KeyOf(best->specs)) {
      Restart(&winner);
      simplifier_.DropNothing(&winner);
      Exchange(*best, &winner);
      winner = PlainlyFreed(*best, InEitherWorld(winner, Threshold(*best)));
    }
    if (const Candidate* c = FewerNames(fits_.tried(), *best, winner, needs_)) winner = Longer(*c, *c, *c);
    // Fits with hidden states or free base parameters end before they are done: the old model has another try
    // with the winner's values, or an addition would be credited with what a longer fit alone brings.
    const bool alike = best->base == winner.base;
    if (winner.score > best->score && best->fit.ok && ((best->base && alike) || HasHiddenStates(*best)))
      *best = Longer(*best, alike ? winner : *best, winner);
    if (AddsNothing(*best, winner)) winner = *best;
    // The same effects, better fitted, need no more than to be better.
    const bool same = KeyOf(winner.specs) == KeyOf(best->specs) && winner.base == best->base;
    const double needed = same ? 1.0 : Threshold(*best, winner);
    Tell("decide", 0.1 + 0.2 * round_,
         KeyOf(winner.specs) + " gains " + std::to_string(winner.score - best->score) + " needs " +
             std::to_string(needed));
    const bool accept = winner.score > best->score + needed;
    if (accept) {
      const Candidate justified = Justified(*best, winner);
      // What is left of several at once may be worth less than none of them.
      if (!same && justified.score < best->score + Threshold(*best, justified)) return false;
      *best = justified;
      simplifier_.Run(best);
      if (!of_drives_) SubstituteAll(best);
    }
    return accept;
  }

  // Laws of what is recorded come first, on the parameters as given or with free ones: where they leave
  // nothing, hidden states, which cost far more and fit nearly anything, are not looked for. Whether base
  // parameters are free beside the losses of all drives was decided when these were found.
  bool ByLaws(const Candidate& before, Candidate* winner) {
    Candidate found = *winner;
    for (const bool base : {false, true}) {
      if (of_drives_ && base != before.base) continue;
      const Candidate* own = base == before.base ? &before : fits_.Known(before.specs, base);
      if (own == nullptr || !own->fit.ok || AtStake(*own) < Threshold(before) || fits_.Late()) continue;
      const Candidate from = *own;
      const ScreenResult screened = Screened(from, base);
      acceptance_.Note(screened, nominal_.joint_names());
      trace_.Screen(screened, base);
      if (!(MostPromised(screened) > kMostly * AtStake(from))) continue;
      TryPool(from, screened, kPromise, Threshold(before), kByLaws, &found);
      if (!LeavesNothing(before, found, Threshold(before, found))) continue;
      *winner = found;
      return true;
    }
    return false;
  }

  // Accounts by name on the parameters as given that something may be missing beside: the best, and the best
  // with states that no sensor reads.
  std::vector<Candidate> Beginnings(const Candidate& before, const Candidate& winner) {
    std::vector<Candidate> out;
    if (fits_.Late(kDeep) || fits_.PerRow(winner) < kExplained) return out;
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

  // An account with what is found beside it on the parameters as given, until nothing is missing: that costs
  // little of what free parameters do.
  Candidate Deeper(Candidate account) {
    for (int more = 0; more < kDeeper && fits_.PerRow(account) > kExplained && !fits_.Late(kDeep); ++more) {
      Candidate with = account;
      LookBeside(account, 3, &with);
      Tell("deeper", 0.1 + 0.2 * round_,
           KeyOf(with.specs) + " gains " + std::to_string(with.score - account.score));
      if (HasUnnamed(with) || with.score <= account.score + Threshold(account, with)) break;
      account = with;
    }
    return account;
  }

  void SubstituteAll(Candidate* best) {
    while (Substitute(best)) simplifier_.Run(best);
  }

  // A law bends into part of what another, that is missing, leaves, and is then in its way: each kind of
  // effect in turn makes place for what a screen around the others finds.
  bool Substitute(Candidate* best) {
    const std::set<std::string> kinds = FreshKinds(Candidate{}, *best);
    if (kinds.size() < 2 || HasUnnamed(*best) || MeetsSensors(*best)) return false;
    for (const std::string& kind : kinds) {
      if (fits_.Late(kDeep)) return false;
      if (of_drives_ && OfAllJoints(*best, kind)) continue;
      Candidate winner = *best;
      LookWithout(*best, kind, &winner);
      if (KeyOf(winner.specs) == KeyOf(best->specs)) continue;
      const bool more = HasKind(given_, kind) || FreshKinds(Candidate{}, winner).size() > kinds.size();
      Tell("substitute", 0.1 + 0.2 * round_,
           KeyOf(winner.specs) + " for " + kind + " gains " + std::to_string(winner.score - best->score));
      if (winner.score <= best->score + (more ? Threshold(*best, winner) : kBetter)) continue;
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

  // Once beside each account without one of its kinds.
  void LookWithout(const Candidate& account, const std::string& kind, Candidate* winner) {
    const std::vector<EffectSpec> specs = WithoutKind(Refreshed(account), kind);
    if (!looked_beside_.insert(KeyOf(specs, account.base)).second) return;
    const Candidate* known = fits_.Known(specs, account.base);
    const Candidate from = known != nullptr ? *known : fits_.Evaluate(specs, account.base, &account);
    if (from.fit.ok) LookBeside(from, kInPlace, winner);
  }

  // A screen around `from`, which need not be the account at hand, and all that it gives tried: beside hidden
  // states, which make every fit dear, what the screen itself promises.
  void LookBeside(const Candidate& from, size_t count, Candidate* winner) {
    const ScreenResult screened = Screened(from, from.base);
    acceptance_.NoteStepRules(screened, nominal_.joint_names());
    trace_.Screen(screened, from.base);
    const double needed = Threshold(from);
    const double wanted = HasHiddenStates(from) ? std::max(kPromise, needed) : 1.0;
    TryAround(from, screened, wanted, needed, count, winner);
  }

  // What a screen around `from` promises, which need not hold, and nothing that it cannot see. A force without
  // a name follows some of anything while more is missing: it is for what no name takes half of.
  void TakePromised(const Candidate& from, Candidate* winner) {
    const ScreenResult screened = Screened(from, from.base);
    trace_.Screen(screened, from.base);
    ScreenResult named = screened;
    std::erase_if(named.hypotheses, [](const Scored& h) { return IsUnnamed(h.effect); });
    for (const ScreenResult& promised : {named, screened}) {
      TryAround(from, promised, kPromise, Threshold(from), kBesideDrives, winner);
      if (fits_.Excess(*winner) < kMostly * fits_.Excess(from)) return;
    }
  }

  // A spring or play where the screen around `from` finds most, which it cannot promise.
  void TakeTransmission(const Candidate& from, Candidate* winner) {
    const auto nearest = [&](const auto& starts, size_t most) {
      return fits_.Nearest(from, from.base, starts, most);
    };
    const auto pool = TransmissionTrials(data_, nominal_, scales_, from, Screened(from, from.base), nearest);
    fits_.TryBest(from, pool, {}, from.base, kBesideDrives, winner);
  }

  // Trials of what may be added to `from`; the best of them and of `winner`.
  void TryAround(const Candidate& from, const ScreenResult& screened, double wanted, double needed,
                 size_t count, Candidate* winner) {
    // What the screen promises most from comes first: where a law of what is recorded leaves nothing, what no
    // screen sees is not looked for.
    if (wanted <= 1.0 && MostPromised(screened) > kMostly * AtStake(from)) {
      const double before = winner->score;
      TryPool(from, screened, kPromise, needed, count, winner);
      const bool better = winner->score > before;
      if (better && (LeavesNothing(from, *winner, needed) || TakesMost(from, *winner))) return;
    }
    TryPool(from, screened, wanted, needed, count, winner);
  }

  // The same of what the screen gives `least` nats at least; where that is 1 or less, also what it cannot see.
  void TryPool(const Candidate& from, const ScreenResult& screened, double least, double needed, size_t count,
               Candidate* winner) {
    const auto nearest = [&](const auto& starts, size_t most) {
      return fits_.Nearest(from, from.base, starts, most);
    };
    const auto force = [&] { return Force(from); };
    const bool holds = from.fit.ok && fits_.PerRow(from) < kHolds;
    const auto promised = Promised(from, screened, nominal_, scales_, holds, needed, kPromised);
    const auto pool = Trials(data_, nominal_, scales_, from, screened, least, force, nearest);
    fits_.TryBest(from, pool, promised, from.base, count, winner);
  }

  // Whether what was found beside `from` leaves nothing, by laws of what is recorded.
  bool LeavesNothing(const Candidate& from, const Candidate& found, double needed) const {
    return found.score > from.score + needed && MeetsSensors(found) && !HasUnnamed(found) &&
           !HasFreeStates(found);
  }
  // Whether it takes most of what the losses of all drives leave. What else is missing is then looked for
  // beside it, and not among what no screen sees.
  bool TakesMost(const Candidate& from, const Candidate& found) const {
    return of_drives_ && found.fit.ok && fits_.Excess(found) < kMostly * fits_.Excess(from);
  }
  static double MostPromised(const ScreenResult& screened) {
    double most = 0;
    for (const Scored& h : screened.hypotheses) {
      if (!IsUnnamed(h.effect)) most = std::max(most, h.gain);
    }
    for (const auto* list : {&screened.sets, &screened.pairs}) {
      for (const Combination& c : *list) most = std::max(most, c.gain);
    }
    return most;
  }

  // Free base parameters make a gain of one of two drives the same as its inverse on the other, which may need none.
  Candidate OtherDrivesGain(const Candidate& c) {
    std::vector<EffectSpec> specs = Refreshed(c);
    const auto gain = std::find_if(specs.begin(), specs.end(),
                                   [](const EffectSpec& s) { return effects::ScalesEffort(s.id); });
    Candidate none;
    none.score = kNoScore;
    if (gain == specs.end() || gain->joints.size() != 1 || fits_.Late()) return none;
    const int other = data_.OtherOfTwo(nominal_.model().FindJoint(gain->joints[0]));
    if (other < 0) return none;
    const std::string& joint = nominal_.joint_names()[static_cast<size_t>(other)];
    if (Contains(specs, gain->id, joint)) return none;
    std::map<std::string, double> values = gain->values.at(gain->joints[0]);
    for (auto& [name, value] : values) value = 1 / value;
    *gain = effects::MakeSpec(gain->id, {joint}, values);
    const Candidate plain = fits_.Evaluate(specs, false, nullptr, kEarlier, &c);
    return plain.fit.ok ? plain : none;
  }

  // With free base parameters or without, whichever is worth it; they must bring `least`.
  Candidate InEitherWorld(const Candidate& c, double least) {
    if (!c.base && AtStake(c) < least) return c;  // there is not so much left
    const Candidate twin = fits_.Evaluate(Refreshed(c), !c.base, &c, 6, &c);
    const Candidate plain = c.base ? Better(twin, OtherDrivesGain(c)) : c, freed = c.base ? c : twin;
    return freed.score > plain.score + std::max(least, Threshold(plain, freed)) ? freed : plain;
  }

  // States that no sensor reads follow some of what bodies do that are not as the URDF says: where an account
  // with them does not hold, the best without them on the parameters as given, of as many names, have free
  // ones too.
  Candidate PlainlyFreed(const Candidate& before, const Candidate winner) {
    if (!HasFreeStates(winner) || fits_.PerRow(winner) < kHolds) return winner;
    Candidate best = winner;
    for (const Candidate& c : PlainRivals(fits_.tried(), before, winner, kPlainRivals)) {
      if (fits_.PerRow(best) < kExplained || fits_.Late(kToWeigh)) break;
      const Candidate freed = fits_.Evaluate(Refreshed(c), true, &c, 6, &best);
      if (freed.score > std::max(best.score, c.score + Threshold(c, freed))) best = freed;
    }
    return best;
  }

  // Fitted on, from where `from` is and with the values of `rival`: in either world where that brings more.
  Candidate Longer(const Candidate c, const Candidate from, const Candidate rival) {
    const Candidate longer = fits_.Evaluate(RefreshedFrom(c, rival), c.base, &from, 12, &rival);
    if (longer.score < c.score + 1) return Better(c, longer);
    return c.base && HasHiddenStates(c) ? InEitherWorld(longer, 0) : longer;
  }

  // Of several effects added at once each must be worth its name; at the end, beside what was tried already.
  // Free base parameters may be what the data have in the place of one of them.
  Candidate Justified(const Candidate& before, Candidate winner) {
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
        if (twin.score > winner.score + Threshold(winner, twin)) freed = Better(freed, twin);
      }
      if (freed.base && !winner.base && freed.score > fewer.score) {
        winner = freed;
      } else if (winner.score > fewer.score + Threshold(fewer, winner)) {
        return winner;
      } else {
        winner = fewer;
      }
    }
    return winner;
  }

  // The ceiling: one unnamed force in the place of all effects found, over two joints' positions, or over
  // what one joint has of the `variables`. It is taken where it leaves less than `worst` χ² per row and is
  // the better account.
  bool Flexible(Candidate* best, double worst, const std::vector<std::string>& variables) {
    // Nor is one force what all drives lose.
    if (fits_.Cancelled() || of_drives_ || (fits_.PerRow(*best) < kExplained && data_.n > 1)) return false;
    Tell("flexible", 0.3 + 0.15 * round_, KeyOf(best->specs));
    bool taken = false;
    // Free base parameters only where they are part of the account.
    unnamed_.Try(best->base, variables, [&](const Candidate& c) {
      if (c.score > best->score + Threshold(*best) && fits_.PerRow(c) < worst) *best = c, taken = true;
      return taken && fits_.PerRow(*best) < kExplained;
    });
    return taken;
  }

  // Bodies on a robot of more than two joints do not act like a few laws, nor like a force over two
  // positions: what holds on recordings kept aside there is no accident. On smaller ones they may.
  bool MaySettle() const { return data_.n > 2 && judge_; }
  bool HoldsAside(const Candidate& account, double needed) {
    const bool holds = judge_->Holds(account, needed);
    fits_.AddWork(judge_->TakeWork());
    return holds;
  }

  // Whether an account by few names on the parameters as given leaves nothing of the recordings, nor of those
  // kept aside: then free parameters, which alone explain little, are no rival.
  bool Settled(const Candidate& before, const Candidate& named) {
    return MaySettle() && MeetsSensors(named) && !HasUnnamed(named) && fits_.PerRow(before) >= kHolds &&
           FreshKinds(before, named).size() <= kFew &&
           named.score > before.score + Threshold(before, named) && HoldsAside(named, Threshold(before));
  }

  // Whether one unnamed force on the parameters as given, better than what has names there, leaves nothing of
  // the recordings, nor of those kept aside: then nothing is looked for with other parameters.
  bool Nameless(const Candidate& before, const Candidate& named, Candidate* out) {
    if (!MaySettle() || fits_.PerRow(named) < kExplained || fits_.Late()) return false;
    const double least = std::max(named.score, before.score) + Threshold(before);
    bool found = false;
    unnamed_.Try(false, kOfPlace, [&](const Candidate& c) {
      found = MeetsSensors(c) && c.score > least && HoldsAside(c, Threshold(before));
      if (found) *out = c;
      return found;
    });
    return found;
  }

  // An account must hold on recordings kept aside, or what was tried, with what is found beside it, and
  // predicts them better takes its place. One that explains less than half of what is missing there is none,
  // however well it follows what it was fitted to.
  void SendBack(const Candidate& without, Candidate* best, int* unseen_in) {
    HeldOutJudge& judge = *judge_;
    // Where a mass hangs that swings freely is not known for long: what little is left there is no other law.
    const auto swings_on = [&] {
      return HasKind(best->specs, effects::SwingingMass().id) && judge.ExplainsMost(*best, without);
    };
    if (fits_.PerRow(*best) < kExplained && !swings_on())
      *unseen_in = judge.Refusing(*best, Threshold(*best));
    const bool named = !best->specs.empty() && !FoundNothing(*best);
    for (int sent = 0;
         named && sent < kSentBack && !fits_.Late(kToWeigh) && !judge.Holds(*best, Threshold(*best));
         ++sent) {
      if (!of_drives_) TryUnnamed(best->base, sent == 0);
      Candidate with = *best;  // what it lacks may be another name
      if (sent == 0 && !HasUnnamed(*best) && !fits_.Late()) LookBesideRefused(*best, &with);
      const auto rival =
          judge.Better(*best, fits_.tried(), [&](const Candidate& c) { return Threshold(*best, c); });
      if (!rival) break;
      Tell("sent back", 0.9, KeyOf(best->specs) + "for " + KeyOf(rival->specs));
      *best = HasUnnamed(*rival) ? unnamed_.WithoutCoarse(*rival) : *rival;
      Candidate like = *best;
      if (!HasUnnamed(like) && !fits_.Late()) Exchange(without, &like);
      if (judge.InAll(like) > judge.InAll(*best)) *best = like;
      if (HasFreeStates(*best) && !fits_.Late()) *best = Longer(*best, *best, *best);
      // What the account before had for the sake of something else may be about nothing beside it.
      if (!fits_.Late(kToWeigh)) {
        simplifier_.Run(best);
        *best = InEitherWorld(*best, Threshold(*best));
      }
    }
    if (judge.Holds(*best, Threshold(*best))) {
      *unseen_in = -1;
    } else if (named && !judge.ExplainsMost(*best, without)) {
      Tell("sent back", 0.9, KeyOf(best->specs) + "for nothing");
      *best = without;
    }
    fits_.AddWork(judge.TakeWork());
  }

  // Forces without a name as rivals, the first time with names beside them.
  void TryUnnamed(bool base, bool with_names) {
    if (!fits_.Late()) unnamed_.Try(base, kAny, [](const Candidate&) { return false; });
    const Candidate* nameless = unnamed_.Best();
    if (with_names && nameless != nullptr && !fits_.Late()) unnamed_.WithNames(Candidate(*nameless));
  }

  // It may lack a name, or have one that the fitted recordings alone bear out in the place of another.
  void LookBesideRefused(const Candidate refused, Candidate* with) {
    LookBeside(refused, kInPlace, with);
    // Beside lags only what a screen promises was tried: a spring is nothing that it can.
    const bool late_drives = HasHiddenStates(refused) && !HasFreeStates(refused);
    if (late_drives && !MeetsSensors(*with) && !fits_.Late()) TakeTransmission(refused, with);
    const auto left = [&](const Candidate& c) { return fits_.PerRow(c) * fits_.noise_scale() - 1; };
    for (const std::string& kind : FreshKinds(Candidate{}, refused)) {
      // What takes most of what is left is looked beside next.
      if (left(*with) < kMostly * left(refused)) return;
      if (!fits_.Late()) LookWithout(refused, kind, with);
    }
  }

  // A winner that does not hold may lack another effect, or its fit got stuck on its way from base parameters
  // that had taken its effects' place: it has another try from nominal ones, over pieces.
  void Restart(Candidate* winner) {
    if (fits_.PerRow(*winner) > kHolds && !fits_.Late()) *winner = Better(*winner, fits_.Anew(*winner));
  }

  // Whether it leaves no more than the sensors' own noise; what is taken for noise may be what it leaves.
  bool MeetsSensors(const Candidate& c) const { return fits_.PerRow(c) * fits_.noise_scale() < kExplained; }

  // What is easily taken for each other changes places until nothing is better: what one was taken for may
  // have been for another's sake.
  void Exchange(const Candidate& before, Candidate* winner) {
    for (int left = kExchanged; left > 0 && Siblings(before, winner);) --left;
  }

  // What was taken for one of several alike while other things were missing is weighed again beside them.
  void ExchangeEarlier(Candidate* best) {
    if (HasUnnamed(*best) || FoundNothing(*best) || FreshKinds(Candidate{}, *best).size() < 2 || fits_.Late(kToWeigh)) return;
    if (Siblings(Candidate{}, best)) simplifier_.Run(best);
  }

  // Whether a better account was found: the winner with each new kind of effect, or its newest, exchanged for
  // what it is easily taken for.
  bool Siblings(const Candidate& before, Candidate* winner) {
    const std::vector<EffectSpec> specs = Refreshed(*winner);
    if (specs.empty()) return false;
    std::set<std::string> kinds = FreshKinds(before, *winner);
    if (kinds.empty()) kinds = {specs.back().id};
    std::vector<TrialSpecs> others;
    for (const std::string& kind : kinds) {
      for (const TrialSpecs& other : Exchanges(specs, kind, nominal_, scales_)) {
        if (fits_.Known(other, winner->base) == nullptr) others.push_back(other);
      }
    }
    for (const EffectSpec& s : specs) {
      if (kinds.count(s.id) == 0) continue;
      const auto starts = OtherTransmission(s, nominal_, scales_);
      for (const TrialSpecs& start : fits_.Nearest(*winner, winner->base, starts, 1))
        others.push_back(Joined(specs, start));
      if (MeetsSensors(*winner)) continue;
      for (const TrialSpecs& start : fits_.Nearest(*winner, winner->base, OtherGaps(s), 2))
        others.push_back(Joined(specs, start));
    }
    const double before_others = winner->score;
    fits_.TryInPlace(others, winner);
    return winner->score > before_others + kBetter;
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
  std::optional<HeldOutJudge> judge_;  // where recordings are kept aside
  int round_ = 0;
  std::optional<Candidate> earlier_;  // what an earlier search came to, on these recordings and windows
  bool of_drives_ = false;            // the losses of all drives were found together
  bool nameless_ = false;             // an unnamed force alone is the account of all recordings
  Acceptance acceptance_;
  std::vector<VectorXd> step_rule_;
  FeatureSet features_;
  std::map<std::string, ScreenResult> screens_;  // of one round
  int screened_round_ = 0;
  std::set<std::string> looked_beside_;  // what was screened in round one, or in the place of a kind
  std::vector<EffectSpec> given_;        // that the model has which the search starts from
};

}  // namespace

SearchResult SearchEffects(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                           const DiagnosisOptions& options, int threads, const Clock& clock,
                           const ProgressFn& progress, const CancelToken* cancel) {
  return Search(data, nominal, scales, options, threads, clock, progress, cancel).Run();
}

}  // namespace rg::diagnosis
