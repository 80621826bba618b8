// The generalised force that a model lacks, as a staircase in time per joint.
#pragma once

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// The missing force as a staircase (`segment_s` wide) per joint, with its stddev; weak prior `prior` (n) on
// each stair. One entry per window: n × stairs.
struct MissingForce {
  std::vector<Eigen::MatrixXd> force, stddev;
  std::vector<std::vector<double>> t;  // middles
  double chi2 = 0;                     // with the forces
  double unknowns = 0;                 // effective number of them, e_0 included
  int rows = 0;
  // n × n, nats: log evidence of such stairs on joint j alone (diagonal) or on two joints. Of forces that
  // were not estimated from motion: empty.
  Eigen::MatrixXd evidence;
};
MissingForce EstimateMissingForce(const FitData& data, const FitModel& model, const NodeStates& states,
                                  const Eigen::VectorXd& prior, double segment_s,
                                  const LiftedOptions& options);

}  // namespace rg::diagnosis
