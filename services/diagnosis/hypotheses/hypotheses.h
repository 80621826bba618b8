// From a screened hypothesis to an effect that the simulator has, with start values and priors.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "common/effects/inference.h"
#include "services/diagnosis/likelihood/features.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// Effects to add to a model, with start values.
using TrialSpecs = std::vector<EffectSpec>;

inline constexpr int kLightRobot = 1;  // joints, up to which looks at starts cost next to nothing

// Result of the score test of one hypothesis (screening/screening.h).
struct Scored {
  std::string effect;
  std::vector<int> joints;  // source, target for joint_coupling; empty: the robot
  double gain = 0;          // nats of log evidence, less log(number of shapes tried)
  double chi2 = 0;          // reduction of χ²
  double step_rule = 0;     // nats that the effect would gain if another step rule had made the recordings
  double shape = 0, shape_end = 0;
  std::map<std::string, std::string> options;  // of a surface
  std::vector<double> coefficients;            // per column of the effect, SI, joint after joint
};

// What is typical of a joint's motion; of the robot's for -1.
effects::JointSize SizeOf(const MotionScales& scales, const sim::Plant& plant, int joint);

// Specs (one per joint) with start values for the refit; several where there are several starts.
std::vector<TrialSpecs> SpecsFor(const Scored& hypothesis, const sim::Plant& nominal,
                                 const MotionScales& scales);
// Effects with hidden states or hidden geometry, which the screen cannot see; from several starts.
// Spring or play in a gear with the encoder on the "link" or the "motor": a grid, for
// fits of play end near where they start. A look at each tells which are worth a fit.
// added_inertia: what the screen would add to the joint's inertia [kg·m²], 0 where it does not say.
std::vector<TrialSpecs> TransmissionStarts(const std::string& effect, const std::string& sensor, int joint,
                                           const sim::Plant& nominal, const MotionScales& scales,
                                           double added_inertia);
// The same before a rotor of that inertia [kg·m²]: from soft to stiff, or from little to much play.
std::vector<TrialSpecs> StartsBehind(const std::string& effect, const std::string& sensor, int joint,
                                     const sim::Plant& nominal, const MotionScales& scales, double rotor);
// Rigid gears in the place of springs: of each the rotor behind it.
std::vector<EffectSpec> WithoutSprings(std::vector<EffectSpec> specs);
// With the force of that joint's spring in the middle of its travel in the spring's place, where the joint
// can take a constant force.
std::vector<EffectSpec> WithConstantForce(std::vector<EffectSpec> specs, const std::string& joint,
                                          const sim::Plant& nominal, const MotionScales& scales);
// The other law of a gear in the place of a spring or play, with the motor and the sensor that it has: play
// from a grid of gaps, or the spring that its faces are. Empty for other effects.
std::vector<TrialSpecs> OtherTransmission(const EffectSpec& spec, const sim::Plant& nominal,
                                          const MotionScales& scales);
// `specs` with play in the place of a motor's sensor that reads off, `offset`: half of a gap that gravity
// holds closed. Behind it the rotor that the joint has, or a typical one. Empty for other effects.
TrialSpecs PlayHeldClosed(const TrialSpecs& specs, const EffectSpec& offset, const sim::Plant& nominal,
                          const MotionScales& scales);
// `specs` with the ripples of joints whose drives lag on the other side of the lag: on the motor, or on the
// command that the lag follows. Empty where there are none.
TrialSpecs RipplesAcrossLags(TrialSpecs specs);
std::vector<TrialSpecs> BodyStarts(const std::string& effect, const sim::Plant& nominal,
                                   const MotionScales& scales);
// A mount from soft to stiff, in steps from each of which a fit finds the next.
std::vector<TrialSpecs> MountStarts(const sim::Plant& nominal, const MotionScales& scales);

// Free parameters of a plant: all parameters of its effects with priors in units of the motion, rotor
// inertias that the URDF cannot tell (sysid/rotor_start.h), and, with `base`, the inertial parameters with
// priors around the URDF. Effects that `given` has too were stated by the user: their priors are about the
// stated values.
std::vector<sysid::FitParameter> FreeParameters(const sim::Plant& plant, const MotionScales& scales,
                                                bool base, const sim::Plant* given = nullptr);

// `specs` with `added`, which take the place of what cannot stand beside them on the same joints: at most one
// dry friction, one transmission, one delay and one force of position per joint.
std::vector<EffectSpec> Joined(std::vector<EffectSpec> specs, const std::vector<EffectSpec>& added);
// Whether `specs` have what a screen scored, on one of its joints.
bool AlreadyIn(const std::vector<EffectSpec>& specs, const Scored& h, const sim::Plant& nominal);
// Forms of dry friction beyond the plain one.
std::vector<std::string> RicherFrictions();
bool IsRicherFriction(const std::string& effect);
bool IsRicherFormOf(const std::string& richer, const std::string& plain);
// What an effect is easily taken for and can be exchanged with on the same joints; empty where nothing.
std::vector<std::string> SiblingsOf(const std::string& effect);
// `spec` as its sibling, of about the same strength.
EffectSpec Exchanged(const EffectSpec& spec, const std::string& sibling, const sim::Plant& nominal,
                     const MotionScales& scales);

// A drive whose motor turns with its joint and with `ratio` times the other one, with the losses of a motor
// that turns with its joint alone.
struct DriveLosses {
  double viscous = 0, coulomb = 0, armature = 0;
};
EffectSpec CoupledDrive(const std::string& other, const std::string& joint, double ratio,
                        const DriveLosses& losses);
bool IsCoupledDrive(const EffectSpec& spec);

// A key that is the same for the same effects on the same joints: "coulomb_friction[2] payload[]".
std::string KeyOf(const std::vector<EffectSpec>& specs);
// The same with "+base" behind it where the base parameters are free.
std::string KeyOf(const std::vector<EffectSpec>& specs, bool base);

}  // namespace rg::diagnosis
