// How well a fitted model predicts recordings that no fit has seen: their log density, so that accounts can
// be compared in nats where none of them could adapt itself.
//
//   log p(held out | fitted) = −½ χ²/s² + ½ bᵀ(Λ + H)⁻¹b − ½ log det(1 + Λ⁻¹H)
//
// χ²: of the windows simulated with the fitted parameters, each restarted at the state that is measured
// there, within the sensors' noise; hidden states (a motor, a swinging mass) as the window before, followed
// from a start of its own, leaves them, for what may be chosen anew in each window predicts nothing. Λ: what
// the fit and the priors know of the parameters; H, b: information and gradient that the held-out rows hold:
// a parameter that the fit left open costs no more than its own uncertainty (the middle term is simulated,
// not trusted). What all models share (the rows' own density, the restarts') is left out.
#pragma once

#include <vector>

#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

struct HeldOut {
  double log_density = 0;       // nats
  std::vector<double> windows;  // −½ χ²/s² of each window
  double short_of_noise = 0;    // nats that a perfect model would have more, as noise has it on average
  double scatter = 0;           // stddev of that under noise
  double free = 0;              // rows less what the restarts take
  // Whether a mass on a rod, its start free in each window, meets most of them and goes on from one to the
  // next (jumps.h): what swings freely is not predicted for long by carrying on what is known of it.
  bool swings_on = false;
  double work = 0;
};

// `options`: as in the fit.
HeldOut Predicted(const FitData& held_out, const Candidate& fitted, const LiftedOptions& options);

// Whether `a` predicts more windows better than `b` than chance would in 1 % of sets (sign test): a few
// windows that run away decide nothing alone.
bool PredictsMore(const HeldOut& a, const HeldOut& b);

}  // namespace rg::diagnosis
