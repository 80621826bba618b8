// Start values of unnamed forces (unknown_field, unknown_field_pair), regressed on the missing force.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/fit_setting.h"
#include "services/diagnosis/likelihood/missing_force.h"

namespace rg::diagnosis {

// Variables of an unnamed force. One over speed may follow two friction laws: it comes last.
inline const std::vector<std::string> kFieldVariables = {"position", "drag", "velocity"};

// The unknown_field of one joint with the most log evidence, of joint `only` if that is not −1. `variable`:
// "position", "velocity", or "drag" (damping over position).
std::optional<EffectSpec> FieldStart(const FitSetting& setting, const MissingForce& missing,
                                     const std::string& variable, int only = -1);

// The unknown_field_pair of the pair of joints with the most, the same way. The errors of the stairs are
// taken as independent, which is good enough to start a fit that is linear in the weights. Empty for one
// joint.
std::optional<EffectSpec> FieldPairStart(const FitSetting& setting, const MissingForce& missing,
                                         int only = -1);

// The latter for "position" where there are two joints, else the former.
std::optional<EffectSpec> UnnamedStart(const FitSetting& setting, const MissingForce& missing,
                                       const std::string& variable, int only = -1);

}  // namespace rg::diagnosis
