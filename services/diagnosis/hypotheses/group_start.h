// Where the search begins on an ordinary arm: geared drives are alike, so that dry and viscous friction and a
// rotor are on every joint or on none. Found one at a time from a rigid model they are not: with one of
// eighteen no fit comes near the recordings, and every score is out of its range of validity.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/features.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// `effects` on every joint that takes them and has no such effect yet (EffectInfo::family "friction" has one
// dry law per joint), beside those of `nominal`, with start values from the regression of the inverse
// dynamics along the recorded motion. `base`: free base parameters, regressed together. Levels below nothing
// are set to a small one. Its fit is the regression's: `fit.values` only, and not `ok` where there are too
// few rows.
Candidate RegressedGroup(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                         const std::vector<std::string>& effects, bool base);

// What `effects` on every joint leave of the residual torque of that regression with free base parameters, by
// joint: the ratio of its robust scales with and without them, n. About 1 where they have nothing to do with
// what is missing, and where the regression cannot be made.
Eigen::VectorXd LeftByGroup(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                            const std::vector<std::string>& effects);

}  // namespace rg::diagnosis
