// A set of effects, fitted, and what its structure costs before any data.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "common/sim/plant.h"
#include "services/diagnosis/lifted_fit.h"

namespace rg::diagnosis {

// A fitted set of effects.
struct Candidate {
  std::vector<effects::EffectSpec> specs;
  bool base = false;
  std::shared_ptr<const sim::Plant> plant;
  std::vector<sysid::FitParameter> parameters;
  FitResult fit;
  double score = 0;  // evidence with the structure's prior
  int round = 0;
};

// −log prior odds: of a URDF that is off, of every kind of effect, every joint of it, every parameter beyond
// its first.
double StructurePrior(const std::vector<effects::EffectSpec>& specs, bool base);
inline constexpr double kEffectPrior = 4.0;  // of one more kind of effect

// Whether the effect acts there already; joint "": on the robot as a whole.
bool Contains(const std::vector<effects::EffectSpec>& specs, const std::string& id, const std::string& joint);

}  // namespace rg::diagnosis
