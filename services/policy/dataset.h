// Training points: what a policy sees and what it should answer.
//
// For the policy of the paper a point's input is (q, q̇, q_goal) and its output the torques. Points of
// one trajectory share an id, so that a validation split never tears one apart.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::policy {

struct Dataset {
  Eigen::MatrixXf inputs;            // input size × N
  Eigen::MatrixXf outputs;           // output size × N
  std::vector<uint64_t> trajectory;  // N, any numbering

  int size() const { return static_cast<int>(inputs.cols()); }
  // Adds one trajectory of points, states over columns: q, v, effort n × K, goal n.
  void AddTrajectory(uint64_t id, const Eigen::MatrixXd& q, const Eigen::MatrixXd& v,
                     const Eigen::VectorXd& goal, const Eigen::MatrixXd& effort);
};

// Sizes that fit together, and every value finite; the error names point and row.
Status CheckDataset(const Dataset& dataset);

// `more` behind `dataset`; the trajectory ids of `more` are kept. Error: sizes that do not fit.
Status Append(Dataset* dataset, const Dataset& more);

}  // namespace rg::policy
