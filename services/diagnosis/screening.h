// Scores every effect on every set of joints with one linearisation: what the evidence would gain if the
// effect were added to the model, everything that base parameters, effects already in the model and
// initial states can produce projected out of signature and residual first.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/features.h"

namespace rg::diagnosis {

// A column of the screen's parameter block that is itself a hypothesis (encoder_offset, sensor_delay,
// gravity), or belongs to the model (effect empty).
struct ParameterColumn {
  std::string effect;
  std::string role;
  int joint = -1;
  double prior_stddev = 1;
  double away = 0;    // (θ − θ0)/σ where it was linearised
  bool base = false;  // an inertial parameter: projected out only where base parameters are free
};

struct Scored {
  std::string effect;
  std::vector<int> joints;  // source, target for joint_coupling; empty: the robot
  double gain = 0;          // of log evidence, the search over shapes paid for
  double chi2 = 0;          // what χ² falls by
  double step_rule = 0;     // nats that the effect would gain from another step rule alone
  double shape = 0, shape_end = 0;
  std::vector<double> coefficients;  // per column of the effect, SI, joint after joint
};

struct ScreenResult {
  std::vector<Scored> hypotheses;  // best first, one per effect and set of joints
  double null_gain = 0;            // exceeded by the best of all hypotheses in 2 % of recordings of the model
};

ScreenResult ScoreHypotheses(const Screen& screen, const std::vector<ParameterColumn>& columns,
                             const FeatureSet& features, const MotionScales& scales, bool base_free,
                             int joints);

}  // namespace rg::diagnosis
