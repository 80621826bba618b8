// A mass on a rod as a law of what is recorded. Its hinge moved as the recordings say, so where the mass was
// follows from its length and from where it was when a recording began: it hung, or was let go along an axis
// of its link. Simulated along the motion, it pulls on the joints in proportion to its mass.
#pragma once

#include <optional>
#include <vector>

#include "services/diagnosis/likelihood/features.h"
#include "services/diagnosis/likelihood/fit_setting.h"
#include "services/diagnosis/likelihood/missing_force.h"

namespace rg::diagnosis {

// How a rod swings along a recorded motion.
struct Swing {
  double length = 0, decay = 0;  // of a point that swings alike [m]; of its rates [1/s]
  // 0: it hangs and does not turn; else let go along an axis of its link, 1 + 2·axis + (backwards).
  int start = 0;
};

struct RodStart {
  EffectSpec rod;
  Swing swing;
  double left = 1;                // of what any two laws leave
  std::optional<Feature> beside;  // the law that leaves least with it; none where it leaves least alone
};

// Regresses the missing force in the first seconds of at most 8 recordings on rods, the force of a mass at
// rest, and one law of `laws`. Returns the two likeliest lengths, each about all three axes of its link.
// Empty if rod and law do not reduce χ² to below nine tenths of that of the best two laws, and by 30.
// Adds its cost to `work`.
std::vector<RodStart> ScreenRods(const FitSetting& setting, const MissingForce& missing,
                                 const FeatureSet& laws, int threads, double* work = nullptr);

// The rod's angles and rates in `states` (of a model with it, along the recorded motion) as it swings, in
// windows of the first seconds, before rows are missing.
void PutSwing(const FitSetting& setting, const RodStart& start, NodeStates* states);

}  // namespace rg::diagnosis
