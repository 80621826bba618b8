// The parameters that a screen varies, what each column of them stands for, and the screen itself.
#pragma once

#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "common/sim/plant.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/fit_setting.h"
#include "services/diagnosis/screening/screening.h"

namespace rg::diagnosis {

// `held` with an offset and a delay of the sensor on every joint of `plant` that takes them and has none.
std::vector<effects::EffectSpec> WithProbes(const std::vector<effects::EffectSpec>& held,
                                            const sim::Plant& plant);

// `plant`: with sensors' offsets and delays on every joint, as probes; `held`: the effects that the model
// has, whose columns are no hypotheses. `parameters`, one per column, are written.
std::vector<ParameterColumn> ScreenColumns(const sim::Plant& plant, const MotionScales& scales,
                                           const std::vector<effects::EffectSpec>& held,
                                           std::vector<sysid::FitParameter>* parameters);

// Everything screened beside `current`, with free base parameters or without: around the states and values of
// `at` where that is `current`; else on the recorded motion, at the base parameters of `at` or, without it,
// the nominal ones. `step_rule`: StepRuleResiduals of the first model, which serve all and are made where it
// is empty, for they hardly depend on the model.
ScreenResult ScreenAround(const FitSetting& setting, const Candidate& current, bool base, const Candidate* at,
                          const FeatureSet& features, const LiftedOptions& options, Rng rng,
                          std::vector<Eigen::VectorXd>* step_rule);

}  // namespace rg::diagnosis
