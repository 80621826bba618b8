// Start values for group hypotheses: the same effects (friction, rotor inertia) on every joint, as geared
// drives have them. Added one at a time they are not found: with one of eighteen losses no fit comes near the
// recordings, and every score is outside its range of validity.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

// The effects of `nominal`, and `effects` on every joint that takes them and has none of that kind yet (one
// dry friction per joint). Values are from a regression of the inverse dynamics along the recorded motion,
// `base`: with free base parameters. Negative strengths become small positive ones. Only fit.values and
// fit.theta are set; fit.ok is false where there are too few rows.
Candidate RegressedGroup(const FitSetting& setting, const std::vector<std::string>& effects, bool base);

// n: ratio of the robust scales of the residual torque of that regression, base parameters free, with and
// without `effects`. About 1 where they do not explain what is missing; 1 where the regression fails.
VectorXd LeftByGroup(const FitSetting& setting, const std::vector<std::string>& effects);

// A law that is on all joints beside `losses`: what its force leaves of the regression's residual torque, by
// joint as LeftByGroup has it, and its specs with start values.
struct LawOnAll {
  VectorXd left;
  std::vector<EffectSpec> specs;
};
// Of every law of a joint with a force that is linear in coefficients which the regression knows, and that is
// no loss: springs, drag, offsets; those that leave less than `most` on half of the judged joints, beside
// free base parameters, the least first. `base`: start values beside free base parameters.
std::vector<LawOnAll> LawsOnAll(const FitSetting& setting, const std::vector<std::string>& losses, bool base,
                                double most);

}  // namespace rg::diagnosis
