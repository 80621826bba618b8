// What it says of a moving mass that it begins anew in each window. One that may be anywhere and at any speed
// where a window begins is a force of each window's own, and follows a limit, a contact or friction as well
// as a mass: by the law it goes on from where the window before leaves it. Each of two windows that meet
// knows the state between them to some covariance (P of the one's end, P' of the other's start), and a step d
// from one to the other adds to χ²
//
//   dᵀ (P + P')⁻¹ d
//
// which is what both together would leave more than each alone, to the first order and with the parameters as
// they are. Of a true law that is about one for each state that the windows show, more where only many
// windows together know its frequency, and nothing for those that they do not show. What else is hidden (a
// motor, a bristle, a mount) is not charged.
//
// A mass in springs pays that. One on a rod, which swings through all angles, may have been followed to the
// wrong turn in some windows, which are then not met and whose steps are any size: it goes on where most
// steps between windows that are met are such as noise makes, or take less than a tenth of what it would be
// off by if it hung still, as those of a law that is not quite its own. One that begins anywhere in each
// window steps as far as it swings.
#pragma once

#include <optional>
#include <vector>

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// `fit` of `plant` to all windows of `data` with that in its χ², in each window's that goes on from another,
// and in its evidence. `options`: as in the fit.
FitResult WithJumps(const FitData& data, const sim::Plant& plant, FitResult fit,
                    const LiftedOptions& options);

// Whether motors move behind play.
bool HasPlay(const std::vector<EffectSpec>& specs);

// The same of motors behind play, each against its link, in what is restarted on held-out recordings: from
// where the window before left it, which is known to some covariance only, contact may be met too early.
FitResult WithJumpsInPlay(const FitData& data, const sim::Plant& plant, FitResult fit,
                          const LiftedOptions& options);

// The most that it adds to the χ² of a true mass in springs in the mean; 0 without one.
double TrueJumps(const FitData& data, const sim::Plant& plant, double noise_scale);

// Whether a mass on a rod goes on: most of its steps between windows that meet, and are met by the fit, are
// no larger than 99 % of a true mass's, or than a tenth of its swing [nats]. One meeting in four must be of
// windows that are met. Nothing where none meet. The fit's work grows by what this costs.
std::optional<bool> SwingsOn(const FitData& data, const sim::Plant& plant, FitResult* fit,
                             const LiftedOptions& options);

}  // namespace rg::diagnosis
