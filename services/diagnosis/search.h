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
#include "services/diagnosis/diagnosis.h"
#include "services/diagnosis/hypotheses.h"

namespace rg::diagnosis {

// A fitted set of effects.
struct Candidate {
  std::vector<effects::EffectSpec> specs;
  bool base = false;
  std::shared_ptr<const sim::Plant> plant;
  std::vector<sysid::FitParameter> parameters;
  FitResult fit;
  double score = 0;  // evidence with the structure's prior
  int round = 0;
};

struct SearchResult {
  Candidate best;
  Candidate nominal;     // no effects, base as given
  Candidate calibrated;  // no effects, base free
  std::vector<Candidate> tried;
  double null_gain = 0;
  double threshold = 0;  // log evidence that an addition must bring
  double noise_scale = 1;
  MissingForce missing;    // under the best model without effects
  MissingForce remaining;  // under the best model
};

SearchResult SearchEffects(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                           const DiagnosisOptions& options, int threads, const Clock& clock,
                           const ProgressFn& progress, const CancelToken* cancel);

// Nodes and smooth motion of the fit recordings of a set.
Result<FitData> PrepareData(const recordings::RecordingSet& set, const sim::Plant& nominal,
                            const DiagnosisOptions& options);

}  // namespace rg::diagnosis
