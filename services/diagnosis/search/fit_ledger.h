// The fits of one search: asks for them, scores them, keeps what was tried and what it cost.
#pragma once

#include <map>
#include <memory>
#include <optional>
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

inline constexpr double kHolds = 2.0;  // χ² per row below which a model's own states are trusted

class FitLedger {
 public:
  FitLedger(const FitSetting& setting, const DiagnosisOptions& options, int threads, const Trace& trace,
            const CancelToken* cancel);

  bool Cancelled() const { return cancel_ != nullptr && cancel_->cancelled(); }
  // A mass on a rod that most windows meet whole, and all over halves of them: what else is missing, or where
  // it swings far, throws a few off for longer, and the search is another's, over windows of half the length.
  // Null: none.
  const std::shared_ptr<const Candidate>& over_halves() const { return over_halves_; }
  // Whether nothing new is begun; `limits`: times the work limit.
  bool Late(double limits = 1.0) const;
  double work() const { return work_; }
  double work_share() const { return work_ / options_.work_limit; }
  void AddWork(double work) { work_ += work; }
  void SetRound(int round) { round_ = round, made_.Forget(); }

  const LiftedOptions& lifted() const { return lifted_; }
  double noise_scale() const { return lifted_.noise_scale; }
  // All scores are brought to another noise scale.
  void SetNoiseScale(double scale);

  double PerRow(const Candidate& c) const {
    return c.fit.chi2 / std::max(1, c.fit.rows) / lifted_.noise_scale;
  }
  double Excess(const Candidate& c) const {  // χ² beyond noise
    return std::max(0.0, c.fit.chi2 / lifted_.noise_scale - c.fit.rows);
  }
  std::map<std::string, Candidate>& tried() { return tried_; }
  // The best fit of these effects on all windows; null where there was none.
  const Candidate* Known(const std::vector<effects::EffectSpec>& specs, bool base) const;

  // On all windows. `from`: where to start, where it holds; else at its base parameters or at the recorded
  // motion. `rival`: what it must come near to, or it ends early.
  Candidate Evaluate(const std::vector<effects::EffectSpec>& specs, bool base,
                     const Candidate* from = nullptr, int iterations = 6, const Candidate* rival = nullptr);
  // Free base parameters, no longer than they may come to hold.
  Candidate Calibrated(const std::vector<effects::EffectSpec>& specs);
  // Another try from nominal base parameters, over pieces.
  Candidate Anew(const Candidate& c);
  // Base parameters far from the URDF's, or beside missing effects, are found over short pieces of the
  // record, from where fits in their world then start.
  void FindPieces(const std::vector<effects::EffectSpec>& specs);
  const Candidate* pieces() const { return pieces_.get(); }

  // Of `pool`, each beside `from`'s effects, the `count` best of trials on some windows with few iterations,
  // and `promised` without a trial, fitted on all; the best of them and of `winner`.
  void TryBest(const Candidate& from, const std::vector<TrialSpecs>& pool,
               const std::vector<TrialSpecs>& promised, bool base, size_t count, Candidate* winner);
  // Whether `specs` in the place of `account`'s effects, fitted to some windows, leave less than `share` of what
  // the account leaves there beyond the sensors' own noise. Where either fails it may be so.
  bool MayLeaveLess(const Candidate& account, const std::vector<effects::EffectSpec>& specs, bool base,
                    double share);
  // Of `others`, each in the place of `winner`'s effects, what trials do not find worse, fitted on all.
  void TryInPlace(const std::vector<TrialSpecs>& others, Candidate* winner);
  // Springs behind the rotors that `account` adds to `from`, before free base parameters make up for them.
  void TrySprings(const Candidate& from, Candidate* account);
  // A rod in the place of springs for a mass, as trials found it on the tool and on the last link, the nearer
  // first: the rod that leaves least of trials with other lengths, hinges and places, alone and beside what
  // the best of the other trials have. Returned where it meets most windows and not all.
  std::optional<Candidate> TryRod(const Candidate& from,
                                  const std::vector<std::shared_ptr<const Candidate>>& springs,
                                  const std::vector<std::shared_ptr<const Candidate>>& beside,
                                  Candidate* account);
  // The `count` of `starts` that are nearest to the record beside `from`'s effects.
  std::vector<TrialSpecs> Nearest(const Candidate& from, bool base, const std::vector<TrialSpecs>& starts,
                                  size_t count);

 private:
  std::shared_ptr<const Candidate> Start(const Candidate* from, bool base) const;
  std::shared_ptr<const Candidate> Nearby(const Candidate* from, bool base) const;
  FitRequest WholeFit(const std::vector<effects::EffectSpec>& specs, bool base,
                      std::shared_ptr<const Candidate> from, int iterations = 6,
                      const Candidate* rival = nullptr) const;
  bool Stands(Candidate* c);
  void TakeBest(const std::vector<FitRequest>& requests, size_t least, Candidate* winner);
  FitRequest Trial(const Candidate& from, bool base, std::shared_ptr<const Candidate> start) const;
  // Of a pool beside `from`'s effects, what is no worse than these alone.
  struct TrialResults {
    FitRequest setting;  // of them all
    std::vector<RankedTrial> ranked;
    std::vector<RankedTrial> hidden;  // on whole windows with hidden states, where the others are on pieces
    std::set<std::string> refused;    // as no effect of its name, which more windows do not change
  };
  TrialResults RunTrials(const Candidate& from, const std::vector<TrialSpecs>& pool, bool base);
  FitResult Made(const FitRequest& request);
  Candidate Fitted(const FitRequest& request, FitResult fit);
  Candidate Tried(const FitRequest& request, FitResult fit);
  double TellingPiece(FitRequest trial);
  double PerFreeRow(const FitData& data, const Candidate& c) const;
  void TryHalves(const Candidate& rod);

  const FitSetting& setting_;
  const DiagnosisOptions& options_;
  LocalFits local_;
  const Trace& trace_;
  const CancelToken* cancel_;
  LiftedOptions lifted_;
  int round_ = 0;
  double work_ = 0;                          // of all fits so far
  std::shared_ptr<const Candidate> pieces_;  // base parameters from pieces, where whole windows are not met
  std::shared_ptr<const Candidate> over_halves_;
  std::map<std::string, Candidate> tried_;
  RememberedFits made_;  // of this round
};

}  // namespace rg::diagnosis
