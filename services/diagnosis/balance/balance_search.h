// The search for missing effects where the drive's effort is measured: on real robots, as a rule.
//
// A measured effort has noise of its own, and no model of a real arm is right to the noise of its encoders,
// so χ² against the sensors never comes near 1 and decides nothing. Here the force balance (torque_balance.h)
// is the measure: what a hypothesis explains on parts of the recordings that it was not fitted to, in units
// of what remains and with the remainder's own correlation (balance_fit.h). In turn
//   1. how late motion follows effort, since delay, damping and friction confound until it is fixed;
//   2. whether a wrist's motor turns with two joints, beside plain laws on all;
//   3. kinds of effects, each on the joints where it pays, base parameters free throughout;
//   4. refinements of dry friction (direction, Stribeck, load, warming);
//   5. what does not pay goes, base parameters too;
//   6. the chosen model is fitted in the simulator, where friction really sticks, by multiple shooting;
//   7. what a free force over position and velocity would still explain: the ceiling.
// A name must gain more than three standard errors over blocks, more nats than chance over all hypotheses,
// and a tenth of what remains on its joint: real arms show a little of everything.
#pragma once

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "services/diagnosis/api/options.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// Whether this is the search for these data.
bool EffortIsMeasured(const FitData& data);

SearchResult SearchMeasuredEffort(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                                  const DiagnosisOptions& options, int threads, const Clock& clock,
                                  const ProgressFn& progress, const CancelToken* cancel);

}  // namespace rg::diagnosis
