// What a simulation returns: measured outputs and the state at the output times, on request with
// their forward sensitivities, and how it ended.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace rg::sim {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// A numerical outcome is data. Nothing is reset or clamped: the first bad step ends the simulation.
struct Outcome {
  enum class Kind {
    kOk,
    kNonFinite,              // position, velocity or force became NaN or infinite
    kMassMatrixNotPositive,  // M(q) is not positive definite for these parameters
    kNotConverged,           // the implicit step found no solution, even in 64 parts
  };
  Kind kind = Kind::kOk;
  long step = -1;     // number of the step that failed, from the start of the call
  double time = 0;    // s, at the step's begin
  std::string joint;  // the first joint concerned

  bool ok() const { return kind == Kind::kOk; }
  // "not finite at step 812 (t = 0.812 s), joint_6"
  std::string ToString() const;
};

// Columns of every sensitivity: first the initial state x0 = (q, v, z) if asked for (nx columns),
// then `parameters` in their order.
struct SensitivityRequest {
  bool initial_state = false;
  std::vector<int> parameters;  // indices into the plant's ParameterTable

  bool any() const { return initial_state || !parameters.empty(); }
};

// K output times, n joints, nx states, c = requested columns.
struct Trajectory {
  Outcome outcome;
  std::vector<double> times;  // K, s
  Eigen::MatrixXd position;   // n × K, measured (after sensor effects)
  Eigen::MatrixXd velocity;   // n × K, measured
  Eigen::MatrixXd state;      // nx × K, true (q, v, z)
  RowMatrix dposition;        // (K·n) × c, row k·n + i: d position(i, k)
  RowMatrix dvelocity;        // (K·n) × c
  RowMatrix dfinal_state;     // nx × c, of the true state at the last output time
  // When the outcome is not ok: outputs from this index on were not reached (values are NaN,
  // sensitivities zero).
  int reached = 0;
};

}  // namespace rg::sim
