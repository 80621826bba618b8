// The search where the drives' effort is measured, as on real robots.
//
// A measured effort has noise of its own, and no model of a real arm is right to the noise of its encoders:
// χ² against the sensors is never near 1. The likelihood is that of the balance of torques
// (torque_balance.h); hypotheses are compared by cross-validated gain (balance_fit.h). Steps:
//   1. delay or lag per joint, first because delay, damping and friction are confounded;
//   2. drives coupled to two joints (wrists), with plain losses on all joints;
//   3. kinds of effects, each on the joints where it pays, base parameters free throughout;
//   4. refinements of dry friction (direction, Stribeck, load, warming);
//   5. backward elimination, base parameters included;
//   6. refit in the simulator by multiple shooting, where friction sticks;
//   7. ceiling: the gain of a free force over position and velocity.
// An effect needs two standard errors over blocks (three if rare), the log of the number of hypotheses, and a
// tenth of the residual cost of its joint, since real arms show a little of every effect.
#pragma once

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "services/diagnosis/api/options.h"
#include "services/diagnosis/hypotheses/search_result.h"
#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

// Whether some recording has a measured effort, so that this search applies.
bool EffortIsMeasured(const FitData& data);

SearchResult SearchMeasuredEffort(const FitSetting& setting, const DiagnosisOptions& options, int threads,
                                  const Clock& clock, const ProgressFn& progress, const CancelToken* cancel);

}  // namespace rg::diagnosis
