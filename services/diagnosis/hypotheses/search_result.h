// The result of a search over hypotheses, in the simulator (search/) or in the balance of torques (balance/).
#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/missing_force.h"

namespace rg::diagnosis {

// Further results of the search over a measured effort (balance_search.h).
struct MeasuredEffort {
  bool active = false;
  double explained = 0;           // share of the calibrated model's misfit, cross-validated
  VectorXd structured;            // n: share of the rest that a free force over position and velocity takes
  VectorXd effort_share;          // n: residual over the effort's variance
  VectorXd effort_noise;          // n: RMS of the residual, N·m or N
  VectorXd effort_correlation_s;  // n: integrated autocorrelation of that
  std::vector<int> early;         // joints whose effort lags their motion
  std::map<std::string, double> gain;  // nats, cross-validated, per kind of effect
};

struct SearchResult {
  Candidate best;
  Candidate nominal;     // no effects, base as given
  Candidate calibrated;  // no effects, base free
  std::vector<Candidate> tried;
  double null_gain = 0;
  double threshold = 0;  // log evidence that an addition to the calibrated model must bring
  double beside = 0;  // log evidence that free base parameters must bring in addition to the best's effects
  double noise_scale = 1;
  double work = 0;           // of all fits
  bool out_of_time = false;  // the time limit ended it before all was compared
  // Index among the held-out recordings of one that the model does not predict though it fits all others: it
  // alone excites something (a limit, a part of the workspace). −1: none.
  int excited_by = -1;
  // Whether the best model has a pendulum payload that swings continuously over held-out recordings. That is
  // its evidence: no sensor reads its state at a restart, so it need not predict better.
  bool swings_on = false;
  // Whether the search ended with an unnamed force on one joint, and effects that are significant whatever
  // that force is.
  bool beside_any_force = false;
  double own_chi2 = 0;     // expected χ² of the best model if it were true (own_chi2.h)
  MissingForce missing;    // under the best model without effects
  MissingForce remaining;  // under the best model
  MeasuredEffort measured;
};

}  // namespace rg::diagnosis
