// The generalised force that a model lacks, piecewise constant in time.
#pragma once

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// Per joint one value on each segment of about `segment_s`, with prior stddev `prior` (n), and its posterior
// stddev. One entry per window: n × segments.
struct MissingForce {
  std::vector<MatrixXd> force, stddev;
  std::vector<std::vector<double>> t;  // middles
  double chi2 = 0;                     // with the forces
  double unknowns = 0;                 // effective number of unknowns, window starts included
  int rows = 0;
  int lost = 0;  // windows whose simulation failed
  // n × n, nats: log evidence of such a force on joint j alone (diagonal) or on two joints. Empty for forces
  // from the balance of torques.
  MatrixXd evidence;
};
MissingForce EstimateMissingForce(const FitData& data, const FitModel& model, const NodeStates& states,
                                  const VectorXd& prior, double segment_s, const LiftedOptions& options);

}  // namespace rg::diagnosis
