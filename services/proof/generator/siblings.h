// The simpler effect inside another one: what a name must be told from before a label may ask for it.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "services/proof/generator/truth.h"

namespace rg::proof {

// The truth with, in place of `effect` on this joint, the simpler ones that come nearest to it; empty where
// the effect has none. `load`: mean |drive torque| there, N·m; `tool`: where a mass hangs, m.
// - Stribeck, asymmetric, load-dependent friction, thermal drift, bristles: dry friction of one level, at
//   several levels;
// - dry friction of one level: half as much again (on a joint that it holds still no level shows);
// - elasticity: the rotor rigidly on the joint; backlash: the same, and the spring without its gap;
// - a swinging mass (on no joint): the same mass held where it hangs.
std::vector<Truth> SimplerSiblings(const Truth& truth, const std::string& effect, size_t joint, double load,
                                   const std::array<double, 3>& tool);

}  // namespace rg::proof
