#include "services/diagnosis/search.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "common/model/robot_model.h"
#include "services/diagnosis/acceptance.h"
#include "services/diagnosis/field_starts.h"
#include "services/diagnosis/fit_requests.h"
#include "services/diagnosis/given_model.h"
#include "services/diagnosis/held_out_judge.h"
#include "services/diagnosis/nearest_starts.h"
#include "services/diagnosis/own_chi2.h"
#include "services/diagnosis/screen_columns.h"
#include "services/diagnosis/trace.h"
#include "services/diagnosis/trials.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using Eigen::VectorXd;

namespace {

constexpr double kRivalShare = 0.25;  // of what parameters explain, by the screen's linear estimate
constexpr int kMoreIterations = 14;   // of a fit that still falls
constexpr double kHopeless = 2.0;     // times its rival's misfit, which a fit would not come to
constexpr double kFallsFast = 0.1;    // of the cost in one iteration, for a trial to go on
constexpr double kTrialShare = 0.3;   // of all work, that the trials of one screen may cost
constexpr double kToTheEnd = 1.3;     // of all work, to weigh what is found
constexpr double kPruned = 2.0;       // and to take out what is not needed
constexpr size_t kSprings = 4;        // behind rotors, that are fitted
constexpr double kPiece = 0.1;        // s
constexpr double kNoisiest = 4.0;     // variance over the sensors' own: more is motion that no force follows
constexpr double kHolds = 2.0;        // χ² per row below which a model's own states are trusted
constexpr int kSentBack = 3;          // times that recordings kept aside may refuse an account

class Search {
 public:
  Search(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
         const DiagnosisOptions& options, int threads, const Clock& clock, const ProgressFn& progress,
         const CancelToken* cancel)
      : data_(data),
        nominal_(nominal),
        scales_(scales),
        setting_{data, nominal, scales},
        fits_(options.fits == nullptr ? local_ : *options.fits),
        options_(options),
        progress_(progress),
        cancel_(cancel),
        trace_(clock) {
    lifted_.threads = threads;
    lifted_.step_s = options.step_s;
  }

  SearchResult Run() {
    SearchResult out;
    Tell("noise", 0.02, "");
    const FitModel bare{nominal_, nominal_.parameters().Nominal(), {}};
    const double stair = std::max(0.02, data_.recordings[0].recording->SamplePeriod());
    MissingForce missing = EstimateMissingForce(data_, bare, InitialStates(data_, bare, lifted_),
                                                scales_.torque, stair, lifted_);
    lifted_.noise_scale =
        std::clamp(missing.chi2 / std::max(1.0, missing.rows - missing.unknowns), 1.0, kNoisiest);
    Tell("calibrate", 0.05, "");
    StartFromGiven();
    out.nominal = Evaluate(given_, false);
    out.calibrated = Calibrated();
    if (PerRow(out.calibrated) > kHolds) out.calibrated = Better(out.calibrated, FitPieces());
    acceptance_.NoteBase(data_, out.calibrated, lifted_);
    Candidate best = out.calibrated.score > out.nominal.score + Threshold(out.nominal, out.calibrated)
                         ? out.calibrated
                         : out.nominal;
    LowerNoise(&best, &out);
    features_ = MakeFeatures(data_, scales_);
    for (round_ = 1; round_ <= options_.max_effects && !Late(); ++round_) {
      const bool added = AddOne(&best);
      if (!added) break;
      LowerNoise(&best, &out);
      // What little a surface leaves is its own coarseness, and no further name.
      const double nothing = 0.98 + 0.02 * std::min(PerRow(out.nominal), PerRow(out.calibrated));
      if ((round_ == 1 || OfPosition(best)) && Flexible(&best, std::max(kExplained, nothing))) break;
    }
    Prune(&best);
    if (PerRow(best) > kExplained || OfPosition(best)) Flexible(&best, 1e300);
    if (data_.held_out != nullptr) SendBack(Better(out.nominal, out.calibrated), &best, &out);
    out.best = best;
    for (const auto& [key, c] : tried_) out.tried.push_back(c);
    std::sort(out.tried.begin(), out.tried.end(),
              [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
    out.null_gain = acceptance_.null_gain();
    out.noise_scale = lifted_.noise_scale, out.work = work_;
    Tell("locate", 0.95, "");
    const Candidate without = Better(out.nominal, out.calibrated);
    out.threshold = Threshold(out.nominal, out.calibrated);
    out.beside = Threshold(best, out.calibrated);
    if (data_.held_out != nullptr && !Cancelled()) WeighRivals(*data_.held_out, lifted_, &out);
    out.own_chi2 = OwnChi2(data_, FitModel{*best.plant, best.fit.values, {}}, best.fit.states, lifted_,
                           Rng(options_.seed).Split(kOwnDraw));
    out.missing = Force(without);
    out.remaining = Force(best);
    return out;
  }

 private:
  static constexpr double kSegment = 0.05;    // s
  static constexpr uint64_t kOwnDraw = 1000;  // its stream of random numbers, beyond the rounds'

  // The effects of the given model, without those of which these recordings show nothing.
  void StartFromGiven() {
    given_ = GivenEffects(nominal_);
    for (bool changed = !given_.empty(); changed;) {
      const Candidate c = Evaluate(given_, true);
      std::vector<EffectSpec> seen;
      if (c.fit.theta.size() == 0) given_.clear();  // it cannot be fitted: from the beginning
      for (size_t i = 0; i < given_.size(); ++i) {
        if (c.fit.ok || !Unseen(c, i)) seen.push_back(given_[i]);
      }
      changed = seen.size() < given_.size();
      given_ = std::move(seen);
    }
  }

  // A model that fits better than any force on the old one could: the noise is less than was thought. All
  // scores are brought to it.
  void LowerNoise(Candidate* best, SearchResult* out) {
    const double own = best->fit.chi2 / std::max(1.0, Noise(*best));
    const double scale = std::max(1.0, std::min(lifted_.noise_scale, own));
    const double change = 0.5 * (1.0 / scale - 1.0 / lifted_.noise_scale);
    if (change < 1e-3) return;
    lifted_.noise_scale = scale;
    for (Candidate* c : {best, &out->nominal, &out->calibrated}) c->score -= change * c->fit.chi2;
    for (auto& [key, c] : tried_) c.score -= change * c.fit.chi2;
  }

  void Tell(const std::string& stage, double done, const std::string& note) const {
    if (progress_) progress_({stage, done, 1.0, note});
    trace_.Stage(stage, note + " after work " + std::to_string(work_ / options_.work_limit));
  }
  bool Cancelled() const { return cancel_ != nullptr && cancel_->cancelled(); }
  bool Late(double limits = 1.0) const {  // `limits`: times the work limit
    return Cancelled() || work_ > limits * options_.work_limit ||
           (options_.time_limit_s > 0 && trace_.Elapsed() > options_.time_limit_s);
  }
  static const Candidate& Better(const Candidate& a, const Candidate& b) { return b.score > a.score ? b : a; }
  MissingForce Force(const Candidate& c) {
    const FitModel model{*c.plant, c.fit.values, {}};
    return EstimateMissingForce(data_, model, InitialStates(data_, model, lifted_), scales_.torque, kSegment,
                                lifted_);
  }

  // `from`: where to start, where it holds; else at the recorded motion. `rival`: what it must come near to.
  Candidate Evaluate(const std::vector<EffectSpec>& specs, bool base, const Candidate* from = nullptr,
                     int iterations = 6, const Candidate* rival = nullptr) {
    const FitRequest request = WholeFit(specs, base, Start(from, base), iterations, rival);
    return Tried(request, fits_.Start(setting_, {request})->Take(0));
  }

  // Starts at the states, and at the base parameters, of a model that holds: what is added to it or taken
  // from it changes them little, and no fit is better than another for its start alone.
  std::shared_ptr<const Candidate> Start(const Candidate* from, bool base) const {
    if (from == nullptr || !from->fit.ok || PerRow(*from) > kHolds) return base ? pieces_ : nullptr;
    return std::make_shared<const Candidate>(*from);
  }

  // Base parameters far from the URDF's, or beside missing effects, are found over short pieces of the
  // record, from where fits in their world then start.
  Candidate FitPieces() {
    FitRequest request{given_, true, lifted_, {}, kPiece, true, nullptr};
    request.options.more_iterations = kMoreIterations;
    auto pieces = std::make_shared<Candidate>(Fitted(request, fits_.Start(setting_, {request})->Take(0)));
    trace_.Fit(*pieces, "pieces");
    if (pieces->fit.ok) pieces_ = pieces;
    return Calibrated();
  }

  // No longer than it may come to hold.
  Candidate Calibrated() {
    FitRequest request = WholeFit(given_, true, pieces_);
    request.options.to_beat = kHolds * data_.Rows();
    return Tried(request, fits_.Start(setting_, {request})->Take(0));
  }

  bool FromPieces(const FitRequest& request) const {
    return request.from != nullptr && request.from == pieces_;
  }

  FitRequest WholeFit(const std::vector<EffectSpec>& specs, bool base, std::shared_ptr<const Candidate> from,
                      int iterations = 6, const Candidate* rival = nullptr) const {
    FitRequest request{specs, base, lifted_, {}, 0, false, std::move(from)};
    if (FromPieces(request)) request.piece_s = kPiece;
    request.options.iterations = iterations;
    request.options.more_iterations = kMoreIterations;
    if (rival != nullptr && rival->fit.ok) request.options.to_beat = -2 * kHopeless * rival->score;
    return request;
  }

  Candidate Fitted(const FitRequest& request, FitResult fit) {
    Candidate c = Unfitted(setting_, request.specs, request.base);
    work_ += fit.work;
    c.fit = std::move(fit);
    c.round = round_;
    c.fit.ok = c.fit.ok && !Unseen(c);
    // While much is left a ripple's period is bent by it.
    if (c.fit.ok && PerRow(c) < kHolds) c.fit.ok = Repeats(c, scales_, PerRow(c));
    c.score = c.fit.ok ? c.fit.evidence - StructurePrior(c.specs, c.base) : -1e300;
    return c;
  }

  // A fit on all windows, kept.
  Candidate Tried(const FitRequest& request, FitResult fit) {
    const Candidate c = Fitted(request, std::move(fit));
    if (c.plant == nullptr) return c;
    auto [it, fresh] = tried_.try_emplace(KeyOf(c.specs) + (c.base ? "+base" : ""), c);
    if (!fresh && c.score > it->second.score) it->second = c;
    trace_.Fit(c, "fit");
    return c;
  }

  ScreenResult Screened(const Candidate& current, bool base) {
    const Candidate* values = base ? pieces_.get() : nullptr;
    if (PerRow(current) < kHolds) values = &current;
    return ScreenAround(setting_, current, base, values, features_, lifted_,
                        Rng(options_.seed).Split(static_cast<uint64_t>(round_)), &step_rule_);
  }

  double Threshold(const Candidate& best) const {
    return acceptance_.Needed(best, Explained(best), AtStake(best));
  }
  double Threshold(const Candidate& best, const Candidate& c) const {
    return acceptance_.Needed(best, Explained(best), AtStake(best), c);
  }
  // Log evidence that the effects of a candidate bring.
  double Explained(const Candidate& c) const {
    const Candidate* without = Known(given_, c.base);
    return FoundNothing(c) || without == nullptr ? 0.0 : c.score - without->score;
  }
  bool FoundNothing(const Candidate& c) const { return KeyOf(c.specs) == KeyOf(given_); }

  double Noise(const Candidate& c) const {  // χ² that it alone leaves
    return c.fit.rows - 2.0 * data_.n * static_cast<double>(data_.windows.size());
  }
  // The most that any addition could bring: half of χ² above what noise alone leaves.
  double AtStake(const Candidate& c) const { return 0.5 * (c.fit.chi2 / lifted_.noise_scale - Noise(c)); }

  bool AddOne(Candidate* best) {
    Tell("screen", 0.1 + 0.2 * round_, KeyOf(best->specs));
    Candidate winner = *best;
    if (Known(best->specs, !best->base) == nullptr) Evaluate(Refreshed(*best), !best->base, best);
    for (const bool base : {false, true}) {
      if (Late()) break;
      // Hidden states and unnamed forces fit nearly anything: an account with them has those with free
      // parameters as its rivals.
      if (base && !(best->base && (HasUnnamed(winner) || HasHiddenStates(winner))) &&
          PerRow(winner) < kExplained && winner.score > best->score + Threshold(*best, winner))
        break;
      const Candidate* own = base == best->base ? best : Known(best->specs, !best->base);
      if (own == nullptr || !own->fit.ok) continue;
      // Parameters explain much: only what explains it as well with less is of interest.
      const bool rival = !base && best->base &&
                         (AtStake(*best) < Threshold(*best) ||
                          (round_ > 1 && own->score < best->score - 0.5 * data_.Rows()));
      const Candidate from = *own;
      const ScreenResult screened = Screened(from, base);
      acceptance_.Note(screened, nominal_.joint_names());
      trace_.Screen(screened, base);
      const double best_gain = screened.hypotheses.empty() ? 0.0 : screened.hypotheses.front().gain;
      if (AtStake(from) < Threshold(*best) && best_gain < Threshold(*best)) {
        if (base == best->base) break;  // nothing is left; freed parameters would leave less
        continue;
      }
      const double wanted = rival ? kRivalShare * (best->score - from.score) : 1.0;
      const auto nearest = [&](const auto& starts, size_t count) {
        return Looked(from, base, starts, count);
      };
      const auto force = [&] { return Force(from); };
      const auto pool = Trials(data_, nominal_, scales_, from, screened, wanted, force, nearest);
      TryBest(from, pool, base, base ? 3 : 4, &winner);
    }
    if (KeyOf(winner.specs) != KeyOf(best->specs)) {
      Restart(&winner);
      DropNothing(&winner);
      Siblings(*best, &winner);
      winner = InEitherWorld(winner, Threshold(*best));
    }
    const auto needs = [&](const Candidate& a, const Candidate& b) { return Threshold(a, b); };
    if (const Candidate* c = FewerNames(tried_, *best, winner, needs)) winner = Longer(*c, *c, *c);
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
      Prune(best);
      Plainer(best);
    }
    return accept;
  }

  // With free base parameters or without, whichever is worth it; they must bring `least`.
  Candidate InEitherWorld(const Candidate& c, double least) {
    const Candidate twin = Evaluate(Refreshed(c), !c.base, &c, 6, &c);
    const Candidate &plain = c.base ? twin : c, &freed = c.base ? c : twin;
    return freed.score > plain.score + std::max(least, Threshold(plain, freed)) ? freed : plain;
  }

  // Fitted on, from where `from` is and with the values of `rival`: in either world where that brings more.
  Candidate Longer(const Candidate c, const Candidate from, const Candidate rival) {
    const Candidate longer = Evaluate(RefreshedFrom(c, rival), c.base, &from, 12, &rival);
    if (longer.score < c.score + 1) return Better(c, longer);
    return c.base && HasHiddenStates(c) ? InEitherWorld(longer, 0) : longer;
  }

  // Of several effects added at once each must be worth its name; at the end, beside what was tried already.
  Candidate Justified(const Candidate& before, Candidate winner) {
    while (!Cancelled()) {
      const std::set<std::string> fresh = FreshKinds(before, winner);
      if (fresh.size() < 2) return winner;
      Candidate fewer = winner;
      fewer.score = -1e300;
      for (const std::string& id : fresh) {
        std::vector<EffectSpec> specs = Refreshed(winner);
        std::erase_if(specs, [&](const EffectSpec& s) { return s.id == id; });
        const Candidate* known = Known(specs, winner.base);
        if (Late() && known == nullptr) continue;
        fewer = Better(fewer, Late() ? *known : Evaluate(specs, winner.base, &winner, 6, &winner));
      }
      if (winner.score > fewer.score + Threshold(fewer, winner)) return winner;
      winner = fewer;
    }
    return winner;
  }

  // The ceiling: one unnamed force over two joints' positions, or one joint's, in the place of all effects
  // found. It is taken where it leaves less than `worst` χ² per row and is the better account.
  bool Flexible(Candidate* best, double worst) {
    if (Cancelled() || (PerRow(*best) < kExplained && data_.n > 1)) return false;
    bool taken = false;
    for (const Candidate& c : Unnamed(*best, {"position"})) {
      if (c.score > best->score + Threshold(*best) && PerRow(c) < worst) *best = c, taken = true;
    }
    return taken;
  }

  std::vector<Candidate> Unnamed(const Candidate& best, const std::vector<std::string>& variables) {
    std::vector<Candidate> out;
    Tell("flexible", 0.3 + 0.15 * round_, KeyOf(best.specs));
    for (const bool base : {false, true}) {
      const Candidate* from = Known(given_, base);
      if (from == nullptr || !from->fit.ok) continue;
      // Free base parameters only where they are part of the account.
      if (base && !best.base) continue;
      const MissingForce force = Force(*from);
      for (const std::string& variable : variables) {
        const auto spec = variable == "position" && data_.n > 1
                              ? FieldPairStart(data_, nominal_, scales_, force)
                              : FieldStart(data_, nominal_, scales_, force, variable);
        if (!spec) continue;
        const std::vector<EffectSpec> specs = Joined(given_, {*spec});
        const Candidate* done = Known(specs, base);
        out.push_back(done != nullptr ? *done : Evaluate(specs, base));
      }
    }
    return out;
  }

  // An account must hold on recordings kept aside, or what was tried and predicts them better takes its
  // place. One that explains less than half of what is missing there is none, however well it follows what it
  // was fitted to.
  void SendBack(const Candidate& without, Candidate* best, SearchResult* out) {
    HeldOutJudge judge(*data_.held_out, lifted_, trace_);
    if (PerRow(*best) < kExplained) out->unseen_in = judge.Refusing(*best, Threshold(*best));
    const bool named = !best->specs.empty() && !FoundNothing(*best);
    for (int sent = 0; named && sent < kSentBack && !Late() && !judge.Holds(*best, Threshold(*best));
         ++sent) {
      Unnamed(*best, {"position", "velocity"});
      const auto rival = judge.Better(*best, tried_, [&](const Candidate& c) { return Threshold(*best, c); });
      if (!rival) break;
      out->sent_back = true;
      Tell("sent back", 0.9, KeyOf(best->specs) + "for " + KeyOf(rival->specs));
      *best = *rival;
    }
    if (judge.Holds(*best, Threshold(*best))) {
      out->unseen_in = -1;
    } else if (named && !judge.ExplainsMost(*best, without)) {
      Tell("sent back", 0.9, KeyOf(best->specs) + "for nothing");
      *best = without;
      out->sent_back = true;
    }
    work_ += judge.work();
  }

  double PerRow(const Candidate& c) const {
    return c.fit.chi2 / std::max(1, c.fit.rows) / lifted_.noise_scale;
  }

  std::vector<TrialSpecs> Looked(const Candidate& from, bool base, const std::vector<TrialSpecs>& starts,
                                 size_t count) {
    const FitRequest look{Refreshed(from), base, lifted_, {}, 0, false, Start(&from, base)};
    return NearestStarts(
        fits_, setting_, look, from.fit.window_chi2, starts, count, [&] { return Late(kToTheEnd); }, &work_);
  }

  // The shortest pieces over which a model without what is missing is seen not to hold: shorter ones hide it
  // from every trial. 0: whole windows.
  double TellingPiece(FitRequest trial) {
    trial.pieces_alone = true;
    for (double piece = kPiece; piece < kLongestPiece * data_.nodes.window_s; piece *= kLongerPiece) {
      trial.piece_s = piece;
      if (PerRow(Fitted(trial, fits_.Start(setting_, {trial})->Take(0))) > kHolds) return piece;
    }
    return 0;
  }

  // Trials on some windows with few iterations; the best of them on all.
  void TryBest(const Candidate& from, const std::vector<TrialSpecs>& pool, bool base, size_t full,
               Candidate* winner) {
    const auto windows = SomeWindows(from.fit.window_chi2, data_.windows.size(), data_.n <= 2 ? 24 : 14);
    FitRequest trial{Refreshed(from), base, lifted_, windows, 0, false, Start(&from, base)};
    trial.options.iterations = 4;
    trial.options.more_iterations = kMoreIterations, trial.options.still_falling = kFallsFast;
    // Whole windows, or pieces of them where only pieces are met, but not for hidden states, which need whole
    // windows: each has its own reference.
    std::vector<FitRequest> trials = {trial};
    if (FromPieces(trial)) trial.piece_s = TellingPiece(trial), trial.pieces_alone = trial.piece_s > 0;
    trials.push_back(trial);
    for (const TrialSpecs& start : pool) {
      trial.specs = Joined(Refreshed(from), start);
      trials.push_back(trial);
    }
    std::vector<RankedTrial> ranked, hidden;
    const double enough = work_ + kTrialShare * options_.work_limit;
    {
      const auto batch = fits_.Start(setting_, trials);
      const double on_windows = Fitted(trials[0], batch->Take(0)).score;
      const double on_pieces = trial.pieces_alone ? Fitted(trials[1], batch->Take(1)).score : on_windows;
      bool met = false;
      for (size_t i = 2; i < trials.size() && !Late() && work_ <= enough; ++i) {
        // Where a law of what is recorded meets it, hidden states have no part.
        if (met && HasHiddenStates(Unfitted(setting_, trials[i].specs, base))) continue;
        const Candidate c = Fitted(trials[i], batch->Take(i));
        const bool whole = HasHiddenStates(c);
        const double before = whole ? on_windows : on_pieces;
        const bool better = c.fit.ok && c.score >= before;
        trace_.Fit(c, better ? "  ~" : "  -");
        auto& list = whole && trial.pieces_alone ? hidden : ranked;
        if (better) list.push_back({c.score / std::min(before, -1.0), Refreshed(c)});
        met = met || (better && !whole && !trial.pieces_alone && !HasUnnamed(c) &&
                      lifted_.noise_scale * PerRow(c) < kExplained && PerRow(from) > kExplained);
      }
    }
    // What its misfit on all windows would be, by the best trial.
    Candidate nearest = from;
    for (const RankedTrial& t : ranked) nearest.score = std::max(nearest.score, t.left * from.score);
    std::vector<FitRequest> best;
    for (const TrialSpecs& specs : BestOf(std::move(ranked), std::move(hidden), full))
      best.push_back(WholeFit(specs, base, trial.from, 6, trial.pieces_alone ? nullptr : &nearest));
    Candidate found = from;
    TakeBest(best, 1, &found);
    TrySprings(from, &found);
    *winner = Better(*winner, found);
  }

  // Fits them on all windows, at least so many however much work is done.
  void TakeBest(const std::vector<FitRequest>& requests, size_t least, Candidate* winner) {
    const auto batch = fits_.Start(setting_, requests);
    for (size_t i = 0; i < requests.size() && (i < least || !Late(kToTheEnd)); ++i)
      *winner = Better(*winner, Tried(requests[i], batch->Take(i)));
  }

  // Springs behind the rotors that an account adds, before free base parameters make up for them.
  void TrySprings(const Candidate& from, Candidate* account) {
    const auto springs = SpringsBehind(from, *account, nominal_, scales_);
    const bool base = account->base;
    std::vector<FitRequest> fits;
    for (const TrialSpecs& spring : Looked(*account, base, springs, kSprings))
      fits.push_back(
          WholeFit(Joined(StrongEffects(*account), spring), base, Start(nullptr, base), 6, account));
    TakeBest(fits, 1, account);
  }

  // A winner that does not hold may lack another effect, or its fit got stuck on its way from base parameters
  // that had taken its effects' place: it has another try from nominal ones, over pieces.
  void Restart(Candidate* winner) {
    if (PerRow(*winner) < kHolds || Late()) return;
    FitRequest request = WholeFit(Refreshed(*winner), winner->base, nullptr);
    request.piece_s = kPiece;
    *winner = Better(*winner, Tried(request, fits_.Start(setting_, {request})->Take(0)));
  }

  // The winner with each new kind of effect, or its newest, exchanged for what it is easily taken for.
  void Siblings(const Candidate& before, Candidate* winner) {
    const std::vector<EffectSpec> specs = Refreshed(*winner);
    if (specs.empty()) return;
    std::set<std::string> kinds = FreshKinds(before, *winner);
    if (kinds.empty()) kinds = {specs.back().id};
    std::vector<FitRequest> others;
    for (const std::string& kind : kinds) {
      for (const TrialSpecs& other : Exchanges(specs, kind, nominal_, scales_)) {
        if (Known(other, winner->base) == nullptr)
          others.push_back(WholeFit(other, winner->base, Start(nullptr, winner->base), 6, winner));
      }
    }
    TakeBest(others, 0, winner);
  }

  const Candidate* Known(const std::vector<EffectSpec>& specs, bool base) const {
    const auto it = tried_.find(KeyOf(specs) + (base ? "+base" : ""));
    return it == tried_.end() ? nullptr : &it->second;
  }

  // Takes out all at once what is about nothing.
  void DropNothing(Candidate* best) {
    const std::vector<EffectSpec> strong = StrongEffects(*best);
    if (strong.empty() || strong.size() == best->specs.size() || Late(kPruned)) return;
    const Candidate c = Evaluate(strong, best->base, best);
    if (best->score < c.score + Threshold(c, *best)) *best = c;
  }

  // And one by one what the data do not pay for.
  void Prune(Candidate* best) {
    DropNothing(best);
    bool changed = true;
    while (changed && best->specs.size() > 1 && !Late(kPruned)) {
      changed = false;
      for (size_t i = 0; i < best->specs.size() && !changed; ++i) {
        if (SurelyThere(*best, i, Threshold(*best))) continue;
        std::vector<EffectSpec> specs = Refreshed(*best);
        specs.erase(specs.begin() + static_cast<long>(i));
        const Candidate c = Evaluate(specs, best->base, best, 4, best);
        const double worth = OneOfMany(best->specs, i) ? Threshold(c, *best) : 0.0;
        if (best->score < c.score + worth) *best = c, changed = true;
      }
    }
  }

  // Dry friction of a richer form that is not worth more than plain dry friction.
  void Plainer(Candidate* best) {
    for (const char* id : {"stribeck_friction", "asymmetric_friction", "load_dependent_friction",
                           "presliding_hysteresis", "thermal_drift"}) {
      const TrialSpecs specs = Exchanges(Refreshed(*best), id, nominal_, scales_).front();
      if (KeyOf(specs) == KeyOf(best->specs) || Late(kPruned)) continue;
      const Candidate* known = Known(specs, best->base);
      // What it holds as a special case cannot be better: the plain one's fit had not found its way.
      const bool done = known != nullptr && known->score >= best->score;
      const Candidate plain = done ? *known : Evaluate(specs, best->base, best, 6, best);
      const double needed = Threshold(plain, *best);
      if (best->score >= plain.score + needed) continue;
      // What the form may pretend is not held for it when rivals are weighed.
      tried_[KeyOf(best->specs) + (best->base ? "+base" : "")].score -= needed;
      *best = plain;
    }
  }

  const FitData& data_;
  const sim::Plant& nominal_;
  const MotionScales& scales_;
  FitSetting setting_;
  LocalFits local_;
  FitExecutor& fits_;  // who makes the fits
  const DiagnosisOptions& options_;
  const ProgressFn& progress_;
  const CancelToken* cancel_;
  Trace trace_;
  LiftedOptions lifted_;
  int round_ = 0;
  double work_ = 0;  // of all fits so far
  Acceptance acceptance_;
  std::shared_ptr<const Candidate> pieces_;  // base parameters from pieces, where whole windows are not met
  std::vector<VectorXd> step_rule_;
  FeatureSet features_;
  std::vector<EffectSpec> given_;  // that the model has which the search starts from
  std::map<std::string, Candidate> tried_;
};

}  // namespace

SearchResult SearchEffects(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                           const DiagnosisOptions& options, int threads, const Clock& clock,
                           const ProgressFn& progress, const CancelToken* cancel) {
  return Search(data, nominal, scales, options, threads, clock, progress, cancel).Run();
}

}  // namespace rg::diagnosis
