// A plant with a constant torque of size zero on each joint, whose sensitivities are the columns B.
#pragma once

#include <vector>

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

struct Probe {
  sim::Plant plant;
  VectorXd values;
  std::vector<int> torque;  // parameter index per joint, −1: none
};

// Without the torque on joints that can take no further effect of either kind.
Probe MakeProbe(const FitModel& model, bool with_torque);

}  // namespace rg::diagnosis
