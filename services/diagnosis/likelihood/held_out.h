// Hold-out predictive density: the log density of recordings that no fit has seen, given the fitted model.
//
//   log p(held out | fitted) = −½ χ²/s² + ½ bᵀ(Λ + H)⁻¹b − ½ log det(1 + Λ⁻¹H)
//
// χ²: of windows simulated with the fitted parameters, each restarted at the measured state, which is free
// within the sensors' noise. Hidden states (a motor, a swinging mass) continue from the window before: if
// each window could choose them, they would predict nothing. Λ: precision of the parameters from fit and
// priors. H, b: information and gradient of the held-out rows. A parameter that the fit left open thus costs
// no more than its own uncertainty. The middle term is simulated, not taken from the linear model.
// Terms that all models share (normalisation, restarts) are left out.
#pragma once

#include <vector>

#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

struct HeldOut {
  double log_density = 0;       // nats
  std::vector<double> windows;  // −½ χ²/s² of each window
  double deficit = 0;           // nats below the expectation under noise alone
  double deficit_stddev = 0;    // its standard deviation under noise alone
  double freedom = 0;           // degrees of freedom: rows less restarted states
  // Whether a pendulum payload, its start free in each window, fits most windows and its states are
  // continuous from one to the next (jumps.h): a free swing cannot be predicted over many windows.
  bool swing_continues = false;
  double work = 0;
};

// `options`: as in the fit.
HeldOut PredictHeldOut(const FitData& held_out, const Candidate& fitted, const LiftedOptions& options);

}  // namespace rg::diagnosis
