// A set of effects, fitted, and what its structure costs before any data.
#pragma once

#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "common/sim/plant.h"
#include "services/diagnosis/likelihood/features.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// The score of what is no account, whatever it leaves: finite, as scores are subtracted.
inline constexpr double kNoScore = -1e300;

// A fitted set of effects.
struct Candidate {
  std::vector<effects::EffectSpec> specs;
  bool base = false;
  std::shared_ptr<const sim::Plant> plant;
  std::vector<sysid::FitParameter> parameters;
  FitResult fit;
  double score = 0;   // evidence with the structure's prior; kNoScore: no account at all
  double docked = 0;  // that its score is less, for what it predicts worse of recordings kept aside
  double form = 0;    // that its score is less, for what a richer form than needed may pretend
  int round = 0;
  std::optional<double>
      held_out;  // log density of recordings kept aside, where it was asked for (held_out.h)
};

// To another estimate of how much noisier the recordings are than their sensors: evidence and information.
inline void Rescale(double before, double scale, Candidate* c) {
  c->score -= 0.5 * (1.0 / scale - 1.0 / before) * c->fit.chi2;
  c->fit.information *= before / scale;
}

// Without what belongs to the windows that it was fitted to.
inline Candidate WithoutStates(Candidate c) {
  c.fit.states.clear(), c.fit.window_chi2.clear();
  return c;
}

// Its score by the fit alone.
inline double FitScore(const Candidate& c) { return c.score + c.docked; }

// −log prior odds: of a URDF that is off, of every kind of effect, every joint of it, every parameter beyond
// its first.
double StructurePrior(const std::vector<effects::EffectSpec>& specs, bool base);
inline constexpr double kEffectPrior = 4.0;  // of one more kind of effect
inline constexpr double kJointPrior = 1.0;   // of one more joint of it

inline constexpr double kExplained = 1.1;  // χ² per row: errors a twentieth above the noise, none to look for
inline constexpr double kOnePercent = 2.326;     // stddev that one of a hundred normal variables exceeds
inline constexpr double kOneInAHundred = 2.576;  // the same to either side

// Whether the effect is a force without a name; lateness; a force on a joint over its position; what a drive
// loses or its rotor.
bool IsUnnamed(const std::string& id);
bool IsTiming(const std::string& id);
bool IsOfPosition(const std::string& id);
bool IsLossOfDrives(const std::string& id);

// What the unnamed force on the joint is over: "position", "velocity", …, or "drag"; empty: there is none
// that is over one variable.
std::string FieldVariable(const std::vector<effects::EffectSpec>& specs, const std::string& joint);

// Whether the effect acts there already; joint "": on the robot as a whole.
bool Contains(const std::vector<effects::EffectSpec>& specs, const std::string& id, const std::string& joint);

// Whether any effect of this kind is among them.
bool HasKind(const std::vector<effects::EffectSpec>& specs, const std::string& id);
// The effects without those of this kind.
std::vector<effects::EffectSpec> WithoutKind(std::vector<effects::EffectSpec> specs, const std::string& id);

// Whether all effects of `part`, on their joints, are among `whole`.
bool IsPart(const std::vector<effects::EffectSpec>& part, const std::vector<effects::EffectSpec>& whole);

// The effects with the fitted values in them, as the start of a larger model.
std::vector<effects::EffectSpec> Refreshed(const Candidate& c);

// Whether it has an effect of which the data show nothing: no parameter is known better than before them, or
// a mass or a gap is the least that it may be.
bool Unseen(const Candidate& c);
// Whether effect i is such a one.
bool Unseen(const Candidate& c, size_t i);

// Whether every ripple in it repeats as a ripple does. What turns with a rotary joint (cogging, a gear's
// teeth, a sensor's) is the same after each turn, so its cycles per turn are a whole number; one true ripple
// in a hundred is refused for that. Of one that hardly comes round within all that was recorded the number
// must be known well, which few other curves would meet, unless a ripple on another joint did come round;
// less than two fifths of a period is any slow curve. Beside a spring on its joint a ripple must come round
// twice within what was recorded: less are two terms of any curve. What else is missing bends a number, by up
// to a quarter, and where it is little by no more than such a bend could gain from it. `whole`: fitted on all
// windows; some alone need not know the number so well.
bool Repeats(const Candidate& c, const MotionScales& scales, double chi2_per_row, bool whole);

// Whether every Stribeck friction in it is what the name says: less at speed than at rest. One that grows
// with speed bends into drag.
bool Drops(const Candidate& c);

// How far effect i is from nothing: the stddevs that its strengths (a delay, an amplitude, a mass, …) lie
// from none, all together and to the fit's second order, while its shape (an azimuth, a period) is held and
// all else is free. Each alone may be unknown where their sum is certain: √(dᵀ·P·d), P their precision
// without what is free beside them.
double Strength(const Candidate& c, size_t i);
inline constexpr double kNothing = 1.0;  // strength at which it is about nothing
// Its effects, refreshed, without those that are about nothing.
std::vector<effects::EffectSpec> StrongEffects(const Candidate& c);
// The effects of `other`, refreshed, without those of which it leaves less than a hundredth of what they were
// worth in `account`: they stood for a law that `other` has. Play whose faces never part is half its gap off,
// as a wrong zero is.
std::vector<effects::EffectSpec> StillNeeded(const Candidate& account, const Candidate& other);
// Whether all that `c` has and `before` has not is about nothing.
bool AddsNothing(const Candidate& before, const Candidate& c);
// Whether effect i is one joint's share of what all drives have: a delay or lag that another joint has too,
// or friction or a rotor on more than half of the joints, three at least. Drives of one robot are alike: none
// is asked to be worth a name.
bool OfAllJoints(const Candidate& c, size_t i);
// Whether effect i, one of a kind that most joints have, may be as strong on its joint as it typically is on
// the others, measured by what the motion of each leads one to expect: drives of one robot are alike, and a
// joint whose motion tells little of its own is taken to be like them.
bool LikeItsFellows(const Candidate& c, size_t i);
inline constexpr long kManyJoints = 3;

// Whether a fit without effect i is not worth its cost: its strength is not within a few stddev of nothing,
// nor, unless it is of all joints, of what needs `needed` nats. A limit's strength is not known: it is
// nothing where it is high.
bool SurelyThere(const Candidate& c, size_t i, double needed);

// The effects of `before` with the values that `c` gives those which it has too, and their own for the
// others.
std::vector<effects::EffectSpec> RefreshedFrom(const Candidate& before, const Candidate& c);

// Kinds of effects that `c` has and `before` has not.
std::set<std::string> FreshKinds(const Candidate& before, const Candidate& c);
// Whether it has a force without a name.
bool HasUnnamed(const Candidate& c);
// Whether it has states that no sensor reads: a motor, a bristle, a lag, a mount, a swinging mass.
bool HasHiddenStates(const Candidate& c);
// Whether any of these is not settled by the commands alone, as a lag's is.
bool HasFreeStates(const Candidate& c);
// Whether the account is of forces over position that may be parts of an unnamed one.
bool OfPosition(const Candidate& c);

}  // namespace rg::diagnosis
