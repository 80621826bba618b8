#include "services/diagnosis/hypotheses.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/candidate.h"
#include "services/diagnosis/features.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using effects::MakeSpec;

namespace {

constexpr double kSmall = 1e-6;

double Positive(double x, double least) { return std::max(x, least); }

EffectSpec JointSpec(const Scored& h, int joint, const std::vector<double>& c, const std::string& name,
                     const MotionScales& s) {
  const double torque = s.torque[joint], floor = 0.02 * torque;
  if (h.effect == "viscous_friction")
    return MakeSpec(h.effect, {name}, {{"viscous", Positive(c[0], kSmall)}});
  if (h.effect == "quadratic_drag")
    return MakeSpec(h.effect, {name}, {{"quadratic", Positive(c[0], kSmall)}});
  if (h.effect == "coulomb_friction") return MakeSpec(h.effect, {name}, {{"coulomb", Positive(c[0], floor)}});
  if (h.effect == "asymmetric_friction") {
    return MakeSpec(
        h.effect, {name},
        {{"coulomb_positive", Positive(c[0], floor)}, {"coulomb_negative", Positive(c[1], floor)}});
  }
  if (h.effect == "load_dependent_friction") {
    return MakeSpec(h.effect, {name},
                    {{"coulomb", Positive(c[0], floor)}, {"load_coefficient", Positive(c[1], 0.02)}});
  }
  if (h.effect == "stribeck_friction") {
    const double level = Positive(c[0], floor);
    return MakeSpec(
        h.effect, {name},
        {{"coulomb", level}, {"static", Positive(c[0] + c[1], floor)}, {"stribeck_velocity", h.shape}});
  }
  if (h.effect == "thermal_drift") {
    return MakeSpec(h.effect, {name},
                    {{"initial", Positive(c[0] + c[1], floor)},
                     {"final", Positive(c[0], floor)},
                     {"time_constant", h.shape}});
  }
  if (h.effect == "presliding_hysteresis") {
    const double level = Positive(c[0], floor);
    return MakeSpec(h.effect, {name},
                    {{"coulomb", level},
                     {"bristle_stiffness", level / h.shape},
                     {"bristle_damping", 0.2 * std::sqrt(level / h.shape * s.inertia[joint])}});
  }
  if (h.effect == "torque_gain")
    return MakeSpec(h.effect, {name}, {{"gain", std::clamp(1.0 + c[0], 0.2, kMostGain)}});
  if (h.effect == "torque_offset") return MakeSpec(h.effect, {name}, {{"offset", c[0]}});
  if (h.effect == "torque_deadband")
    return MakeSpec(h.effect, {name}, {{"deadband", Positive(c[0] * h.shape, kSmall)}});
  if (h.effect == "torque_saturation") return MakeSpec(h.effect, {name}, {{"limit", h.shape}});
  if (h.effect == "actuator_delay") {
    return MakeSpec(h.effect, {name}, {{"delay", std::clamp(c[0] * h.shape, 1e-3, 0.3)}});
  }
  if (h.effect == "actuator_lag") {
    return MakeSpec(h.effect, {name}, {{"time_constant", std::clamp(c[0] * h.shape, 2e-3, 0.3)}});
  }
  if (h.effect == "sensor_delay") return MakeSpec(h.effect, {name}, {{"delay", std::clamp(c[0], 1e-3, 0.3)}});
  if (h.effect == "encoder_offset") return MakeSpec(h.effect, {name}, {{"offset", c[0]}});
  if (h.effect == "rotor_inertia") return MakeSpec(h.effect, {name}, {{"armature", Positive(c[0], kSmall)}});
  if (h.effect == "torque_ripple") {
    return MakeSpec(h.effect, {name},
                    {{"amplitude", std::hypot(c[0], c[1])},
                     {"cycles_per_rev", h.shape},
                     {"phase", std::atan2(c[1], c[0])}});
  }
  if (h.effect == "position_spring") {
    const double k = c[1], center = std::abs(k) > 1e-9 ? h.shape + c[0] / k : h.shape;
    return MakeSpec(h.effect, {name},
                    {{"stiffness", k}, {"cubic", 0.0}, {"center", std::clamp(center, -10.0, 10.0)}});
  }
  if (h.effect == "external_disturbance") {
    return MakeSpec(h.effect, {name}, {{"start", h.shape}, {"end", h.shape_end}, {"torque", c[0]}});
  }
  if (h.effect == "unknown_field") {
    std::map<std::string, double> values = {{"low", s.low[joint]}, {"high", s.high[joint]}};
    for (size_t i = 0; i < c.size() && i < 8; ++i) values["w" + std::to_string(i)] = c[i];
    EffectSpec spec = MakeSpec(h.effect, {name}, values);
    spec.options["variable"] = "position";
    return spec;
  }
  return MakeSpec(h.effect, {name});
}

double LastMass(const sim::Plant& plant) {
  const auto& model = plant.model();
  double mass = 0;
  for (int i = 0; i < model.num_links(); ++i) {
    if (model.link(i).body == model.num_joints() - 1) mass += model.link(i).parameters[0];
  }
  return std::max(1e-3, mass);
}

// RMS of the weights that a surface starts with.
double SizeOfSurface(const sim::Plant& plant) {
  double squares = 0, count = 0;
  for (const EffectSpec& spec : plant.effects()) {
    if (spec.id != "unknown_field_pair") continue;
    for (const auto& [name, value] : spec.values.begin()->second) {
      if (name[0] == 'w') squares += value * value, ++count;
    }
  }
  return std::max(1e-9, std::sqrt(squares / std::max(1.0, count)));
}

// Of a mass on a rod that hangs, N·s/m; 0: there is none.
double CriticalDampingOfRod(const sim::Plant& plant) {
  const sim::ParameterTable& table = plant.parameters();
  const int mass = table.Find("sloshing_payload.*.mass"), length = table.Find("sloshing_payload.*.length");
  return length < 0 ? 0.0 : 2 * table[mass].nominal * std::sqrt(9.81 / table[length].nominal);
}

struct Prior {
  double center = 0, stddev = 1;
  double lower = -1e300, upper = 1e300;
};

Prior PriorOf(const sim::Parameter& p, int joint, const MotionScales& s, const sim::Plant& plant) {
  const double torque = joint >= 0 ? s.torque[joint] : s.torque.maxCoeff();
  const double speed = joint >= 0 ? s.speed[joint] : s.speed.maxCoeff();
  const double inertia = joint >= 0 ? s.inertia[joint] : s.inertia.maxCoeff();
  const double range = joint >= 0 ? std::max(0.05, s.high[joint] - s.low[joint]) : 1;
  const std::string& e = p.effect;
  const std::string& f = p.field;
  if (f == "viscous") return {0, 0.5 * torque / speed};
  if (f == "quadratic") return {0, 0.5 * torque / speed / speed};
  if (f == "coulomb" || f == "static" || f == "coulomb_positive" || f == "coulomb_negative" ||
      f == "initial" || f == "final" || f == "deadband" || f == "amplitude")
    return {0, 0.5 * torque};
  if (f == "load_coefficient") return {0, 0.3, 0, 2};
  if (f == "stribeck_velocity") return {p.nominal, 0.5 * speed, 0.02 * speed, 3 * speed};
  if (f == "bristle_stiffness") return {p.nominal, p.nominal, 0.1 * p.nominal, 50 * p.nominal};
  if (f == "bristle_damping") return {0, std::max(1e-6, 2 * p.nominal)};
  if (f == "delay") return {0, 0.03, 0, 0.4};
  if (e == "thermal_drift") return {p.nominal, 0.5 * s.duration, 0.03 * s.duration, 4 * s.duration};
  if (e == "actuator_lag") return {0, 0.03, 5e-4, 0.4};
  if (f == "gain") return {1, 0.3, 1 / kMostGain, kMostGain};
  if (f == "limit") return {p.nominal, torque, 1e-3 * torque, 50 * torque};
  if (f == "cycles_per_rev")
    return {p.nominal, 0.1 * p.nominal + 0.5, std::max(2.0, kLeastRipple * 2 * M_PI / range), 300};
  if (f == "phase" || f == "azimuth") return {p.nominal, 2};
  // Seen through its gear a light link's rotor is many times the link: what half the torque would turn.
  const bool moves = joint >= 0 && s.still[static_cast<size_t>(joint)] == 0;
  if (f == "armature") return {0, std::max(inertia, moves ? 0.5 * torque / s.acceleration[joint] : 0.0)};
  if (f == "offset") return {0, e == "encoder_offset" ? 0.1 : 0.5 * torque};
  if (f == "tilt") return {0, 0.1, -1.5, 1.5};
  if (f == "coefficient" && plant.parameters().Find("joint_coupling.*.coulomb") >= 0)  // form kinematic
    return {p.nominal, std::max(0.1, 0.5 * std::abs(p.nominal)), -10, 10};
  if (f == "coefficient") return {0, 0.5 * torque / std::max(1e-9, s.torque.maxCoeff()) + 0.1, -3, 3};
  if (e == "position_spring") {
    if (f == "stiffness") return {0, torque / range};
    if (f == "cubic") return {0, torque / range / range / range};
    return {p.nominal, 1.0, p.nominal - 3, p.nominal + 3};
  }
  if (e == "external_disturbance") {
    if (f == "torque") return {0, torque};
    if (f == "start" || f == "end") return {p.nominal, 0.4};
    return {0, 0.5 * torque / 0.3};
  }
  if (e == "payload" && f == "mass") return {0, 0.5 * LastMass(plant)};
  if (e == "payload") return {0, 0.15, -1, 1};
  if (f == "radius") return {0, 0.05};
  // What swings on a rod may swing for long.
  if (const double critical = CriticalDampingOfRod(plant);
      e == "sloshing_payload" && f == "damping" && critical > 0)
    return {0, 0.1 * critical};
  if (f == "mass") return {0, LastMass(plant), 1e-4 * LastMass(plant), 20 * LastMass(plant)};
  if (f == "gap") return {0, 0.05, 1e-5, 0.5};
  if (f == "height") return {p.nominal, 0.2};
  if (f == "motor_viscous") return {0, 0.2 * torque / speed};
  if (f == "motor_inertia") return {0.3 * inertia, inertia, 0.002 * inertia, 10 * inertia};
  if (e == "unknown_field_pair") return {0, 2 * SizeOfSurface(plant)};
  if (f[0] == 'w' && FieldVariable(plant.effects(), p.owner) == "drag") return {0, 0.5 * torque / speed, 0};
  if (f[0] == 'w') return {0, 0.5 * torque};
  // Stiffnesses and dampings: as likely half as twice the start.
  return {p.nominal, std::max(1e-6, p.nominal), 0.02 * p.nominal, 50 * p.nominal};
}

// The joint whose size a parameter goes with, or -1: of a drive that turns with two joints, its own.
int JointOf(const sim::Parameter& p, const sim::Plant& plant) {
  if (p.effect != "joint_coupling" || p.field == "coefficient") return plant.model().FindJoint(p.owner);
  for (const EffectSpec& spec : plant.effects()) {
    if (spec.id == p.effect) return plant.model().FindJoint(spec.joints.back());
  }
  return -1;
}

bool Fixed(const sim::Parameter& p) { return IsUnnamed(p.effect) && p.field[0] != 'w'; }

// Changes of the last link's mass and centre of mass as a body of their own, in that link's frame.
EffectSpec PayloadSpec(const std::vector<double>& change, const sim::Plant& nominal) {
  const auto& model = nominal.model();
  const auto link = model.link(model.joint(model.num_joints() - 1).child_link).parameters;
  const double mass = Positive(change[0], 0.01 * LastMass(nominal));
  double com[3];
  for (int i = 0; i < 3; ++i) {
    const double moment = link[0] * change[static_cast<size_t>(i) + 1] + change[0] * link[i + 1];
    com[i] = std::clamp(moment / mass, -0.3, 0.3);
  }
  return MakeSpec("payload", {}, {{"mass", mass}, {"com_x", com[0]}, {"com_y", com[1]}, {"com_z", com[2]}});
}

}  // namespace

std::vector<std::vector<EffectSpec>> SpecsFor(const Scored& h, const sim::Plant& nominal,
                                              const MotionScales& s) {
  const auto& names = nominal.joint_names();
  if (h.effect == "gravity_misalignment") {
    // A gravity change (g_x, g_y) is a tilt of |g_xy|/9.81 towards its direction.
    const double gx = h.coefficients[0], gy = h.coefficients[1];
    const double g = nominal.options().gravity.norm();
    const double tilt = std::clamp(std::hypot(gx, gy) / std::max(1e-6, g), 1e-3, 1.2);
    const double azimuth = std::atan2(gy, gx);
    std::vector<std::vector<EffectSpec>> out = {
        {MakeSpec(h.effect, {}, {{"tilt", tilt}, {"azimuth", azimuth}})}};
    // To first order a planar arm does not feel the tilt about the line in its plane: only the cosine, and
    // the gradient there is zero.
    if (nominal.num_joints() <= 2 && tilt < 0.3) {
      const double more = std::max(0.05, 1.5 * tilt), turn = std::acos(tilt / more);
      out.push_back({MakeSpec(h.effect, {}, {{"tilt", more}, {"azimuth", azimuth + turn}})});
    }
    return out;
  }
  if (h.effect == "payload") return {{PayloadSpec(h.coefficients, nominal)}};
  if (h.effect == "joint_coupling") {
    return {
        {MakeSpec(h.effect, {names[h.joints[0]], names[h.joints[1]]}, {{"coefficient", h.coefficients[0]}})}};
  }
  std::vector<EffectSpec> specs;
  const size_t m = h.joints.empty() ? 0 : h.coefficients.size() / h.joints.size();
  for (size_t i = 0; i < h.joints.size(); ++i) {
    // One common coefficient, or some for each joint.
    std::vector<double> c =
        m == 0 ? h.coefficients
               : std::vector<double>(h.coefficients.begin() + static_cast<long>(i * m),
                                     h.coefficients.begin() + static_cast<long>((i + 1) * m));
    specs.push_back(JointSpec(h, h.joints[i], c, names[h.joints[i]], s));
  }
  return {specs};
}

namespace {

// A spring or play between motor and link of a joint.
std::vector<EffectSpec> Transmission(const std::string& effect, const std::string& sensor,
                                     const std::string& joint, const std::map<std::string, double>& values) {
  EffectSpec spec = MakeSpec(effect, {joint}, values);
  spec.options["sensor"] = sensor;
  return {std::move(spec)};
}

std::vector<std::vector<EffectSpec>> PlayStarts(const std::string& sensor, int joint,
                                                const std::vector<double>& motors, const sim::Plant& nominal,
                                                const MotionScales& s) {
  const double inertia = s.inertia[joint], range = std::max(0.05, s.high[joint] - s.low[joint]);
  // Soft faces: how hard they are a fit finds out, but not where motor and link meet.
  const double omega = 2 * M_PI * 12.0, k = omega * omega * inertia;
  const std::vector<double> coarse = {0.007, 0.02, 0.06, 0.16};
  const std::vector<double> fine = {0.005, 0.009, 0.016, 0.03, 0.055, 0.1, 0.18};
  std::vector<std::vector<EffectSpec>> out;
  for (const double J : motors) {
    for (const double share : nominal.num_joints() <= kLightRobot ? fine : coarse) {
      out.push_back(Transmission("backlash", sensor, nominal.joint_names()[static_cast<size_t>(joint)],
                                 {{"gap", share * range},
                                  {"contact_stiffness", k},
                                  {"contact_damping", 0.3 * std::sqrt(k * inertia)},
                                  {"motor_inertia", J}}));
    }
  }
  return out;
}

}  // namespace

std::vector<std::vector<EffectSpec>> TransmissionStarts(const std::string& effect, const std::string& sensor,
                                                        int joint, const sim::Plant& nominal,
                                                        const MotionScales& s, double added_inertia) {
  const double inertia = s.inertia[joint];
  std::vector<double> motors = {0.15 * inertia, 0.4 * inertia};
  // Below its resonance the motor moves with the link: what the screen takes for more inertia is the motor.
  if (added_inertia > 0.01 * inertia) motors.push_back(std::min(added_inertia, 2 * inertia));
  if (effect == "backlash") return PlayStarts(sensor, joint, motors, nominal, s);
  std::vector<std::vector<EffectSpec>> out;
  for (const double J : motors) {
    const double lighter = J * inertia / (J + inertia);
    for (const double hertz : {5.0, 9.0, 16.0, 30.0}) {
      const double omega = 2 * M_PI * hertz, k = omega * omega * lighter;
      out.push_back(
          Transmission(effect, sensor, nominal.joint_names()[static_cast<size_t>(joint)],
                       {{"stiffness", k}, {"damping", 0.2 * std::sqrt(k * lighter)}, {"motor_inertia", J}}));
    }
  }
  return out;
}

std::vector<EffectSpec> WithoutSprings(std::vector<EffectSpec> specs) {
  for (EffectSpec& s : specs) {
    if (s.id != "joint_elasticity") continue;
    EffectSpec rotor;
    rotor.id = "rotor_inertia", rotor.joints = s.joints;
    rotor.values[s.joints[0]]["armature"] = s.values.at(s.joints[0]).at("motor_inertia");
    s = rotor;
  }
  return specs;
}

std::vector<std::vector<EffectSpec>> OtherTransmission(const EffectSpec& spec, const sim::Plant& nominal,
                                                       const MotionScales& s) {
  const bool play = spec.id == "backlash";
  if (!play && spec.id != "joint_elasticity") return {};
  const std::string& joint = spec.joints[0];
  const auto& values = spec.values.at(joint);
  const auto at = spec.options.find("sensor");
  const std::string sensor = at == spec.options.end() ? "link" : at->second;
  if (play) {
    return {Transmission("joint_elasticity", sensor, joint,
                         {{"stiffness", values.at("contact_stiffness")},
                          {"damping", values.at("contact_damping")},
                          {"motor_inertia", values.at("motor_inertia")}})};
  }
  return PlayStarts(sensor, nominal.model().FindJoint(joint), {values.at("motor_inertia")}, nominal, s);
}

std::vector<std::vector<EffectSpec>> OtherGaps(const EffectSpec& spec) {
  std::vector<std::vector<EffectSpec>> out;
  if (spec.id != "backlash") return out;
  for (const double part : {0.7, 0.85, 0.93, 1.08, 1.2, 1.4}) {
    EffectSpec other = spec;
    other.values.at(spec.joints[0]).at("gap") *= part;
    out.push_back({other});
  }
  return out;
}

std::vector<std::vector<EffectSpec>> StribeckStarts(const EffectSpec& friction, const sim::Plant& nominal,
                                                    const MotionScales& scales) {
  std::vector<std::vector<EffectSpec>> out;
  const double coulomb =
      Exchanged(friction, "coulomb_friction", nominal, scales).values.begin()->second.at("coulomb");
  EffectSpec start = Exchanged(friction, "stribeck_friction", nominal, scales);
  auto& values = start.values.begin()->second;
  const double speed = scales.speed[nominal.model().FindJoint(friction.joints[0])];
  for (const double share : {0.05, 0.15, 0.4}) {
    values["coulomb"] = 0.6 * coulomb, values["static"] = 1.2 * coulomb;
    values["stribeck_velocity"] = share * speed;
    out.push_back({start});
  }
  return out;
}

std::vector<std::vector<EffectSpec>> BodyStarts(const std::string& effect, const sim::Plant& nominal,
                                                const MotionScales& s) {
  std::vector<std::vector<EffectSpec>> out;
  if (effect == "payload") {
    // From the middle of the last link's own mass.
    const auto& model = nominal.model();
    Eigen::Vector3d com = Eigen::Vector3d::Zero();
    const int child = model.joint(model.num_joints() - 1).child_link;
    com = model.link(child).parameters.segment<3>(1);
    out.push_back({MakeSpec(
        effect, {},
        {{"mass", 0.1 * LastMass(nominal)}, {"com_x", com[0]}, {"com_y", com[1]}, {"com_z", com[2]}})});
    return out;
  }
  if (effect == "sloshing_payload") {
    // A pendulum's k/m is g/L, whatever its mass; fits find the mass from a small one, not from a large one.
    const auto& model = nominal.model();
    const bool same =
        model.joint(model.num_joints() - 1).child_link == model.FindLink(model.end_effector().name);
    struct Guess {
      double share, length;
      bool last_link;
    };
    for (const Guess g : {Guess{0.02, 0.05, true}, Guess{0.05, 0.1, true}, Guess{0.03, 0.07, false}}) {
      if (same && g.last_link && g.share > 0.03) continue;
      const double mass = g.share * LastMass(nominal), k = mass * 9.81 / g.length;
      EffectSpec spec =
          MakeSpec(effect, {}, {{"mass", mass}, {"stiffness", k}, {"damping", 0.05 * std::sqrt(k * mass)}});
      if (!same && g.last_link) spec.options["point"] = "last_link";
      out.push_back({spec});
    }
    return out;
  }
  if (effect == "base_flexibility") {
    const auto grid = MountStarts(s);
    return {grid.front(), grid[2]};
  }
  return out;
}

std::vector<std::vector<EffectSpec>> MountStarts(const MotionScales& s) {
  std::vector<std::vector<EffectSpec>> out;
  const double k = 15 * s.torque.maxCoeff();
  for (const double factor : {1.0, 2.5, 6.0, 15.0}) {
    out.push_back(
        {MakeSpec("base_flexibility", {}, {{"stiffness", k * factor}, {"damping", 0.02 * k * factor}})});
  }
  return out;
}

std::vector<sysid::FitParameter> FreeParameters(const sim::Plant& plant, const MotionScales& s, bool base) {
  std::vector<sysid::FitParameter> out;
  if (base) {
    out = sysid::InertialFitParameters(plant);
    for (const auto& p : sysid::DeclaredJointFitParameters(plant)) {
      if (p.nominal == 0) continue;
      out.push_back(p);
      out.back().prior_stddev = 0.5 * std::abs(p.nominal);
    }
  }
  for (auto& p : sysid::RotorFitParameters(plant)) out.push_back(std::move(p));
  for (int i = 0; i < plant.parameters().size(); ++i) {
    const sim::Parameter& p = plant.parameters()[i];
    if (p.kind != sim::ParameterKind::kEffect || Fixed(p)) continue;
    const Prior prior = PriorOf(p, JointOf(p, plant), s, plant);
    sysid::FitParameter row{i,
                            p.name,
                            p.unit,
                            prior.center,
                            std::max(p.lower, prior.lower),
                            std::min(p.upper, prior.upper),
                            prior.stddev};
    out.push_back(row);
  }
  return out;
}

namespace {

using Kinds = std::vector<std::string>;

const Kinds& DryFriction() {
  static const Kinds kinds = [] {
    Kinds out = {"coulomb_friction"};
    out.insert(out.end(), std::begin(kRicherFriction), std::end(kRicherFriction));
    return out;
  }();
  return kinds;
}

bool IsOneOf(const Kinds& kinds, const std::string& id) {
  return std::find(kinds.begin(), kinds.end(), id) != kinds.end();
}

bool IsTransmission(const std::string& id) { return id == "joint_elasticity" || id == "backlash"; }

bool IsCoupledDrive(const EffectSpec& s) {
  const auto form = s.options.find("form");
  return s.id == "joint_coupling" && form != s.options.end() && form->second == "kinematic";
}

// Whether a joint has one of them at most.
bool Exclusive(const std::string& a, const std::string& b) {
  static const std::vector<Kinds> kGroups = {DryFriction(),
                                             {"joint_elasticity", "backlash"},
                                             {"actuator_delay", "sensor_delay"},
                                             {"position_spring", "unknown_field"}};
  return a == b || std::any_of(kGroups.begin(), kGroups.end(),
                               [&](const Kinds& group) { return IsOneOf(group, a) && IsOneOf(group, b); });
}

}  // namespace

std::vector<EffectSpec> Joined(std::vector<EffectSpec> specs, const std::vector<EffectSpec>& added) {
  for (const EffectSpec& s : added) {
    std::erase_if(specs, [&](const EffectSpec& old) {
      // Nor does a coupling end at a joint behind a spring.
      if (old.id == "joint_coupling" && IsTransmission(s.id)) return old.joints.back() == s.joints.front();
      // Where a drive turns with two joints, its own losses are no longer its joint's.
      if (IsCoupledDrive(s) && old.joints.size() == 1 && old.joints.front() == s.joints.back())
        return IsOneOf(DryFriction(), old.id) || old.id == "viscous_friction" || old.id == "rotor_inertia";
      if (old.joints != s.joints) return false;
      // A motor behind a spring or play brings its own inertia.
      if (old.id == "rotor_inertia" && IsTransmission(s.id)) return true;
      return Exclusive(old.id, s.id);
    });
    specs.push_back(s);
  }
  return specs;
}

bool IsRicherFriction(const std::string& effect) {
  return effect != "coulomb_friction" && IsOneOf(DryFriction(), effect);
}

std::vector<std::string> SiblingsOf(const std::string& effect) {
  // A lag may stand beside a delay, and be taken for one; an unnamed force may be a spring's.
  static const Kinds kLate = {"actuator_delay", "actuator_lag", "sensor_delay"};
  if (IsOneOf(DryFriction(), effect)) return DryFriction();
  if (IsOneOf(kLate, effect)) return kLate;
  if (effect == "position_spring" || effect == "unknown_field") return {"position_spring"};
  return {};
}

EffectSpec Exchanged(const EffectSpec& spec, const std::string& id, const sim::Plant& nominal,
                     const MotionScales& s) {
  const int j = nominal.model().FindJoint(spec.joints[0]);
  double level = 0.05 * s.torque[j], seconds = 0.01;
  for (const auto& [name, value] : spec.values.begin()->second) {
    if (name == "coulomb" || name == "coulomb_positive" || name == "initial") level = std::max(level, value);
    if (name == "delay" || name == "time_constant") seconds = value;
  }
  const auto make = [&](std::map<std::string, double> values) {
    return MakeSpec(id, spec.joints, std::move(values));
  };
  if (id == "coulomb_friction") return make({{"coulomb", level}});
  if (id == "viscous_friction") return make({{"viscous", level / s.speed[j]}});
  if (id == "stribeck_friction") {
    return make({{"coulomb", 0.9 * level}, {"static", 1.2 * level}, {"stribeck_velocity", 0.2 * s.speed[j]}});
  }
  if (id == "asymmetric_friction") return make({{"coulomb_positive", level}, {"coulomb_negative", level}});
  if (id == "load_dependent_friction") {
    return make({{"coulomb", 0.5 * level}, {"load_coefficient", 0.5 * level / s.torque[j]}});
  }
  if (id == "presliding_hysteresis") {
    const double stiffness = level / 0.02;
    return make({{"coulomb", level},
                 {"bristle_stiffness", stiffness},
                 {"bristle_damping", 0.3 * std::sqrt(stiffness * s.inertia[j])}});
  }
  if (id == "thermal_drift") {
    return make({{"initial", 1.1 * level}, {"final", 0.9 * level}, {"time_constant", 0.4 * s.duration}});
  }
  if (id == "position_spring") {
    const double range = std::max(0.05, s.high[j] - s.low[j]);
    return make(
        {{"stiffness", 0.3 * s.torque[j] / range}, {"cubic", 0.0}, {"center", 0.5 * (s.low[j] + s.high[j])}});
  }
  if (id == "actuator_lag") return make({{"time_constant", seconds}});
  return make({{"delay", seconds}});
}

std::string KeyOf(const std::vector<EffectSpec>& specs) {
  std::set<std::string> parts;
  for (const EffectSpec& s : specs) {
    std::string part = s.id + "[";
    for (const std::string& j : s.joints) part += j + " ";
    part += "]";
    for (const auto& [k, v] : s.options) part += k + "=" + v;
    parts.insert(part);
  }
  std::string key;
  for (const std::string& p : parts) key += p + " ";
  return key;
}

std::string KeyOf(const std::vector<EffectSpec>& specs, bool base) {
  return KeyOf(specs) + (base ? "+base" : "");
}

}  // namespace rg::diagnosis
