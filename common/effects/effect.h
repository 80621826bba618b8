// What an effect is: one piece of physics that a rigid-body model can leave out (coulomb_friction,
// actuator_lag, payload, …). Each lives in one file of this folder: its law, its catalogue row, its
// parameters. effect_list.h names them all; nothing else has to be touched to add one.
//
//   command --actuator--> drive torque --transmission--> link torque --joint, body, environment-->
//   motion --sensor--> measured state
#pragma once

#include <limits>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"

namespace rg::effects {

inline constexpr double kInf = std::numeric_limits<double>::infinity();

enum class Stage { kActuator, kTransmission, kJoint, kBody, kSensor, kEnvironment };
std::string_view StageName(Stage stage);

// What an effect's force is best seen over, of the joint that feels it.
enum class Variable { kVelocity, kPosition, kEffort, kTime };
std::string_view VariableName(Variable variable);  // "velocity", "position", "effort", "time"

// What recordings must hold for an effect to show in them, of the joint that feels it (of any joint, for what
// belongs to no joint). Thresholds are in services/diagnosis/reporting/what_shows.h.
enum class Need {
  kBothWays,      // it moves either way
  kManySpeeds,    // slower and faster
  kSlowMotion,    // some rows at a small part of its usual speed
  kDenseRows,     // rows close enough for what lasts some hundredths of a second
  kResonances,    // rows close enough for vibrations
  kAcceleration,  // above its noise
  kTravel,        // a range of positions
  kPeriods,       // some periods of a ripple, passed slowly enough for the rows
  kPosture,       // torques that change with its position
  kTilt,          // torques that change with gravity's direction
  kLastMass,      // torques that change with the last link's mass
  kEffort,        // an effort that changes
  kEffortSign,    // an effort of either sign
  kPeakEffort,    // efforts up to the limit that is to be seen
  kLoad,          // a load that changes while it moves
  kWarming,       // time, and a temperature that changes where one is recorded
  kOtherEffort,   // another joint's effort that is not in proportion to its own
};
std::string_view NeedName(Need need);  // "both_ways", "dense_rows", …

// What the parameters belong to.
enum class Scope {
  kJoint,         // one set per joint it acts on: "coulomb_friction.joint_2.coulomb"
  kRobot,         // one set: "payload.*.mass"; `joints` stays empty
  kJointOrRobot,  // with joints as kJoint, without as kRobot
  kJointPair,     // one set, `joints` lists source and target in that order: "joint_coupling.*.coefficient"
};

// One scalar parameter of an effect, named exactly as in the contract EFFECTS.md.
struct ParameterInfo {
  std::string name;            // "coulomb"
  std::string symbol;          // "c", as it stands in EffectInfo::equation
  std::string unit;            // for a revolute joint, "N*m"
  std::string unit_prismatic;  // for a prismatic joint, "N"
  double lower = 0;            // physical bounds, not a search range; ±infinity where there is none
  double upper = 0;
  double default_value = 0;        // where an EffectSpec gives none (see default_is_effort)
  double prior_stddev = 1;         // typical size on an arm of this class; times the joint's effort limit
  bool prior_of_effort = false;    // where this is set
  bool default_is_effort = false;  // the default is the joint's effort limit (torque_saturation)
  std::string meaning;             // "Coulomb level", for tables and messages
  // Scope::kJointOrRobot: whether it exists only with joints or only without.
  enum class Only { kBoth, kWithJoints, kWithoutJoints } only = Only::kBoth;
  // Where not empty: it belongs to the form of the effect whose option "form" has this value.
  std::string form = {};
};

struct EffectSpec;

// Another form of an effect, which the value of one of its options gives it, and how that form reads.
struct FormInfo {
  std::string option, value;  // "form", "rod"
  std::string equation, sentence;
  Variable shows_over = Variable::kVelocity;
};

// The catalogue row of an effect.
struct EffectInfo {
  std::string id;     // as in EFFECTS.md; stored in files, never renamed
  std::string title;  // "Coulomb friction"
  Stage stage = Stage::kJoint;
  Scope scope = Scope::kJoint;
  std::string equation;  // "tau_f = -c*sign(dq)"
  // Plain words with {joint} and {<parameter>} to be filled in, see Sentence().
  std::string sentence;
  std::vector<ParameterInfo> parameters;
  std::string family;  // effects of one family are easily taken for each other: "friction", "timing", …
  std::vector<std::string> confused_with;  // ids, itself not included
  std::string reference;                   // literature
  Variable shows_over = Variable::kVelocity;
  // Options of EffectSpec::options and their admissible values, the first one is the default.
  std::map<std::string, std::vector<std::string>> options;
  // Forms with words of their own; the row's own are of the others.
  std::vector<FormInfo> forms = {};
  // Of another stage, but of the drive all the same: its rotor, the load on its gear.
  bool of_drive = false;
  // All of them must be met. Beside them any effect needs a joint that moves, and one of the actuator or the
  // transmission a drive.
  std::vector<Need> needs = {};

  // Whether it can only be where a drive is.
  bool NeedsDrive() const { return stage == Stage::kActuator || stage == Stage::kTransmission || of_drive; }
  // Index into `parameters`, or -1.
  int FindParameter(std::string_view name) const;
  // Index into the values of an option of the spec's, the default's where it chooses none.
  int Option(const std::string& option, const EffectSpec& spec) const;
  // Whether parameter i belongs to the spec's form of the effect.
  bool OfForm(int i, const EffectSpec& spec) const;
  // Whether parameter i exists for the spec: its form, with or without joints.
  bool Applies(int i, const EffectSpec& spec) const;
};

// An effect as a plant, a model file or a hypothesis holds it.
struct EffectSpec {
  std::string id;
  std::vector<std::string> joints;  // by Scope: the joints it acts on; empty; source and target
  // values[<joint> or "*"][<parameter>]; what is missing takes its default.
  std::map<std::string, std::map<std::string, double>> values;
  std::map<std::string, std::string> options;  // e.g. {"sensor", "motor"} of joint_elasticity
};

// "viscous_friction" on one joint with values: a spec in one line.
EffectSpec MakeSpec(std::string id, std::vector<std::string> joints = {},
                    std::map<std::string, double> values = {});

// What the spec's form of the effect shows over and what it says, in symbols, and in words with names and
// values filled in: "joint_2 loses a constant torque …". values: by parameter, those of the spec are not
// looked at.
Variable ShowsOver(const EffectSpec& spec);
std::string Equation(const EffectSpec& spec);
std::string Sentence(const EffectSpec& spec, const std::string& joint, bool prismatic,
                     const std::map<std::string, double>& values);

// Refuses unknown ids, parameters and options, wrong numbers of joints, joints twice, values that are
// not finite or outside their bounds; the message names effect, joint, parameter, value and limit.
Status ValidateSpec(const EffectSpec& spec);

}  // namespace rg::effects
