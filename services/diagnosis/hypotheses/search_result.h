// What a search over hypotheses comes to, in the simulator (search/) or in the balance of torques (balance/).
#pragma once

#include <Eigen/Core>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/missing_force.h"

namespace rg::diagnosis {

// What the search over a measured effort (balance_search.h) says beside its candidates.
struct MeasuredEffort {
  bool active = false;
  double explained = 0;          // share of the calibrated model's misfit, on parts left out
  Eigen::VectorXd structured;    // n: share of the rest that a free force over position and velocity takes
  Eigen::VectorXd effort_share;  // n: what remains over the effort's variance
  Eigen::VectorXd effort_noise;  // n: RMS of what remains, N·m or N
  Eigen::VectorXd effort_correlation_s;  // n: integrated autocorrelation of that
  std::vector<int> early;                // joints whose effort lags their motion
  std::map<std::string, double> gain;    // nats on parts left out, per kind of effect
};

struct SearchResult {
  Candidate best;
  Candidate nominal;     // no effects, base as given
  Candidate calibrated;  // no effects, base free
  std::vector<Candidate> tried;
  double null_gain = 0;
  double threshold = 0;  // log evidence that an addition must bring
  double beside = 0;     // log evidence that free base parameters beside the best's effects must bring
  double noise_scale = 1;
  double work = 0;  // of all fits
  // Of the recordings kept aside (held_out) the one that shows what the fitted ones, which an account meets,
  // do not: a limit that only it reaches, a place where only it has been. −1: none.
  int unseen_in = -1;
  // What needs windows of half the length to be told (FitLedger::over_halves): the search ended with it.
  // Null: nothing does.
  std::shared_ptr<const Candidate> over_halves;
  double own_chi2 = 0;     // of the best model, of recordings that it made itself (own_chi2.h)
  MissingForce missing;    // under the best model without effects
  MissingForce remaining;  // under the best model
  MeasuredEffort measured;
};

}  // namespace rg::diagnosis
