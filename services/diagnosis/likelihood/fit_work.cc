// What fits and screens cost (lifted_fit.h).
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

namespace {

// Seconds of one thread, fitted to 1,176 fits of seven sets (two to seven joints, 50 to 500 Hz; of the whole
// set's fits right within a third).
constexpr double kPerSimulatedStep = 2.4e-7;   // and joint
constexpr double kPerLinearisedStep = 1.9e-8;  // and pair of joints
constexpr double kPerNode = 1.1e-6, kPerNodeColumn = 2.3e-7;
constexpr double kPerRowColumn = 2.2e-9;      // and state
constexpr double kPerScreenedPair = 1.5e-10;  // row and pair of columns

double StepsOf(const FitData& data, const LiftedOptions& options) { return data.Seconds() / options.step_s; }

double NodesOf(const FitData& data) {
  double count = 0;
  for (const NodeWindow& w : data.windows) count += static_cast<double>(w.t.size());
  return count;
}

}  // namespace

double SimulationWork(const FitData& data, const LiftedOptions& options) {
  return kPerSimulatedStep * StepsOf(data, options) * data.n;
}

double LinearisationWork(const FitData& data, const LiftedOptions& options, long states, long columns) {
  const auto C = static_cast<double>(columns);
  return kPerLinearisedStep * StepsOf(data, options) * data.n * data.n +
         NodesOf(data) * (kPerNode + kPerNodeColumn * C) +
         kPerRowColumn * data.Rows() * static_cast<double>(states) * C;
}

double ScreenWork(const FitData& data, const LiftedOptions& options, long states, long columns, int draws) {
  const auto D = static_cast<double>(columns);
  return LinearisationWork(data, options, states, states + columns) +
         kPerScreenedPair * data.Rows() * D * (D + draws);
}

}  // namespace rg::diagnosis
