// Score tests of every effect on every set of joints from one linearisation: the gain of log evidence if the
// effect were added to the model. Nuisance parameters (window starts, effects of the model, base parameters
// where free) are projected out of signatures and residual first.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/features.h"
#include "services/diagnosis/likelihood/screen.h"

namespace rg::diagnosis {

// A column of the screen's parameter block: a hypothesis (encoder_offset, sensor_delay, gravity, the last
// link's inertial parameters), or a parameter of the model (effect empty).
struct ParameterColumn {
  std::string effect;
  std::string role;
  int joint = -1;
  double prior_stddev = 1;
  double away = 0;         // (θ − θ0)/σ at the linearisation point
  bool base = false;       // an inertial parameter: a nuisance only where base parameters are free
  bool last_link = false;  // one of the last link: where base parameters are fixed, a payload's column
};

// An effect on several joints, or two effects, solved jointly.
struct Combination {
  std::vector<Scored> parts;  // coefficients of the joint solution
  double gain = 0;            // nats of log evidence together, structure prior included
};

struct ScreenResult {
  std::vector<Scored> hypotheses;  // best first, one per effect, set of joints and options
  std::vector<Combination> sets;   // of one effect on several joints, best first
  std::vector<Combination> pairs;  // of two effects, best first
  double null_gain = 0;            // quantile kNullQuantile of the null distribution of the best gain, nats
  // Of the model itself, its nuisance parameters as they fit best: χ² with their prior cost, far residuals
  // not softened, and log evidence without structure prior.
  double chi2 = 0, evidence = 0;
  double unknowns = 0;  // of a force that was integrated out: rows that it fits whatever they are
  int rows = 0;         // that these are of
  double work = 0;      // what it cost (lifted_fit.h)
};

// Tests the effects that the joints of `plant` take.
ScreenResult ScoreHypotheses(const Screen& screen, const std::vector<ParameterColumn>& columns,
                             const FeatureSet& features, bool base_free, const sim::Plant& plant);

}  // namespace rg::diagnosis
