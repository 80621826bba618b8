// From a screened hypothesis to an effect that the simulator has, with start values and priors.
#pragma once

#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "services/diagnosis/lifted_fit.h"
#include "services/diagnosis/screening.h"

namespace rg::diagnosis {

// Specs (one per joint) with start values for the refit; several where there are several starts.
std::vector<std::vector<effects::EffectSpec>> SpecsFor(const Scored& hypothesis, const sim::Plant& nominal,
                                                       const MotionScales& scales);
// Effects with hidden states or hidden geometry, which the screen cannot see; from several starts.
std::vector<std::vector<effects::EffectSpec>> TransmissionStarts(const std::string& effect, int joint,
                                                                 const sim::Plant& nominal,
                                                                 const MotionScales& scales);
std::vector<std::vector<effects::EffectSpec>> BodyStarts(const std::string& effect, const sim::Plant& nominal,
                                                         const FitData& data, const MotionScales& scales);

// Free parameters of a plant: all parameters of its effects with priors in units of the motion, and, with
// `base`, the inertial parameters with priors around the URDF.
std::vector<sysid::FitParameter> FreeParameters(const sim::Plant& plant, const MotionScales& scales,
                                                bool base);

// A key that is the same for the same effects on the same joints: "coulomb_friction[2] payload[]".
std::string KeyOf(const std::vector<effects::EffectSpec>& specs);

}  // namespace rg::diagnosis
