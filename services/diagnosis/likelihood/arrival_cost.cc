#include "services/diagnosis/likelihood/arrival_cost.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace rg::diagnosis {

namespace {

constexpr double kLoose = 10.0;        // prior stddev over RMS
constexpr double kLeastMotion = 1e-6;  // least prior stddev: rad, m, or per second

}  // namespace

std::vector<ArrivalCost> ArrivalCosts(const sim::Plant& plant, const NodeStates& carried) {
  const long nx = plant.num_states(), first = 2L * plant.num_joints();
  VectorXd precision = VectorXd::Zero(nx);
  for (long i = first; i < nx; ++i) {
    const std::string& name = plant.internal_state_names()[static_cast<size_t>(i - first)];
    if (name.rfind("position.", 0) != 0 && name.rfind("velocity.", 0) != 0) continue;
    double squares = 0, count = 0;
    for (const MatrixXd& states : carried) {
      squares += states.row(i).squaredNorm();
      count += static_cast<double>(states.cols());
    }
    const double stddev = std::max(kLeastMotion, kLoose * std::sqrt(squares / std::max(1.0, count)));
    if (std::isfinite(stddev)) precision[i] = 1.0 / (stddev * stddev);
  }
  std::vector<ArrivalCost> out;
  for (const MatrixXd& states : carried) out.push_back({states.col(0), precision});
  return out;
}

}  // namespace rg::diagnosis
