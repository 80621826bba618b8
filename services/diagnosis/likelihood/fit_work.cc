// What fits and screens cost (lifted_fit.h).
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

namespace {

// Seconds of one thread, fitted to 1,176 fits of seven sets (two to seven joints, 50 to 500 Hz); those of
// rows, columns and pairs lowered since to what they take with the kernels of row_products.h (two sets of
// seven joints).
constexpr double kPerSimulatedStep = 2.4e-7;   // and pair of states, a position and its rate
constexpr double kPerLinearisedStep = 1.9e-8;  // and pair of these
constexpr double kPerNode = 1.1e-6, kPerNodeColumn = 2.3e-7;
constexpr double kPerRowColumn = 1.2e-9;    // and state
constexpr double kPerScreenedPair = 8e-11;  // row and pair of columns

double StepsOf(const FitData& data, const LiftedOptions& options) { return data.Seconds() / options.step_s; }

double NodesOf(const FitData& data) {
  double count = 0;
  for (const NodeWindow& w : data.windows) count += static_cast<double>(w.t.size());
  return count;
}

}  // namespace

double SimulationWork(const FitData& data, const LiftedOptions& options, long states) {
  return kPerSimulatedStep * StepsOf(data, options) * 0.5 * static_cast<double>(states);
}

double LinearisationWork(const FitData& data, const LiftedOptions& options, long states, long columns) {
  const auto C = static_cast<double>(columns), moving = 0.5 * static_cast<double>(states);
  return kPerLinearisedStep * StepsOf(data, options) * moving * moving +
         NodesOf(data) * (kPerNode + kPerNodeColumn * C) +
         kPerRowColumn * data.Rows() * static_cast<double>(states) * C;
}

double ScreenWork(const FitData& data, const LiftedOptions& options, long states, long columns, int draws) {
  const auto D = static_cast<double>(columns);
  return LinearisationWork(data, options, states, states + columns) +
         kPerScreenedPair * data.Rows() * D * (D + draws);
}

}  // namespace rg::diagnosis
