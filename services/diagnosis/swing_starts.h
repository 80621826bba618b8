// Where fits of a mass that swings on a rod (sloshing_payload, form "rod") begin.
#pragma once

#include <vector>

#include "services/diagnosis/lifted_fit.h"

namespace rg::diagnosis {

bool HasRod(const std::vector<effects::EffectSpec>& specs);
bool HasMassInSprings(const std::vector<effects::EffectSpec>& specs);
// Whether one swings on the last link, not on the end effector.
bool SwingsOnLastLink(const std::vector<effects::EffectSpec>& specs);

// A mass that is a point, as a fit may come to and none leads away from, in the values of `plant`: one that
// is not small, and hangs and swings alike.
void WidenPoint(const sim::Plant& plant, Eigen::VectorXd* values);

// A mass on a rod in the place of one in springs, from what is found of that: where its link hardly turns
// springs of k are a rod of L = m·9.81/k. Its hinge is the axis of the link that gravity is least along, or
// the next one, or the last.
std::vector<effects::EffectSpec> RodStarts(const FitData& data, const sim::Plant& nominal,
                                           const effects::EffectSpec& springs);

}  // namespace rg::diagnosis
