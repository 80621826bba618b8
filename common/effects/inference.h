// What recordings tell of an effect, declared in its file as `static Inference Inferred()`: the force that it
// makes on a joint as a sum of regressors, the parameters that their coefficients come to, what it stands in
// the place of. Identification and diagnosis ask for these properties and loop over effects.
#pragma once

#include <algorithm>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"

namespace rg::effects {

// A force on a joint per unit of a coefficient, along its recorded motion q, v, a, effort u, and time t; x is
// the regressor's shape, where it has one.
enum class Regressor {
  kVelocity,         // −v
  kSquaredVelocity,  // −v·|v|
  kDirection,        // −sign(v)
  kForwards,         // the same where v > 0
  kBackwards,        // and where v < 0
  kSlowly,           // −sign(v)·exp(−(v/x)²)
  kUnderLoad,        // −sign(v)·|u|
  kWarmingUp,        // −sign(v)·exp(−t/x)
  kBristle,          // −sign(v) behind a bristle that slides after x
  kEffort,           // u
  kConstant,         // 1
  kInBand,           // −u, within ±x
  kBeyond,           // −u beyond ±x
  kDelayed,          // u(t − x) − u(t)
  kLagging,          // u through a first-order lag of time constant x, less u
  kThroughSpring,    // u through a motor on a spring that resonates at x [rad/s], less u
  kSprungRotor,      // −a through the same
  kOtherEffort,      // u of another joint
  kPosition,         // −(q − x)
  kSine,             // sin(x·q)
  kCosine,           // cos(x·q)
  kPositionPiece,    // a piece of a smooth function of q, at x
  kVelocityPiece,    // and of v
  kAcceleration,     // −a
  kPulse,            // 1 for a while from t = x on
};

// Part of an effect's force, linear in one coefficient.
struct Term {
  Regressor regressor;
  std::vector<std::string> adds_to = {};  // parameters, each the sum of the coefficients of such terms
  bool positive = false;                  // its coefficient is
};

// An effect has at most one of them on a joint.
enum class Slot { kNone, kDryFriction, kTransmission, kDelay, kPositionForce };

// The motion that shows an effect best, what shows the rarer law first.
enum class Probe { kSlowRamps, kChirp, kLoads, kSpeeds, kRepeats, kReversals, kVibration, kSweep };

// Typical sizes of a joint's motion, SI; of the robot's: the largest of its joints.
struct JointSize {
  double torque = 1, speed = 1, acceleration = 1, inertia = 1;
  double low = 0, high = 1;  // range of positions
  double duration = 1;
  bool moves = true;     // by more than its noise
  double last_mass = 1;  // of the robot's last body

  double Range() const { return std::max(0.05, high - low); }
};

// What is believed of a parameter before any data.
struct Prior {
  double center = 0, stddev = 1;
  double lower = -1e300, upper = 1e300;
};

// Coefficients that were found, and what a start is made from beside them.
struct Found {
  const std::vector<double>& c;  // of the terms; of a robot's effect, of the parameters that show it
  double shape = 0, shape_end = 0;
  JointSize joint = {};
  double least = 1e-6, least_share = 0.02;  // of what is positive; of a level, in the joint's torque
  double low = -10, high = 10;              // admissible positions
  // Of the robot: its joints, |g|, the last link's ten parameters.
  int joints = 0;
  double gravity = 9.81;
  const double* last_link = nullptr;
  std::map<std::string, std::string> options = {};  // under which they were found
};

// What starts of an effect that no screen shows are made from.
struct Blind {
  JointSize joint = {};
  std::vector<double> rotors = {};    // of a motor behind a gear, to be tried
  bool fine = false;                  // looks cost next to nothing
  const double* last_link = nullptr;  // its ten parameters
  bool end_effector_is_last = true;   // the last link that moves
};
using Values = std::map<std::string, double>;
struct Start {
  Values values;
  std::map<std::string, std::string> options = {};
};

struct Inference {
  std::vector<Term> terms = {};  // of the force on a joint; empty: it is not linear in anything
  std::string shape = {};        // the parameter that is the regressors' shape
  bool pieces = false;           // all shapes at once are the terms of one function
  bool needs_fit = false;        // its terms tell it around a model that fits, and not far from one
  // Its coefficient is one where the shape is right, and admissible near that; at the first or the last shape
  // of a grid also far below.
  enum class Near { kAny, kOne, kOneOrBelowFirst, kOneOrBelowLast } coefficient = Near::kAny;
  bool common = false;          // one value may serve all joints
  bool of_every_drive = false;  // each has some
  bool unnamed = false;         // a force without a name
  Slot slot = Slot::kNone;
  Probe probe = Probe::kSweep;
  // Starts of a fit, where they are not the coefficients' sums themselves.
  std::vector<Start> (*starts)(const Found&) = nullptr;
  // Of about the same strength as another that it may be taken for: a level [N·m], a lateness [s].
  Values (*of_strength)(double level, double seconds, const JointSize&) = nullptr;
  // Starts of what has hidden states or geometry; `chained`: each of them leads fits to the next.
  std::vector<Start> (*blind)(const Blind&) = nullptr;
  bool chained = false;
  // Starts in the place of another of its slot with these values.
  std::vector<Start> (*instead)(const Values& other, Blind with) = nullptr;
  // Of a law of position alone: its force [N·m or N] there.
  double (*force_at)(const Values& values, double position) = nullptr;
  std::string stays = {};  // a parameter that fits leave near where they start
  std::string rotor = {};  // the parameter that is a rotor's inertia where the rest of it is rigid
  // Of parameters that are no levels, drags or rotors (PriorOf); the spec has the values that a fit starts
  // from.
  std::optional<Prior> (*prior)(const std::string& field, double nominal, const EffectSpec& spec,
                                const JointSize& joint) = nullptr;
  bool swings = false;           // a mass that hangs from the last link
  double rare = 0;               // −log odds beside those of any effect
  bool may_be_constant = false;  // a constant force, or one while the effort keeps its sign
  bool for_many_bodies = false;  // says in a number or few what other masses take many for
  // Whether it can be what these coefficients of its terms say.
  bool (*plausible)(const std::vector<double>& c) = nullptr;
};

// Of the effect with this id; the default for what is none.
const Inference& InferenceOf(std::string_view id);

// The effect with the fewest terms of those whose force holds this one: the plain law that it is.
const EffectInfo& LawOf(Regressor regressor);
// Whether the effect multiplies the effort of its joint.
bool ScalesEffort(std::string_view id);
// The effect of this role. There is one.
const EffectInfo& EffectOf(Role role);
// What hangs from the last link; what the base stands on.
const EffectInfo& SwingingMass();
const EffectInfo& SoftMount();
// A motor that sits behind a spring, and one behind a gap.
const EffectInfo& Spring();
const EffectInfo& Play();
// What touches the robot: something that stands there, or someone for a while.
const EffectInfo& Surface();
const EffectInfo& Push();
// All of a slot, in the catalogue's order, and whether an effect is of it.
std::vector<std::string> EffectsIn(Slot slot);
bool IsIn(Slot slot, std::string_view id);

// Of the spec's first owner, or the catalogue's default.
double ValueOf(const EffectSpec& spec, const std::string& parameter);

// Of a parameter of the spec, where a fit starts from `nominal`.
Prior PriorOf(const EffectSpec& spec, const ParameterInfo& parameter, double nominal, const JointSize& joint);

// Where fits of the effect start: with the coefficients' sums, not below what is least, or as it says itself.
std::vector<Start> StartsOf(const EffectInfo& effect, const Found& found);

}  // namespace rg::effects
