// A fitted hypothesis: a set of effects with the fit of its parameters, and the prior of its structure.
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

// The score of an inadmissible hypothesis: finite, because scores are subtracted.
inline constexpr double kNoScore = -1e300;

// A fitted hypothesis.
struct Candidate {
  std::vector<EffectSpec> specs;
  bool base = false;  // base parameters are free
  std::shared_ptr<const sim::Plant> plant;
  std::vector<sysid::FitParameter> parameters;
  FitResult fit;
  // Log evidence, structure prior included, less form; kNoScore: inadmissible.
  double score = 0;
  double form = 0;                 // nats charged for a richer law than the plainest of its kind
  int round = 0;                   // of the search, in which it was fitted
  std::optional<double> held_out;  // log predictive density of held-out recordings (held_out.h), if computed

  // The plant's parameter that free parameter k is.
  const sim::Parameter& Free(size_t k) const { return plant->parameters()[parameters[k].index]; }
};

// Moves score, information and standard deviations to another noise scale (LiftedOptions::noise_scale), but
// for what free hidden starts cost.
void Rescale(double before, double scale, Candidate* c);

// Without what belongs to the windows that it was fitted to.
inline Candidate WithoutStates(Candidate c) {
  c.fit.states.clear(), c.fit.window_chi2.clear();
  return c;
}

inline const Candidate& Better(const Candidate& a, const Candidate& b) { return b.score > a.score ? b : a; }

// −log p(structure) [nats]: per kind of effect, per joint of it, per parameter beyond the first, and for free
// base parameters.
double StructurePrior(const std::vector<EffectSpec>& specs, bool base);
inline constexpr double kEffectPrior = 4.0;  // of one more kind of effect
inline constexpr double kJointPrior = 1.0;   // of one more joint of it

inline constexpr double kConsistent = 2.0;  // χ² per row below which a model is consistent with the noise
inline constexpr double kExplained = 1.1;  // χ² per row (1: noise alone) below which nothing more is sought
inline constexpr double kZ99OneSided = 2.326;  // 99 % quantile of the standard normal distribution
inline constexpr double kZ99TwoSided = 2.576;  // 99.5 % quantile

// Traits of an effect, by its id: an unnamed force; delay or lag; that of a drive (not a sensor's); a force
// of one joint's position; friction or inertia of a drive.
bool IsUnnamed(const std::string& id);
bool IsTiming(const std::string& id);
bool IsLateDrive(const std::string& id);
bool IsOfPosition(const std::string& id);
bool IsLossOfDrives(const std::string& id);

// The variable of the unnamed force on the joint: "position", "velocity", "drag"; empty: none, or of two
// variables.
std::string FieldVariable(const std::vector<EffectSpec>& specs, const std::string& joint);

// Whether the effect is in `specs` on that joint; joint "": as one of the whole robot.
bool Contains(const std::vector<EffectSpec>& specs, const std::string& id, const std::string& joint);

bool HasKind(const std::vector<EffectSpec>& specs, const std::string& id);
std::vector<EffectSpec> WithoutKind(std::vector<EffectSpec> specs, const std::string& id);

// Whether every effect of `part` is in `whole`, on the same joints.
bool IsPart(const std::vector<EffectSpec>& part, const std::vector<EffectSpec>& whole);

// The effects with the fitted values as their start values.
std::vector<EffectSpec> Refreshed(const Candidate& c);
// The effects of `before` with the values of `c` where it has the same effect, else their own.
std::vector<EffectSpec> RefreshedFrom(const Candidate& before, const Candidate& c);

// Whether the data inform none of the parameters of some effect (of effect i): every posterior is nearly its
// prior, or a mass or a gap is at its lower bound.
bool Uninformed(const Candidate& c);
bool Uninformed(const Candidate& c, size_t i);

// Weights of unnamed forces that the fitted windows do not inform take the value of the nearest node that
// they do inform, where their prior would have a force end.
void ContinueFields(Candidate* c);

// The places among its effects of ripples that are not periodic in the joint's angle. On a rotary joint the
// number of cycles per turn is an integer (cogging, gear teeth and encoders repeat with each turn); the test
// is two-sided at 1 %. A ripple of which the recordings show less than most of a period is admitted only if
// the integer is known sharply, or if another joint shows a whole period; less than kLeastPeriods is any slow
// curve. With a spring on the same joint it needs two periods: fewer are two terms of any curve. Other
// missing effects bias the number, by up to a quarter; close to the noise by no more than the misfit that is
// left allows. `noise_scale`: what is taken for the noise's variance, in units of the sensors' own. `whole`:
// fitted on all windows; a trial on some need not know the number sharply.
std::set<size_t> Aperiodic(const Candidate& c, const MotionScales& scales, double noise_scale, bool whole);

// The places of Stribeck frictions that rise with speed and so imitate drag.
std::set<size_t> Rising(const Candidate& c);
// Whether the force of each of its springs grows with the distance from the centre over all recorded
// positions. It may decrease where a counterbalance's does, a sine of the angle; one-sided at 1 %. A force
// that decreases sooner is a detent or another force over position.
bool PullsBack(const Candidate& c, const MotionScales& scales);

// Whether every joint with bristles travels ten times as far as these bend at most: its start is then
// forgotten, and they are no free force in every window.
bool Slides(const Candidate& c, const MotionScales& scales);

// Wald statistic of effect i against absence: √(dᵀ·P·d). d: distance of its strengths (a delay, an amplitude,
// a mass, …) from their null values. P: their marginal precision, other effects' parameters integrated out,
// its own shape (an azimuth, a period) fixed. `gains_fixed`: gains of drives are fixed too. With free base
// parameters a gain scales all forces by a factor that the data hardly determine; but no factor makes a
// loss vanish.
double Strength(const Candidate& c, size_t i, bool gains_fixed = false);
inline constexpr double kAbsent = 1.0;  // Strength below which an effect is treated as absent
// The effects, refreshed, whose strength exceeds kAbsent or is LikeOtherJoints.
std::vector<EffectSpec> StrongEffects(const Candidate& c);
// The effects of `other`, refreshed, without those whose squared strength fell below a hundredth of that in
// `model`: they had stood in for a law that `other` has. (Play whose faces never part acts as a wrong zero.)
std::vector<EffectSpec> StillNeeded(const Candidate& model, const Candidate& other);

// Whether effect i is shared by the drives of the robot, which are alike, so that its joint needs no prior
// odds of its own. That is a delay or lag that another joint has too, or friction or rotor inertia on more
// than half of the joints and at least three. A joint has an effect if its strength exceeds kAbsent, or,
// without a fit, if the hypothesis has it there. Joints whose effect the data do not inform
// do not count.
bool OfAllJoints(const Candidate& c, size_t i);
// Whether the strength of such an effect i is compatible, within two standard deviations, with a fifth of the
// median of the other joints', in units of the priors. Holds where the joint's own motion says little.
bool LikeOtherJoints(const Candidate& c, size_t i);

// Whether effect i is needed without a refit to prove it: strength above 4, and ½·strength² above 2·needed
// nats (not asked of OfAllJoints). A saturation's strength is unknown, since its null value is infinite:
// false.
bool ClearlyNonzero(const Candidate& c, size_t i, double needed);

// Kinds of effects that `c` has and `before` has not.
std::set<std::string> FreshKinds(const Candidate& before, const Candidate& c);
bool HasUnnamed(const Candidate& c);
// Whether it has states that no sensor reads: a motor, a bristle, a lag, a mount, a swinging mass.
bool HasHiddenStates(const Candidate& c);
// Whether any of these is not determined by the commands alone, as a lag's is.
bool HasFreeStates(const Candidate& c);
// Whether some of these are of what no screen sees: a motor behind a spring or play, a mount, a swinging
// mass.
bool HasUnseenStates(const Candidate& c);
// Whether it has forces of position, which may be parts of an unnamed one.
bool OfPosition(const Candidate& c);

}  // namespace rg::diagnosis
