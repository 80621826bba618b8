// The search for missing effects: fits of hypotheses in the simulator, compared by log evidence.
//
//   E = −½ χ²/s² − ½ Σ((θ−θ0)/σ)² − ½ log det(1 + σHσ) + log prior(structure)
//
// s²: residual variance that remains when any force is allowed (1 when the sensors are as noisy as they
// say). Two worlds are compared throughout: base parameters exactly those of the URDF, or free with priors
// around it. What the data cannot pay for in either is not claimed.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "services/diagnosis/candidate.h"
#include "services/diagnosis/diagnosis.h"
#include "services/diagnosis/hypotheses.h"
#include "services/diagnosis/missing_force.h"

namespace rg::diagnosis {

// What the search over a measured effort (balance_search.h) says beside its candidates.
struct MeasuredEffort {
  bool active = false;
  double explained = 0;          // share of the calibrated model's misfit, on parts left out
  Eigen::VectorXd structured;    // n: share of the rest that a free force over position and velocity takes
  Eigen::VectorXd effort_share;  // n: what remains over the effort's variance
  Eigen::VectorXd effort_noise;  // n: RMS of what remains, N·m or N
  Eigen::VectorXd effort_correlation_s;  // n: integrated autocorrelation of that
  std::vector<int> early;                // joints whose effort lags their motion
  std::map<std::string, double> gain;    // nats on parts left out, per kind of effect
};

struct SearchResult {
  Candidate best;
  Candidate nominal;     // no effects, base as given
  Candidate calibrated;  // no effects, base free
  std::vector<Candidate> tried;
  double null_gain = 0;
  double threshold = 0;  // log evidence that an addition must bring
  double beside = 0;     // log evidence that free base parameters beside the best's effects must bring
  double noise_scale = 1;
  double work = 0;  // of all fits
  // Of the recordings kept aside (held_out) the one that shows what the fitted ones, which an account meets,
  // do not: a limit that only it reaches, a place where only it has been. −1: none.
  int unseen_in = -1;
  // What needs windows of half the length to be told (FitLedger::over_halves): the search ended with it.
  // Null: nothing does.
  std::shared_ptr<const Candidate> over_halves;
  double own_chi2 = 0;     // of the best model, of recordings that it made itself (own_chi2.h)
  MissingForce missing;    // under the best model without effects
  MissingForce remaining;  // under the best model
  MeasuredEffort measured;
};

// `nominal`: the model to start from (given_model.h). The effects that it has are part of every hypothesis
// until they are pruned or make place for others.
SearchResult SearchEffects(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                           const DiagnosisOptions& options, int threads, const Clock& clock,
                           const ProgressFn& progress, const CancelToken* cancel);

// Nodes and smooth motion of the fit recordings of a set. Points into the set.
Result<FitData> PrepareData(const recordings::RecordingSet& set, const sim::Plant& nominal,
                            const DiagnosisOptions& options);
// The same of the recordings kept aside, for FitData::held_out; null where there are none that can be
// predicted.
std::shared_ptr<const FitData> PrepareHeldOut(const recordings::RecordingSet& set, const FitData& fitted,
                                              const sim::Plant& nominal, const DiagnosisOptions& options);

}  // namespace rg::diagnosis
