#include "services/diagnosis/search/fit_ledger.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <initializer_list>
#include <set>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/jumps.h"
#include "services/diagnosis/likelihood/some_windows.h"
#include "services/diagnosis/likelihood/swing_starts.h"
#include "services/diagnosis/search/nearest_starts.h"
#include "services/diagnosis/search/pendulum_search.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr int kMoreIterations = 14;     // while the cost falls
constexpr double kHopeless = 2.0;       // times the rival's misfit: a fit that would stay above ends early
constexpr double kFallsFast = 0.1;      // of the cost in one iteration, for a trial fit to go on
constexpr double kTrialShare = 0.3;     // of the work limit, for the trials of one screen
constexpr double kLookShare = 0.04;     // of the work limit, for choosing starts of one law
constexpr double kInPlaceYet = 1.8;     // of the work limit, after which no laws are exchanged
constexpr double kShortestPiece = 0.1;  // s
constexpr size_t kSprings = 2;  // starts behind rotors that are fitted, for either place of the sensor
constexpr size_t kInPlace = 2;  // exchanged laws that are fitted on all windows
constexpr double kMuchWorse =
    0.1;  // of the misfit, by which an exchanged law may be worse in its trial, or a model with another step

// The trial with this property that leaves the least share of the misfit, if less than `least`.
std::shared_ptr<const Candidate> LeavesLeast(std::initializer_list<const std::vector<RankedTrial>*> trials,
                                             double least,
                                             const std::function<bool(const Candidate&)>& like_this) {
  std::shared_ptr<const Candidate> out;
  for (const std::vector<RankedTrial>* list : trials) {
    for (const RankedTrial& t : *list) {
      if (t.left < least && like_this(*t.fitted)) least = t.left, out = t.fitted;
    }
  }
  return out;
}

// An unnamed force over two joints' positions.
bool HasSurface(const TrialSpecs& specs) {
  return std::ranges::any_of(specs,
                             [](const EffectSpec& s) { return IsUnnamed(s.id) && s.joints.size() > 1; });
}

std::set<std::string> SpringyJoints(const TrialSpecs& specs) {
  std::set<std::string> out;
  for (const EffectSpec& s : specs) {
    if (effects::IsIn(effects::Slot::kTransmission, s.id)) out.insert(s.joints.begin(), s.joints.end());
  }
  return out;
}

// Whether `specs` are one of the models with something added.
bool HoldsOneOf(const std::vector<TrialSpecs>& accounts, const TrialSpecs& specs) {
  return std::ranges::any_of(
      accounts, [&](const TrialSpecs& model) { return model.size() < specs.size() && IsPart(model, specs); });
}

// As a start of fits over other windows.
std::shared_ptr<const Candidate> ValuesOf(Candidate c) {
  return std::make_shared<const Candidate>(WithoutStates(std::move(c)));
}

}  // namespace

FitLedger::FitLedger(const FitSetting& setting, const DiagnosisOptions& options, int threads,
                     const Trace& trace, const CancelToken* cancel)
    : setting_(setting),
      options_(options),
      trace_(trace),
      cancel_(cancel),
      made_(options.fits == nullptr ? local_ : *options.fits) {
  lifted_.threads = threads;
  lifted_.step_s = options.step_s;
}

bool FitLedger::Late(double limits) const {
  return Cancelled() || work_ - forgiven_ > limits * options_.work_limit || OutOfTime();
}

bool FitLedger::OutOfTime() const {
  return options_.time_limit_s > 0 && trace_.Elapsed() > options_.time_limit_s;
}

void FitLedger::SetNoiseScale(double scale) {
  for (auto& [key, c] : tried_) Rescale(lifted_.noise_scale, scale, &c);
  lifted_.noise_scale = scale;
  made_.Forget();
}

const Candidate* FitLedger::Known(const std::vector<EffectSpec>& specs, bool base) const {
  const auto it = tried_.find(KeyOf(specs, base));
  return it == tried_.end() ? nullptr : &it->second;
}

FitResult FitLedger::Made(const FitRequest& request) { return made_.Start(setting_, {request})->Take(0); }

Candidate FitLedger::Fitted(const FitRequest& request) { return Fitted(request, Made(request)); }

Candidate FitLedger::Evaluate(const std::vector<EffectSpec>& specs, bool base, const Candidate* from,
                              int iterations, const Candidate* rival) {
  const FitRequest request = WholeFit(specs, base, Start(from, base), iterations, rival);
  return Tried(request, Made(request));
}

Candidate FitLedger::KnownOrFitted(const std::vector<EffectSpec>& specs, bool base, const Candidate* from,
                                   int iterations) {
  const Candidate* known = Known(specs, base);
  return known != nullptr ? *known : Evaluate(specs, base, from, iterations);
}

Candidate FitLedger::Calibrated(const std::vector<EffectSpec>& specs) {
  FitRequest request = WholeFit(specs, true, pieces_);
  request.options.to_beat = kConsistent * setting_.data.Rows();
  return Tried(request, Made(request));
}

Candidate FitLedger::Anew(const Candidate& c) {
  FitRequest request = WholeFit(Refreshed(c), c.base, nullptr);
  request.piece_s = kShortestPiece;
  return Tried(request, Made(request));
}

Candidate FitLedger::WithExactValues(const Candidate& c) {
  if (!(PerRow(c) < kConsistent) || HasUnnamed(c)) return c;
  FitRequest request = WholeFit(Refreshed(c), c.base, std::make_shared<const Candidate>(c));
  request.options.for_values = true;
  Candidate on = Fitted(request, MakeFit(setting_, request));
  trace_.Fit(on, "values");
  if (!(on.score > kNoScore && on.fit.chi2 < (1 + kMuchWorse) * c.fit.chi2)) return c;
  on.score = c.score, on.form = c.form, on.round = c.round, on.held_out = c.held_out;
  return on;
}

void FitLedger::FindPieces(const std::vector<EffectSpec>& specs) {
  FitRequest request{specs, true, lifted_, {}, kShortestPiece, true, nullptr};
  request.options.more_iterations = kMoreIterations;
  auto pieces = std::make_shared<Candidate>(Fitted(request));
  trace_.Fit(*pieces, "pieces");
  if (pieces->fit.ok) pieces_ = pieces;
}

// The states and base parameters of a consistent model: an addition or removal changes them little, and all
// such fits share one start. Of a pendulum's model also where it is not consistent, for its phase is costly.
std::shared_ptr<const Candidate> FitLedger::Start(const Candidate* from, bool base) const {
  if (from == nullptr || !from->fit.ok) return base ? pieces_ : nullptr;
  if (PerRow(*from) < kConsistent || HasPendulum(from->specs))
    return std::make_shared<const Candidate>(*from);
  if (!base) return nullptr;
  const Candidate* nearest = from->base ? NearestBase(*from) : pieces_.get();
  return nearest == pieces_.get() ? pieces_ : ValuesOf(*nearest);
}

const Candidate* FitLedger::NearestBase(const Candidate& c) const {
  if (!c.base) return nullptr;
  const bool as_pieces = pieces_ != nullptr && KeyOf(c.specs) == KeyOf(pieces_->specs);
  return c.specs.empty() || as_pieces ? pieces_.get() : &c;
}

FitRequest FitLedger::WholeFit(const std::vector<EffectSpec>& specs, bool base,
                               std::shared_ptr<const Candidate> from, int iterations,
                               const Candidate* rival) const {
  FitRequest request{specs, base, lifted_, {}, 0, false, std::move(from)};
  if (request.from != nullptr && request.from->fit.states.empty()) request.piece_s = kShortestPiece;
  request.options.iterations = iterations;
  request.options.more_iterations = kMoreIterations;
  if (rival != nullptr && rival->fit.ok) request.options.to_beat = -2 * kHopeless * rival->score;
  return request;
}

Candidate FitLedger::Fitted(const FitRequest& request, FitResult fit) {
  Candidate c = Unfitted(setting_, request.specs, request.base);
  work_ += fit.work;
  c.fit = std::move(fit);
  c.round = round_;
  if (request.places.empty()) ContinueFields(&c);
  // A few windows need not show what all of them do, as a limit that is seldom reached.
  c.fit.ok = c.fit.ok && (!request.places.empty() || !Uninformed(c));
  // A trial may find a law on its way that no fit ends at; and what a given model has is not doubted.
  const auto doubted = [&](effects::Regressor law) {
    return request.places.empty() && !HasKind(setting_.nominal.effects(), effects::LawOf(law).id);
  };
  if (doubted(effects::Regressor::kSlowly)) c.fit.ok = c.fit.ok && Rising(c).empty();
  if (doubted(effects::Regressor::kPosition)) c.fit.ok = c.fit.ok && PullsBack(c, setting_.scales);
  // While much is left a ripple's period is bent by it, and on some windows by little.
  if (c.fit.ok && PerRow(c) < (request.places.empty() ? kConsistent : kExplained))
    c.fit.ok = Aperiodic(c, setting_.scales, lifted_.noise_scale, request.places.empty()).empty();
  const bool stands = c.fit.ok && (!request.places.empty() || Admissible(&c));
  c.score = stands ? c.fit.evidence - StructurePrior(c.specs, c.base) : kNoScore;
  return c;
}

// A fit on all windows, kept.
Candidate FitLedger::Tried(const FitRequest& request, FitResult fit) {
  const Candidate c = Fitted(request, std::move(fit));
  if (c.plant == nullptr) return c;
  auto [it, fresh] = tried_.try_emplace(KeyOf(c.specs, c.base), c);
  if (!fresh && c.score > it->second.score) it->second = c;
  trace_.Fit(c, "fit");
  return c;
}

std::vector<TrialSpecs> FitLedger::Nearest(const Candidate& from, const std::vector<TrialSpecs>& starts,
                                           size_t count) {
  const FitRequest look{Refreshed(from), from.base, lifted_, {}, 0, false, Start(&from, from.base)};
  const double enough = WorkAfter(kLookShare);
  const auto late = [&] { return Late(kWorkForComparisons) || work_ > enough; };
  return NearestStarts(made_, setting_, look, from.fit.window_chi2, starts, count, late, &work_);
}

// Some windows, few iterations, on while they pay.
FitRequest FitLedger::Trial(const Candidate& from, bool base, std::shared_ptr<const Candidate> start) const {
  const FitData& data = setting_.data;
  std::vector<double> amiss = from.fit.window_chi2;
  for (double& chi2 : amiss) chi2 = std::max(0.0, chi2 - RowsPerWindow(data));
  FitRequest trial{Refreshed(from),
                   base,
                   lifted_,
                   SomeWindows(amiss, data.windows.size(), data.WindowsFor(data.n <= 2 ? 24 : 14)),
                   0,
                   false,
                   std::move(start)};
  trial.options.iterations = 4;
  trial.options.more_iterations = kMoreIterations, trial.options.still_falling = kFallsFast;
  return trial;
}

// The shortest pieces over which the model without an addition is inconsistent: shorter ones would hide what
// is missing from every trial. 0: whole windows.
double FitLedger::TellingPiece(FitRequest trial) {
  trial.pieces_alone = true;
  for (double piece = kShortestPiece; piece < kLongestPiece * setting_.data.nodes.window_s;
       piece *= kLongerPiece) {
    trial.piece_s = piece;
    if (PerRow(Fitted(trial)) > kConsistent) return piece;
  }
  return 0;
}

FitLedger::TrialResults FitLedger::RunTrials(const Candidate& from, const std::vector<TrialSpecs>& pool) {
  TrialResults out{Trial(from, from.base, Start(&from, from.base)), {}, {}, {}};
  FitRequest trial = out.setting;
  // Whole windows; pieces of them where all that is known are base parameters from pieces, except with hidden
  // states, which need whole windows. Each has its own reference.
  std::vector<FitRequest> trials = {trial};
  if (trial.from != nullptr && trial.from == pieces_)
    trial.piece_s = TellingPiece(trial), trial.pieces_alone = trial.piece_s > 0;
  out.setting = trial;
  trials.push_back(trial);
  for (const TrialSpecs& start : pool) {
    trial.specs = Joined(Refreshed(from), start);
    trials.push_back(trial);
  }
  const double enough = WorkAfter(kTrialShare);
  const auto batch = made_.Start(setting_, trials);
  const auto fitted = [&](size_t i) { return Fitted(trials[i], batch->Take(i)); };
  const Candidate reference = fitted(0);
  const double on_windows = reference.score;
  const bool something = PerRow(from) > kExplained && PerRow(reference) > kExplained;
  const double on_pieces = trial.pieces_alone ? fitted(1).score : on_windows;
  std::vector<TrialSpecs> met;
  for (size_t i = 2; i < trials.size() && !Late() && work_ <= enough; ++i) {
    // Where a law without hidden states leaves nothing, hidden states and further additions are not tried.
    if (!met.empty() && HasFreeStates(Unfitted(setting_, trials[i].specs, from.base))) continue;
    if (HoldsOneOf(met, trials[i].specs)) continue;
    const Candidate c = fitted(i);
    const bool whole = HasHiddenStates(c);
    const double before = whole ? on_windows : on_pieces;
    const bool better = c.fit.ok && c.score >= before;
    trace_.Fit(c, better ? "  ~" : "  -");
    if (!c.fit.ok) out.refused.insert(KeyOf(c.specs));
    auto& list = whole && trial.pieces_alone ? out.hidden : out.ranked;
    if (better)
      list.push_back({c.score / std::min(before, -1.0), Excess(c), std::make_shared<const Candidate>(c)});
    if (better && !HasFreeStates(c) && !trial.pieces_alone && !HasUnnamed(c) &&
        lifted_.noise_scale * PerRow(c) < kExplained && something)
      met.push_back(c.specs);
  }
  return out;
}

void FitLedger::TryBest(const Candidate& from, const std::vector<TrialSpecs>& pool,
                        const std::vector<TrialSpecs>& promised, size_t count, Candidate* winner) {
  TrialResults trials = RunTrials(from, pool);
  const PendulumTrials pendulum = TakePendulumTrials(from, &trials);
  Candidate found = from;
  TakeBest(WorthAFit(from, std::move(trials), promised, count, *winner), 1, &found);
  TrySprings(from, &found);
  PendulumSearch(setting_, *this, trace_, from, pendulum).Run(&found);
  if (found.score > winner->score) *winner = found;
}

// What tells of a swinging mass. A force over two positions follows some of anything: it is only what a
// swinging mass has to better, and is taken from the trials.
PendulumTrials FitLedger::TakePendulumTrials(const Candidate& from, TrialResults* trials) const {
  PendulumTrials out;
  if (!HasSurface(from.specs)) {
    std::erase_if(trials->ranked, [&](const RankedTrial& t) {
      if (!HasSurface(t.fitted->specs)) return false;
      out.surface = t.fitted;
      return true;
    });
  }
  for (const bool last_link : {false, true}) {
    const auto best = LeavesLeast({&trials->ranked, &trials->hidden}, kSwings, [&](const Candidate& c) {
      return HasMassInSprings(c.specs) && !HasKind(from.specs, effects::SwingingMass().id) &&
             SwingsOnLastLink(c.specs) == last_link;
    });
    if (best != nullptr) out.springs.push_back(best);
  }
  std::ranges::stable_sort(out.springs,
                           [&](const auto& a, const auto& b) { return PerRow(*a) < PerRow(*b); });
  return out;
}

// Fits on all windows of the `count` best, of what is promised, and of the best with hidden states, whatever
// its rank, since another effect may be missing too.
std::vector<FitRequest> FitLedger::WorthAFit(const Candidate& from, TrialResults trials,
                                             const std::vector<TrialSpecs>& promised, size_t count,
                                             const Candidate& winner) const {
  const bool base = from.base;
  const FitRequest& trial = trials.setting;
  // The score on all windows that the best trial suggests.
  Candidate nearest = from;
  for (const RankedTrial& t : trials.ranked) {
    // Not of a swinging mass: in a trial each window has its own start.
    if (!HasMassInSprings(t.fitted->specs)) nearest.score = std::max(nearest.score, t.left * from.score);
  }
  const auto with_states = LeavesLeast({&trials.ranked}, kPartly, [](const Candidate& c) {
    return HasHiddenStates(c) && !HasMassInSprings(c.specs);
  });
  // From the model that the trials started at where that is consistent, else from the trials' base
  // parameters.
  const bool holds = trial.from != nullptr && !trial.from->fit.states.empty();
  std::vector<FitRequest> out;
  // Trials on pieces say nothing of whole windows: the rival is then the best known model.
  const Candidate& rival = trial.pieces_alone ? winner : nearest;
  for (const auto& c : BestOf(std::move(trials.ranked), std::move(trials.hidden), count))
    out.push_back(WholeFit(Refreshed(*c), base, holds || !base ? trial.from : ValuesOf(*c), 6, &rival));
  const auto add = [&](const TrialSpecs& specs) {
    const bool chosen = std::ranges::any_of(
        out, [&](const FitRequest& request) { return KeyOf(request.specs) == KeyOf(specs); });
    if (!chosen) out.push_back(WholeFit(specs, base, trial.from));
  };
  for (const TrialSpecs& start : promised) {
    const TrialSpecs specs = Joined(Refreshed(from), start);
    if (trials.refused.count(KeyOf(specs)) == 0) add(specs);
  }
  if (!base && with_states != nullptr) add(Refreshed(*with_states));
  return out;
}

// Fits on all windows, `least` of them whatever the work limit. Where a spring or play leaves nothing of what
// there was, none is fitted on other joints.
void FitLedger::TakeBest(const std::vector<FitRequest>& requests, size_t least, Candidate* winner) {
  const auto batch = made_.Start(setting_, requests);
  const bool something = winner->fit.ok && !LeavesNothing(*winner);
  std::vector<TrialSpecs> met;  // models that leave nothing: no addition to these is fitted
  std::set<std::string> springy;
  for (size_t i = 0; i < requests.size() && !Cancelled() && (i < least || !Late(kWorkForComparisons)); ++i) {
    const std::set<std::string> here = SpringyJoints(requests[i].specs);
    const bool elsewhere = !springy.empty() && !here.empty() && here != springy;
    if (elsewhere || HoldsOneOf(met, requests[i].specs)) continue;
    const Candidate c = Tried(requests[i], batch->Take(i));
    if (c.score > winner->score) *winner = c;
    if (!c.fit.ok || HasUnnamed(c) || !MeetsSensors(c)) continue;
    if (!HasFreeStates(c)) met.push_back(c.specs);
    if (something && springy.empty() && LeavesNothing(c)) springy = here;
  }
}

// A swinging mass absorbs part of nearly anything: an inconsistent model with one is inadmissible.
bool FitLedger::Admissible(Candidate* candidate) {
  const Candidate& c = *candidate;
  const std::string& swinging = effects::SwingingMass().id;
  if (!HasKind(c.specs, swinging) || HasKind(setting_.nominal.effects(), swinging)) return true;
  if (!(PerRow(c) < kConsistent) || !HasPendulum(c.specs)) return PerRow(c) < kConsistent;
  const double before = c.fit.work;
  const bool swings_on = SwingsOn(setting_.data, *c.plant, &candidate->fit, AsFitted(c)).value_or(true);
  work_ += c.fit.work - before;
  return swings_on;
}

void FitLedger::TrySprings(const Candidate& from, Candidate* model) {
  if (model->base && Excess(*model) > kPartly * Excess(from)) return;
  const auto behind = SpringsBehind(from, *model, setting_.nominal, setting_.scales);
  const bool base = model->base;
  // A rotor that leaves nothing is a limit of a stiff spring or a narrow gap: fits start at its own.
  const bool explains = PerRow(*model) < kExplained;
  const auto start = Start(explains ? model : nullptr, base);
  std::vector<FitRequest> fits;
  for (const std::string& effect : {effects::Spring().id, effects::Play().id}) {
    if (effect == effects::Play().id && !explains) continue;
    for (const char* sensor : {"link", "motor"}) {
      std::vector<TrialSpecs> there = behind;
      std::erase_if(there, [&](const TrialSpecs& s) {
        return s[0].id != effect || s[0].options.at("sensor") != sensor;
      });
      for (const TrialSpecs& nearest : Nearest(*model, there, explains ? 1 : kSprings))
        fits.push_back(WholeFit(Joined(StrongEffects(*model), nearest), base, start, 6, model));
    }
  }
  TakeBest(fits, 1, model);
}

bool FitLedger::MayLeaveLess(const Candidate& model, const std::vector<EffectSpec>& specs, bool base,
                             double share) {
  FitRequest trial = Trial(model, model.base, Start(&model, model.base));
  const Candidate own = Fitted(trial);
  if (base != model.base) trial = Trial(model, base, Start(&model, base));
  trial.specs = specs;
  const Candidate other = Fitted(trial);
  trace_.Fit(other, "  <");
  for (const Candidate* c : {&own, &other}) {
    if (!(c->fit.chi2 > 0) || c->fit.rows == 0) return true;
  }
  return other.fit.chi2 - other.fit.rows < share * (own.fit.chi2 - own.fit.rows);
}

void FitLedger::TryInPlace(const std::vector<TrialSpecs>& others, Candidate* winner) {
  if (others.empty()) return;
  const bool base = winner->base;
  const auto start = Start(winner, base);
  std::vector<FitRequest> trials = {Trial(*winner, base, start)};
  for (const TrialSpecs& other : others) {
    trials.push_back(trials[0]);
    trials.back().specs = other;
  }
  std::vector<RankedTrial> ranked;
  {
    const auto batch = made_.Start(setting_, trials);
    const double own = Fitted(trials[0], batch->Take(0)).score;
    const double least = own - std::max(5.0, kMuchWorse * std::abs(own));
    for (size_t i = 1; i < trials.size() && !Late(kInPlaceYet); ++i) {
      const Candidate c = Fitted(trials[i], batch->Take(i));
      trace_.Fit(c, c.score >= least ? "  =" : "  -");
      if (c.fit.ok && c.score >= least)
        ranked.push_back({-c.score, Excess(c), std::make_shared<const Candidate>(c)});
    }
  }
  std::vector<FitRequest> best;
  for (const auto& c : BestOf(std::move(ranked), {}, kInPlace))
    best.push_back(WholeFit(Refreshed(*c), base, start, 6, winner));
  Candidate found = *winner;
  TakeBest(best, best.size(), &found);
  for (const FitRequest& request : best) {
    const Candidate* other = Known(request.specs, base);
    const TrialSpecs needed = other == nullptr ? request.specs : StillNeeded(*winner, *other);
    if (needed.size() == request.specs.size() || needed.empty() || Known(needed, base) != nullptr) continue;
    const Candidate fewer = Evaluate(needed, base, other, 6, winner);
    if (fewer.score > found.score) found = fewer;
  }
  if (!(found.score > winner->score)) return;
  // The winner is fitted on from its end too, or an exchange would be credited with what a longer fit brings.
  const auto end = winner->fit.ok ? std::make_shared<const Candidate>(*winner) : start;
  TakeBest({WholeFit(Refreshed(*winner), base, end, 6, &found)}, 1, winner);
  if (found.score > winner->score) *winner = found;
}

}  // namespace rg::diagnosis
