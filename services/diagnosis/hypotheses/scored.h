// Result of the score test of one hypothesis (screening/screening.h).
#pragma once

#include <string>
#include <vector>

namespace rg::diagnosis {

struct Scored {
  std::string effect;
  std::vector<int> joints;  // source, target for joint_coupling; empty: the robot
  double gain = 0;          // nats of log evidence, less log(number of shapes tried)
  double chi2 = 0;          // reduction of χ²
  double step_rule = 0;     // nats that the effect would gain if another step rule had made the recordings
  double shape = 0, shape_end = 0;
  std::vector<double> coefficients;  // per column of the effect, SI, joint after joint
};

// An effect on several joints, or two effects, solved jointly.
struct Combination {
  std::vector<Scored> parts;  // coefficients of the joint solution
  double gain = 0;            // nats of log evidence together, structure prior included
};

}  // namespace rg::diagnosis
