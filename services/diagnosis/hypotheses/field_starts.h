// Start values for forces without a name, over one joint's position or velocity, or over two joints'
// positions.
#pragma once

#include <optional>
#include <string>

#include "common/effects/effect.h"
#include "services/diagnosis/likelihood/features.h"
#include "services/diagnosis/likelihood/missing_force.h"

namespace rg::diagnosis {

// The unknown_field of one joint (`variable`: "position", "velocity", or "drag", which only brakes) that
// follows its missing force best, over all joints: a regression on the field's weights, as below.
std::optional<effects::EffectSpec> FieldStart(const FitData& data, const sim::Plant& nominal,
                                              const MotionScales& scales, const MissingForce& missing,
                                              const std::string& variable);

// The unknown_field_pair that follows the missing force best, over all pairs of joints: a regression of one
// joint's missing force on the surface's weights. The stairs' errors are taken as independent, which they are
// not: good enough for a start of a fit that is linear in the weights. Empty for one joint.
std::optional<effects::EffectSpec> FieldPairStart(const FitData& data, const sim::Plant& nominal,
                                                  const MotionScales& scales, const MissingForce& missing);

}  // namespace rg::diagnosis
