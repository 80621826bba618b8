// What is worth a trial in the simulator, after a screen: the best hypotheses, sets of joints and pairs of
// effects, what they are easily taken for, and what no linear screen can see.
#pragma once

#include <cstdint>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/missing_force.h"
#include "services/diagnosis/screening/screening.h"

namespace rg::diagnosis {

// Effects to add to a model, with start values.
using TrialSpecs = std::vector<effects::EffectSpec>;

// Of starts the so many that are nearest to the record.
using Nearest = std::function<std::vector<TrialSpecs>(const std::vector<TrialSpecs>&, size_t)>;

// `wanted`: hypotheses that the screen gives less are left out; above 1 also what it cannot see.
// `force`: the missing force of `from`, asked for only where it is needed.
std::vector<TrialSpecs> Trials(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                               const Candidate& from, const ScreenResult& screened, double wanted,
                               const std::function<MissingForce()>& force, const Nearest& nearest);

// Springs and play of the one joint on which the screen finds most, beside what `from` has.
std::vector<TrialSpecs> TransmissionTrials(const FitData& data, const sim::Plant& nominal,
                                           const MotionScales& scales, const Candidate& from,
                                           const ScreenResult& screened, const Nearest& nearest);

// What a screen around a model that `holds` gives more than `needed` nats beyond what its structure costs,
// best first and `count` at most. There the screen is exact to first order, and of all windows: a small
// effect that a few of them do not pay for is worth its fit. Around one that does not hold only effects that
// it has already, on joints where it has them not: one kind on one joint more is likelier than another kind.
std::vector<TrialSpecs> Promised(const Candidate& from, const ScreenResult& screened,
                                 const sim::Plant& nominal, const MotionScales& scales, bool holds,
                                 double needed, size_t count);

// A trial that is better than the model it was added to.
struct RankedTrial {
  double left;    // share of that model's misfit that remains, of the same windows or pieces of windows
  double excess;  // χ² that it leaves beyond noise
  std::shared_ptr<const Candidate> fitted;
};

// The best of them, `count` at most and none twice, nor with joints or kinds that take less than a tenth off
// what is left beyond noise without them: so much a trial's few iterations do not tell. `apart`: those with
// another reference (hidden states, which need whole windows, beside others on pieces, over which less can go
// wrong): the two take turns.
std::vector<std::shared_ptr<const Candidate>> BestOf(std::vector<RankedTrial> trials,
                                                     std::vector<RankedTrial> apart, size_t count);

// `specs` with effect `id` exchanged for each that it is easily taken for, on the same joints; of dry
// friction's forms the plain one first.
std::vector<TrialSpecs> Exchanges(const TrialSpecs& specs, const std::string& id, const sim::Plant& nominal,
                                  const MotionScales& scales);

// `specs` with plain dry or viscous friction on one of several joints that have a richer form.
std::vector<TrialSpecs> PlainOnOneJoint(const TrialSpecs& specs, const sim::Plant& nominal,
                                        const MotionScales& scales);

// Springs behind the rotors that `account` has beyond `before` and that it owes most to: below its resonance
// a motor behind a spring is a rotor, and what it is more no screen can see.
std::vector<TrialSpecs> SpringsBehind(const Candidate& before, const Candidate& account,
                                      const sim::Plant& nominal, const MotionScales& scales);

// The places of so many windows, or of all, evenly spread.
std::vector<uint32_t> EvenlySpread(size_t windows, size_t count);

// The windows, about `wanted` of `all`, on which trials are fitted: every so many. Where these hold less than
// half of what is amiss (`chi2` of each window: a joint that saturates in three of sixty), every so much of
// what is amiss and of the windows, in equal parts.
std::vector<uint32_t> SomeWindows(const std::vector<double>& chi2, size_t all, size_t wanted);

}  // namespace rg::diagnosis
