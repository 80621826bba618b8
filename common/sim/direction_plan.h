// From requested sensitivity columns to the directions that the kernels propagate, and back.
//
// The step depends on inertial parameters only through ten numbers per body, and how these depend on a
// parameter is constant over a rollout. So at most ten directions per body are propagated, however many
// links and parameters share it (45 instead of 71 for the paper's set on the Mico²), and combined into
// the requested columns where outputs are written. Private to this folder.
#pragma once

#include <memory>
#include <vector>

#include "common/integrators/step_program.h"
#include "common/sim/parameter_values.h"
#include "common/sim/sensitivity_layout.h"
#include "common/sim/trajectory.h"

namespace rg::sim::internal {

class DirectionPlan {
 public:
  // Which columns come before the parameters' directions.
  struct Leading {
    bool initial_state = false;
    bool commands = false;  // one per joint: a held command (Advance)
  };

  // Lays out columns and allocates; `parameters` are table indices.
  DirectionPlan(const PlantData& plant, Leading leading, std::vector<int> parameters);
  // Takes over values; no allocation.
  void Update(const ParameterValues& values);

  const std::vector<int>& parameters() const { return parameters_; }
  bool initial_state() const { return leading_.initial_state; }
  const integrators::Directions& directions() const { return directions_; }
  // Command columns, in the order of joints' commands (Advance) or of delays (Simulate).
  const std::vector<integrators::Directions::Command>& commands() const { return commands_; }

  // Zero, then identity for the initial state, in one lane.
  void Start(const SensitivityLayout& layout, int lane, integrators::Sensitivity* s) const;

  int num_directions() const { return directions_.columns; }
  int num_columns() const { return static_cast<int>(leading_columns_ + parameters_.size()); }
  // out[0 … num_columns) = a row of directions, combined.
  void Combine(const double* row, double* out) const;
  // Column of the output that belongs to a parameter, or −1.
  int OutputColumn(int parameter) const;

 private:
  struct Term {
    int direction;
    double weight;
  };
  void FillBody(const ParameterValues& values, int body);

  const PlantData& plant_;
  Leading leading_;
  std::vector<int> parameters_;
  int leading_columns_ = 0;
  integrators::Directions directions_{};
  std::vector<integrators::Directions::Local> locals_;
  std::vector<integrators::Directions::Command> commands_;
  std::vector<integrators::Directions::Point> points_;
  std::vector<std::vector<int>> body_members_;  // per body: positions in parameters_
  std::vector<int> gravity_members_;
  std::vector<std::vector<Term>> terms_;  // per parameter
  std::vector<int> output_column_;        // per table row
};

}  // namespace rg::sim::internal
