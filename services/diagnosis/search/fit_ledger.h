// The fits of one search: requests them, scores them, and keeps every fitted model and what it cost.
#pragma once

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "services/diagnosis/api/options.h"
#include "services/diagnosis/search/fit_requests.h"
#include "services/diagnosis/search/remembered_fits.h"
#include "services/diagnosis/search/trace.h"
#include "services/diagnosis/search/trials.h"

namespace rg::diagnosis {

inline constexpr double kWorkForComparisons = 1.3;  // of the work limit, after which no models are compared
inline constexpr double kPartly = 0.5;  // largest remaining share of the misfit, for a useful addition
inline constexpr double kSwings = 0.8;  // the same, for a mass in springs or on another hinge

struct PendulumTrials;

class FitLedger {
 public:
  FitLedger(const FitSetting& setting, const DiagnosisOptions& options, int threads, const Trace& trace,
            const CancelToken* cancel);

  bool Cancelled() const { return cancel_ != nullptr && cancel_->cancelled(); }
  // Whether the work limit (times `limits`), the time limit or a cancellation forbids new fits.
  bool Late(double limits = 1.0) const;
  bool OutOfTime() const;
  double work() const { return work_; }
  double work_share() const { return work_ / options_.work_limit; }
  double WorkAfter(double share) const { return work_ + share * options_.work_limit; }
  // Guarantees what follows this share of the work limit, however much was used before.
  void Grant(double share) { forgiven_ = std::max(forgiven_, work_ - (1 - share) * options_.work_limit); }
  void AddWork(double work) { work_ += work; }
  void SetRound(int round) { round_ = round, made_.Forget(); }

  const LiftedOptions& lifted() const { return lifted_; }
  // With the step that a fit of the candidate took.
  LiftedOptions AsFitted(const Candidate& c) const { return diagnosis::AsFitted(lifted_, c.fit); }
  double noise_scale() const { return lifted_.noise_scale; }
  // All scores are brought to another noise scale.
  void SetNoiseScale(double scale);

  double PerRow(const Candidate& c) const {
    return c.fit.chi2 / std::max(1, c.fit.rows) / lifted_.noise_scale;
  }
  double Excess(const Candidate& c) const {  // χ² beyond noise
    return std::max(0.0, c.fit.chi2 / lifted_.noise_scale - c.fit.rows);
  }
  // Expected χ² of a true model: rows less the unknown starts of the windows.
  double Noise(const Candidate& c) const { return c.fit.rows - Starts(setting_.data.windows.size()); }
  // Unknowns of so many windows' starts.
  double Starts(size_t windows) const { return 2.0 * setting_.data.judged() * static_cast<double>(windows); }
  // The most log evidence that any addition could bring: half of χ² above what noise alone leaves.
  double AtStake(const Candidate& c) const { return 0.5 * (c.fit.chi2 / lifted_.noise_scale - Noise(c)); }
  // Whether χ² per row is consistent with the sensors' own noise, not the noise scale, which may hold misfit.
  bool MeetsSensors(const Candidate& c) const { return PerRow(c) * lifted_.noise_scale < kExplained; }
  // The same to within three standard deviations of χ².
  bool LeavesNothing(const Candidate& c) const {
    return PerRow(c) * lifted_.noise_scale < 1 + 3 * std::sqrt(2.0 / std::max(1, c.fit.rows));
  }
  std::map<std::string, Candidate>& tried() { return tried_; }
  // The best fit of these effects on all windows; null where there was none.
  const Candidate* Known(const std::vector<effects::EffectSpec>& specs, bool base) const;

  // Fits on all windows. `from`: a consistent model gives the start; of another one its base parameters, with
  // the recorded motion. `rival`: the fit ends early if it would not come near that score.
  Candidate Evaluate(const std::vector<effects::EffectSpec>& specs, bool base,
                     const Candidate* from = nullptr, int iterations = 6, const Candidate* rival = nullptr);
  // The best fit of these effects so far, else a first one.
  Candidate KnownOrFitted(const std::vector<effects::EffectSpec>& specs, bool base,
                          const Candidate* from = nullptr, int iterations = 6);
  // With free base parameters; ends early if it would not become consistent.
  Candidate Calibrated(const std::vector<effects::EffectSpec>& specs);
  // Fitted on with a step that is short enough for its values; its score stays, to compare with those of
  // models whose steps are not so short.
  Candidate WithExactValues(const Candidate& c);
  // A restart from nominal base parameters, over short pieces of the recordings.
  Candidate Anew(const Candidate& c);
  // Finds base parameters over short pieces of the recordings, which converge where whole windows do not.
  // Later fits with free base parameters start there.
  void FindPieces(const std::vector<effects::EffectSpec>& specs);
  // The model whose base parameters a fit near `c` starts from if `c` is not consistent. That is `c` if it
  // has effects that FindPieces was not given, else the model of the pieces. Null if base parameters are
  // fixed, or there is neither.
  const Candidate* NearestBase(const Candidate& c) const;

  // Adds each of `pool` to `from` in a trial fit (some windows, few iterations), and fits the `count` best
  // and all `promised` on all windows. `winner` becomes the best of these and itself.
  void TryBest(const Candidate& from, const std::vector<TrialSpecs>& pool,
               const std::vector<TrialSpecs>& promised, size_t count, Candidate* winner);
  // Whether `specs` in the place of `model`'s effects, in a trial fit, leave less than `share` of the excess
  // χ² that the model leaves there. True where either trial fails.
  bool MayLeaveLess(const Candidate& model, const std::vector<effects::EffectSpec>& specs, bool base,
                    double share);
  // Trial fits of `others`, each in the place of `winner`'s effects; those no worse are fitted on all
  // windows. Where one scores better the winner is fitted on, and then compared.
  void TryInPlace(const std::vector<TrialSpecs>& others, Candidate* winner);
  // Tries springs behind the rotors that `model` adds to `from`, and play where such a rotor leaves no
  // misfit. With free base parameters, where fits cost most, only if `model` halves the misfit.
  void TrySprings(const Candidate& from, Candidate* model);
  // The `count` of `starts` that, added to `from`, are nearest to the recordings.
  std::vector<TrialSpecs> Nearest(const Candidate& from, const std::vector<TrialSpecs>& starts, size_t count);

  // What a fit of a model near `from` starts at, as FitRequest::from.
  std::shared_ptr<const Candidate> Start(const Candidate* from, bool base) const;
  // A fit on all windows from there, not yet made.
  FitRequest WholeFit(const std::vector<effects::EffectSpec>& specs, bool base,
                      std::shared_ptr<const Candidate> from, int iterations = 6,
                      const Candidate* rival = nullptr) const;
  // Makes a fit that is not kept.
  Candidate Fitted(const FitRequest& request);

 private:
  bool Admissible(Candidate* c);
  void TakeBest(const std::vector<FitRequest>& requests, size_t least, Candidate* winner);
  FitRequest Trial(const Candidate& from, bool base, std::shared_ptr<const Candidate> start) const;
  // Trial fits that score no worse than `from` alone.
  struct TrialResults {
    FitRequest setting;  // of them all
    std::vector<RankedTrial> ranked;
    std::vector<RankedTrial> hidden;  // on whole windows with hidden states, where the others are on pieces
    std::set<std::string> refused;    // keys of what is inadmissible, which more windows do not change
  };
  TrialResults RunTrials(const Candidate& from, const std::vector<TrialSpecs>& pool);
  PendulumTrials TakePendulumTrials(const Candidate& from, TrialResults* trials) const;
  std::vector<FitRequest> WorthAFit(const Candidate& from, TrialResults trials,
                                    const std::vector<TrialSpecs>& promised, size_t count,
                                    const Candidate& winner) const;
  FitResult Made(const FitRequest& request);
  Candidate Fitted(const FitRequest& request, FitResult fit);
  Candidate Tried(const FitRequest& request, FitResult fit);
  double TellingPiece(FitRequest trial);

  const FitSetting& setting_;
  const DiagnosisOptions& options_;
  LocalFits local_;
  const Trace& trace_;
  const CancelToken* cancel_;
  LiftedOptions lifted_;
  int round_ = 0;
  double work_ = 0;                          // of all fits so far
  double forgiven_ = 0;                      // of it, that no longer counts against the limit
  std::shared_ptr<const Candidate> pieces_;  // base parameters from short pieces
  std::map<std::string, Candidate> tried_;
  RememberedFits made_;  // of this round
};

}  // namespace rg::diagnosis
