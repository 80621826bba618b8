// How the cost of a Jacobian grows with the recording's length and with the number of parameters.
#pragma once

#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"

namespace rg::model {
class RobotModel;
}

namespace rg::lab {

struct ScalingPoint {
  double x = 0;   // seconds of motion, or parameters
  double ms = 0;  // median CPU time of one simulation at 1 ms steps with its Jacobian, one core, one lane
};

// The least-squares line through points, and the share of their variation that it explains.
struct ScalingLine {
  double at_zero = 0, slope = 0, r_squared = 1;
};
ScalingLine LineThrough(const std::vector<ScalingPoint>& points);

struct Scaling {
  std::vector<ScalingPoint> by_length;      // the paper's parameters
  std::vector<ScalingPoint> by_parameters;  // growing subsets of the paper's, then the whole table
  int paper_parameters = 0;
  double seconds = 8;  // of motion, by_parameters (quick: 1)
};

// Points are measured in turns, so that all see the same machine. Error: the motion breaks down; a cancel.
Result<Scaling> MeasureScaling(std::shared_ptr<const model::RobotModel> robot, bool quick, uint64_t seed,
                               const ProgressFn& progress = {}, const CancelToken* cancel = nullptr);

nlohmann::json ScalingJson(const Scaling& scaling);
// Two panels, points and lines.
std::string ScalingSvg(const Scaling& scaling);

}  // namespace rg::lab
