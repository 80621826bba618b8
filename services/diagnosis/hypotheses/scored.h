// What a screen says of a hypothesis (screening/screening.h).
#pragma once

#include <string>
#include <vector>

namespace rg::diagnosis {

struct Scored {
  std::string effect;
  std::vector<int> joints;  // source, target for joint_coupling; empty: the robot
  double gain = 0;          // of log evidence, the search over shapes paid for
  double chi2 = 0;          // what χ² falls by
  double step_rule = 0;     // nats that the effect would gain from another step rule alone
  double shape = 0, shape_end = 0;
  std::vector<double> coefficients;  // per column of the effect, SI, joint after joint
};

// Several at once: an effect on a set of joints, or two effects, each blind to what the other leaves.
struct Combination {
  std::vector<Scored> parts;  // coefficients of the joint solution
  double gain = 0;            // of log evidence together, structure paid for
};

}  // namespace rg::diagnosis
