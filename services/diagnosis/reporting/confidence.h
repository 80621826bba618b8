// Confidence of findings, calibrated by the hit rates of such findings on sets with known answers.
//
// Log evidence compares a model with its rivals in the catalogue; it knows no law outside, and is far too
// confident beyond a few nats. Hit rates depend on the company of a finding instead: nothing left
// unexplained, few other effects, no rival in its class. They were counted on the sets of past blind
// examinations (docs/proof.md); `realitygrad prove` with other seeds measures whether they are right.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/api/result.h"

namespace rg::diagnosis {

// How findings came about, where that is not by a search that left nothing, or nothing but an unnamed force.
enum class Standing {
  kPlain,
  kMeasured,        // over a measured effort: cross-validated, and may accompany `unexplained`
  kSomeLeft,        // `unexplained` though the findings explain most of the mismatch
  kBesideAnyForce,  // named effects are significant whatever force acts on the unnamed one's joint
};

// Limits each finding's confidence, so far the odds of its evidence, by the hit rate of its kind, and that of
// `parameters_only` in addition to effects by theirs. Sorts the findings by confidence, `parameters_only`
// last. `joints`: of the robot. Where two kinds of drive losses are on most joints, findings on most joints
// have a hit rate of their own.
void Calibrate(const std::string& verdict, Standing standing, int joints, std::vector<Finding>* findings);

// Limits them where the time limit ended the search: hit rates are those of searches that compared all.
void LimitOutOfTime(std::vector<Finding>* findings);

}  // namespace rg::diagnosis
