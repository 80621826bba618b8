// Continuity of a moving mass over windows. A mass whose state is free where each window starts acts as a
// free force per window: it imitates limits, contacts and friction. By its law it continues from the end of
// the window before. Two windows that meet estimate the state between them with covariances P (end of the
// first) and P' (start of the second). A discontinuity d between the two estimates
// adds to χ²
//
//   dᵀ (P + P')⁻¹ d
//
// to first order, at fixed parameters: what one common state would cost more than two. A true law pays about
// 1 per observable state, and nothing per unobservable one. It pays more where only many windows together
// determine its frequency.
// Other hidden states (a motor, a bristle, a mount) are not charged.
//
// A mass in springs pays that. A mass on a rod may be a whole turn off in some windows, which then fit badly
// and whose discontinuities are of any size. It counts as continuous if most discontinuities between windows
// that fit are within noise, or below a tenth of what a mass that hangs still would have there. The latter
// allows for an idealised law. A mass
// whose start is arbitrary in each window has discontinuities as large as its swing.
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

// Whether a mass on a rod is continuous: most discontinuities between adjacent windows that fit are below the
// 99 % quantile of a true mass's, or below a tenth of its swing [nats]. A quarter of the adjacent pairs must
// fit. Nothing where no windows are adjacent. Adds its cost to the fit's work.
std::optional<bool> SwingsOn(const FitData& data, const sim::Plant& plant, FitResult* fit,
                             const LiftedOptions& options);

}  // namespace rg::diagnosis
