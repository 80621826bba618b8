// The parameter columns of a screen, what each stands for, and the screen around a model.
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

// `held` and an offset and a delay of the sensor on every joint of `plant` that takes them and has none.
std::vector<EffectSpec> WithProbes(const std::vector<EffectSpec>& held, const sim::Plant& plant);

// `plant`: with the probes; `held`: the effects of the model, whose columns are nuisance. Writes
// `parameters`, one per column. `nominal`: as given by the user.
std::vector<ParameterColumn> ScreenColumns(const sim::Plant& plant, const sim::Plant& nominal,
                                           const MotionScales& scales, const std::vector<EffectSpec>& held,
                                           std::vector<sysid::FitParameter>* parameters);

// Signatures for a screen around a fit, along its own motion. `options`: of that fit. Adds its cost to
// `work`.
FeatureSet FeaturesAlongFit(const FitSetting& setting, const Candidate& fitted, const LiftedOptions& options,
                            double* work = nullptr);

// Where a screen of a model is linearised.
struct ScreenPoint {
  bool around_fit = false;               // its own parameters and states; else along the recorded motion
  const Candidate* values_of = nullptr;  // whose parameters, along the recorded motion; null: as given
};

// Score tests of all additions to `current`, base parameters free or fixed as its own are. `step_rule`: null:
// not asked for; StepRuleResiduals, computed if empty and then reused, since they hardly depend on a model of
// that step.
ScreenResult ScreenAround(const FitSetting& setting, const Candidate& current, const ScreenPoint& at,
                          const FeatureSet& features, const LiftedOptions& options, Rng rng,
                          std::vector<VectorXd>* step_rule);
// The same for each joint of `force`, with the force there alone integrated out.
std::vector<ScreenResult> ScreensBeside(const FreeForce& force, const FitSetting& setting,
                                        const Candidate& current, const ScreenPoint& at,
                                        const FeatureSet& features, const LiftedOptions& options, Rng rng);

}  // namespace rg::diagnosis
