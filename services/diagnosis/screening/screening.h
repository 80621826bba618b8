// Scores every effect on every set of joints with one linearisation: what the evidence would gain if the
// effect were added to the model, everything that base parameters, effects already in the model and
// initial states can produce projected out of signature and residual first.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/hypotheses/scored.h"
#include "services/diagnosis/likelihood/features.h"

namespace rg::diagnosis {

// A column of the screen's parameter block that is itself a hypothesis (encoder_offset, sensor_delay,
// gravity, the last link's inertial parameters), or belongs to the model (effect empty).
struct ParameterColumn {
  std::string effect;
  std::string role;
  int joint = -1;
  double prior_stddev = 1;
  double away = 0;         // (θ − θ0)/σ where it was linearised
  bool base = false;       // an inertial parameter: projected out only where base parameters are free
  bool last_link = false;  // one of the last link: where base parameters are not free, a payload's column
};

struct ScreenResult {
  std::vector<Scored> hypotheses;  // best first, one per effect and set of joints
  std::vector<Combination> sets;   // of one effect on several joints, best first
  std::vector<Combination> pairs;  // of two effects, best first
  double null_gain = 0;            // exceeded by the best of all hypotheses in 2 % of recordings of the model
};

// Of what the joints of `plant` take.
ScreenResult ScoreHypotheses(const Screen& screen, const std::vector<ParameterColumn>& columns,
                             const FeatureSet& features, const MotionScales& scales, bool base_free,
                             const sim::Plant& plant);

}  // namespace rg::diagnosis
