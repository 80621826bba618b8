#include "services/proof/generator/hypotheses.h"

#include <algorithm>
#include <cmath>

#include "common/base/check.h"
#include "services/proof/generator/fields.h"

namespace rg::proof {
namespace {

using nlohmann::json;

json Value(double value, const char* unit) { return {{"value", value}, {"unit", unit}}; }

// One joint, or now and then several, or all.
std::vector<int> DrawJoints(int n, bool prefer_all, Rng& rng) {
  std::vector<int> all(static_cast<size_t>(n));
  for (int i = 0; i < n; ++i) all[static_cast<size_t>(i)] = i;
  const double dice = rng.Uniform();
  if (n == 1 || (prefer_all ? dice < 0.6 : dice < 0.1)) return all;
  std::vector<int> chosen = {static_cast<int>(rng.Index(static_cast<uint64_t>(n)))};
  if (dice > 0.7) {
    const int other = static_cast<int>(rng.Index(static_cast<uint64_t>(n)));
    if (other != chosen[0]) chosen.push_back(other);
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

struct Draft {
  const Scales& s;
  Rng rng;
  double x;  // strength
  Truth* truth;
  json parameters = json::object();
  std::vector<int> joints;
  bool on_joints = true;
  std::vector<std::string> equivalents, acceptable;

  json Value(int joint, double value, const char* unit) const {
    return UnitValue(value, unit, s.prismatic[static_cast<size_t>(joint)]);
  }
  // Lengths that usual figures are stated for an arm's joint are shorter on one that moves little.
  double Reach(int joint) const { return std::min(1.0, s.amplitude[joint] / 0.4); }
  JointTruth& Joint(int i) { return truth->joint[static_cast<size_t>(i)]; }
  json& Row(int i) { return parameters[s.joints[static_cast<size_t>(i)]]; }
  double LogUniform(double low, double high) { return low * std::pow(high / low, rng.Uniform()); }
};

void Friction(const std::string& id, Draft& d) {
  d.joints = DrawJoints(static_cast<int>(d.s.joints.size()), false, d.rng);
  for (int i : d.joints) {
    const double torque = 0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i], speed = d.s.velocity[i];
    JointTruth& j = d.Joint(i);
    json& row = d.Row(i);
    const double level = d.x * d.LogUniform(0.3, 0.9) * torque;
    if (id == "viscous_friction") {
      j.viscous = level / speed;
      row = {{"viscous", d.Value(i, j.viscous, "N*m*s/rad")}};
    } else if (id == "quadratic_drag") {
      j.quadratic = level / (speed * speed);
      row = {{"quadratic", d.Value(i, j.quadratic, "N*m*s^2/rad^2")}};
    } else if (id == "coulomb_friction") {
      j.dry.coulomb_positive = j.dry.coulomb_negative = level;
      row = {{"coulomb", d.Value(i, level, "N*m")}};
    } else if (id == "stribeck_friction") {
      j.dry.coulomb_positive = j.dry.coulomb_negative = 0.7 * level;
      j.dry.static_extra = level * d.rng.Uniform(0.5, 0.9);
      j.dry.stribeck_velocity = speed * d.rng.Uniform(0.15, 0.4);
      row = {{"coulomb", d.Value(i, 0.7 * level, "N*m")},
             {"static", d.Value(i, 0.7 * level + j.dry.static_extra, "N*m")},
             {"stribeck_velocity", d.Value(i, j.dry.stribeck_velocity, "rad/s")}};
    } else if (id == "asymmetric_friction") {
      j.dry.coulomb_positive = level * d.rng.Uniform(1.0, 1.4);
      j.dry.coulomb_negative = level * d.rng.Uniform(0.3, 0.6);
      if (d.rng.Uniform() < 0.5) std::swap(j.dry.coulomb_positive, j.dry.coulomb_negative);
      row = {{"coulomb_positive", d.Value(i, j.dry.coulomb_positive, "N*m")},
             {"coulomb_negative", d.Value(i, j.dry.coulomb_negative, "N*m")}};
    } else if (id == "load_dependent_friction") {
      j.dry.coulomb_positive = j.dry.coulomb_negative = 0.15 * level;
      j.dry.load_coefficient = std::min(0.6, 0.8 * level / std::max(1e-6, d.s.torque[i]));
      row = {{"coulomb", d.Value(i, 0.15 * level, "N*m")},
             {"load_coefficient", d.Value(i, j.dry.load_coefficient, "1")}};
    } else if (id == "presliding_hysteresis") {
      j.bristle.coulomb = level;
      j.bristle.stiffness = level / (d.Reach(i) * d.rng.Uniform(0.02, 0.06));
      j.bristle.damping = 0.2 * std::sqrt(j.bristle.stiffness * d.s.inertia[i]);
      row = {{"coulomb", d.Value(i, level, "N*m")},
             {"bristle_stiffness", d.Value(i, j.bristle.stiffness, "N*m/rad")}};
    } else {  // thermal_drift
      const double last = level * d.rng.Uniform(0.3, 0.5);
      j.dry.coulomb_positive = j.dry.coulomb_negative = last;
      j.dry.thermal_extra = 1.2 * level;
      j.dry.thermal_time = d.s.duration_s * d.rng.Uniform(0.2, 0.5);
      row = {{"initial", d.Value(i, last + j.dry.thermal_extra, "N*m")},
             {"final", d.Value(i, last, "N*m")},
             {"time_constant", d.Value(i, j.dry.thermal_time, "s")}};
    }
  }
}

void Coupling(Draft& d) {
  const int n = static_cast<int>(d.s.joints.size());
  const int from = static_cast<int>(d.rng.Index(static_cast<uint64_t>(n)));
  const int to = (from + 1 + static_cast<int>(d.rng.Index(static_cast<uint64_t>(n - 1)))) % n;
  d.truth->coupling_from = from, d.truth->coupling_to = to;
  d.truth->coupling = std::min(0.8, d.x * 0.5 * d.s.motion_torque[to] / std::max(1e-6, d.s.torque[from]));
  d.joints = {from, to};
  d.parameters["*"] = {{"coefficient", Value(d.truth->coupling, "1")}};
}

// Figures that gears and belts have: a rotor of a tenth to two fifths of what it drives, a spring that
// swings at a few hertz, a gap of about a degree. However strong the effect shall be, they stay such.
void SpringyTransmission(const std::string& id, Draft& d) {
  const int i = static_cast<int>(d.rng.Index(d.s.joints.size()));
  Transmission& t = d.Joint(i).transmission;
  const double inertia = d.s.inertia[i], resonance = 6.283 * d.LogUniform(4, 9) / std::sqrt(d.x);
  t.motor_inertia = inertia * d.rng.Uniform(0.1, 0.4);
  t.sensor_on_motor = d.rng.Uniform() < 0.5;
  json& row = d.Row(i);
  if (id == "joint_elasticity") {
    t.stiffness = resonance * resonance * inertia;
    t.damping = 0.1 * std::sqrt(t.stiffness * inertia);
    row = {{"stiffness", d.Value(i, t.stiffness, "N*m/rad")},
           {"damping", d.Value(i, t.damping, "N*m*s/rad")}};
  } else {
    t.gap = 0.03 * d.Reach(i) * d.x * d.rng.Uniform(0.7, 1.6);
    t.stiffness = 6.283 * 6.283 * 400 * inertia;
    t.damping = 0.4 * std::sqrt(t.stiffness * inertia);
    row = {{"gap", d.Value(i, t.gap, "rad")},
           {"contact_stiffness", d.Value(i, t.stiffness, "N*m/rad")},
           {"contact_damping", d.Value(i, t.damping, "N*m*s/rad")}};
  }
  row["motor_inertia"] = d.Value(i, t.motor_inertia, "kg*m^2");
  row["sensor_side"] = {{"value", t.sensor_on_motor ? "motor" : "link"}};
  d.joints = {i};
  d.acceptable = {"rotor_inertia", "viscous_friction"};
}

// Drops the joints on which a wrong zero changes next to nothing (an upright axis, a lift).
void KeepWhereZeroMatters(Draft& d) {
  const auto hidden = [&](int i) { return d.s.zero_matters[i] < 0.02; };
  d.joints.erase(std::remove_if(d.joints.begin(), d.joints.end(), hidden), d.joints.end());
  if (!d.joints.empty()) return;
  int best = 0;
  d.s.zero_matters.maxCoeff(&best);
  d.joints = {best};
}

void Actuator(const std::string& id, Draft& d) {
  const int n = static_cast<int>(d.s.joints.size());
  d.joints = DrawJoints(n, id == "actuator_delay" || id == "actuator_lag" || id == "sensor_delay", d.rng);
  if (id == "encoder_offset") KeepWhereZeroMatters(d);
  const double seconds = d.x * d.LogUniform(0.012, 0.04), factor = d.rng.Uniform(0.1, 0.25);
  const bool stronger = d.rng.Uniform() < 0.5;
  for (int i : d.joints) {
    JointTruth& j = d.Joint(i);
    json& row = d.Row(i);
    if (id == "actuator_delay") {
      j.delay = std::min(0.2, seconds);
      row = {{"delay", d.Value(i, j.delay, "s")}};
    } else if (id == "sensor_delay") {
      j.sensor_delay = std::min(0.2, seconds);
      row = {{"delay", d.Value(i, j.sensor_delay, "s")}};
    } else if (id == "actuator_lag") {
      j.lag = std::min(0.3, seconds);
      row = {{"time_constant", d.Value(i, j.lag, "s")}};
    } else if (id == "torque_gain") {
      j.gain = 1 + (stronger ? 1 : -1) * std::min(0.6, d.x * factor);
      row = {{"gain", d.Value(i, j.gain, "1")}};
    } else if (id == "torque_deadband") {
      j.deadband = d.x * 0.5 * (0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i]);
      row = {{"deadband", d.Value(i, j.deadband, "N*m")}};
    } else if (id == "torque_saturation") {
      j.saturation = 1.5 * d.s.peak_torque[i] / (1.0 + d.x);
      row = {{"limit", d.Value(i, j.saturation, "N*m")}};
    } else if (id == "torque_offset") {
      j.torque_offset = (stronger ? 1 : -1) * d.x * 0.4 * (0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i]);
      row = {{"offset", d.Value(i, j.torque_offset, "N*m")}};
    } else if (id == "torque_ripple") {
      j.ripple_amplitude = d.x * 0.5 * (0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i]);
      j.ripple_cycles = std::round((4 + static_cast<double>(d.rng.Index(14))) / d.Reach(i));
      j.ripple_phase = d.rng.Uniform(-3, 3);
      row = {{"amplitude", d.Value(i, j.ripple_amplitude, "N*m")},
             {"cycles_per_rev", d.Value(i, j.ripple_cycles, "1")},
             {"phase", Value(j.ripple_phase, "rad")}};
    } else if (id == "encoder_offset") {
      j.encoder_offset = (stronger ? 1 : -1) * d.x * 0.05;
      row = {{"offset", d.Value(i, j.encoder_offset, "rad")}};
    } else if (id == "rotor_inertia") {
      j.armature = d.x * d.s.inertia[i] * (0.2 + factor);
      row = {{"armature", d.Value(i, j.armature, "kg*m^2")}};
    } else {  // position_spring
      j.spring_stiffness =
          d.x * 0.8 * (0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i]) / std::max(0.05, d.s.amplitude[i]);
      j.spring_center = d.s.home[i] + d.rng.Uniform(-0.5, 0.5) * d.s.amplitude[i];
      row = {{"stiffness", d.Value(i, j.spring_stiffness, "N*m/rad")},
             {"cubic", d.Value(i, 0, "N*m/rad^3")},
             {"center", d.Value(i, j.spring_center, "rad")}};
    }
  }
}

void Body(const std::string& id, Draft& d) {
  d.on_joints = false;
  Truth& t = *d.truth;
  if (id == "payload") {
    t.payload_mass = d.x * 0.15 * d.s.last_mass * d.rng.Uniform(0.6, 1.4);
    for (int k = 0; k < 3; ++k)
      t.payload_com[k] =
          d.rng.Uniform(0.6, 1.2) * d.s.tool[static_cast<size_t>(k)] + d.rng.Uniform(-0.03, 0.03);
    d.parameters["*"] = {{"mass", Value(t.payload_mass, "kg")},
                         {"com_x", Value(t.payload_com[0], "m")},
                         {"com_y", Value(t.payload_com[1], "m")},
                         {"com_z", Value(t.payload_com[2], "m")}};
    d.equivalents = {"parameters_only"};  // a payload is a change of the last link
  } else if (id == "gravity_misalignment") {
    t.tilt = d.x * 0.05 * d.rng.Uniform(0.7, 1.4);
    t.azimuth = d.rng.Uniform(-3.1, 3.1);
    d.parameters["*"] = {{"tilt", Value(t.tilt, "rad")}, {"azimuth", Value(t.azimuth, "rad")}};
  } else if (id == "external_disturbance") {
    const int i = static_cast<int>(d.rng.Index(d.s.joints.size()));
    t.disturbed = i;
    t.disturbance =
        (d.rng.Uniform() < 0.5 ? -1 : 1) * d.x * 0.8 * (0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i]);
    t.disturbance_start = d.s.duration_s * d.rng.Uniform(0.25, 0.45);
    t.disturbance_end = t.disturbance_start + d.rng.Uniform(0.8, 1.8);
    d.joints = {i};
    d.on_joints = true;
    d.parameters["*"] = {{"start", Value(t.disturbance_start, "s")},
                         {"end", Value(t.disturbance_end, "s")},
                         {"torque", d.Value(i, t.disturbance, "N*m")}};
  } else if (id == "contact") {
    t.contact_height = d.s.tip_low + (d.s.tip_high - d.s.tip_low) * d.rng.Uniform(0.2, 0.4);
    t.contact_stiffness =
        d.x * 20 * d.s.motion_torque.maxCoeff() / std::max(0.05, d.s.tip_high - d.s.tip_low);
    t.contact_damping = 0.02 * t.contact_stiffness;
    d.parameters["*"] = {{"stiffness", Value(t.contact_stiffness, "N/m")},
                         {"damping", Value(t.contact_damping, "N*s/m")},
                         {"height", Value(t.contact_height, "m")}};
  } else if (id == "base_flexibility") {
    t.base_stiffness = d.s.torque.maxCoeff() * 12 / std::max(0.05, d.x);
    t.base_damping = 0.01 * t.base_stiffness;
    d.parameters["*"] = {{"stiffness", Value(t.base_stiffness, "N*m/rad")},
                         {"damping", Value(t.base_damping, "N*m*s/rad")}};
  } else {  // sloshing_payload
    t.slosh_mass = d.x * 0.2 * d.s.last_mass;
    t.slosh_length = d.rng.Uniform(0.05, 0.12);
    d.parameters["*"] = {{"mass", Value(t.slosh_mass, "kg")}, {"length", Value(t.slosh_length, "m")}};
  }
}

void Parameters(Draft& d) {
  d.on_joints = false;
  json links = json::object();
  for (const std::string& link : d.s.links) {
    LinkChange& change = d.truth->links[link];
    const double size = std::min(0.35, 0.13 * d.x);
    change.mass_factor = 1 + size * d.rng.Uniform(-1, 1);
    change.inertia_factor = 1 + size * d.rng.Uniform(-1, 1);
    for (double& c : change.com_shift) c = 0.03 * size * d.rng.Uniform(-1, 1);
    links[link] = {{"mass_factor", change.mass_factor}, {"inertia_factor", change.inertia_factor}};
  }
  d.parameters["*"] = {{"links", {{"value", links}}}};
}

void UnknownField(Draft& d) {
  const int n = static_cast<int>(d.s.joints.size());
  Field& f = d.truth->field;
  const std::vector<std::string> forms = FieldForms(n);
  f.form = forms[d.rng.Index(forms.size())];
  f.on = static_cast<int>(d.rng.Index(static_cast<uint64_t>(n)));
  f.over[0] = f.over[1] = f.on;
  const bool pair = n > 1 && (f.form == "wave" || f.form == "saddle" || f.form == "cross_speed" ||
                              (f.form == "bump" && d.rng.Uniform() < 0.6));
  if (pair) f.over[1] = (f.on + 1) % n;
  f.amplitude = d.x * 0.9 * (0.3 * d.s.torque[f.on] + 0.7 * d.s.motion_torque[f.on]);
  const bool narrow = f.form == "wave", broad = f.form == "cross_speed" || f.form == "wind";
  for (int k = 0; k < 2; ++k) {
    f.center[k] = d.s.home[f.over[k]] + d.rng.Uniform(-0.4, 0.4) * d.s.amplitude[f.over[k]];
    f.width[k] = d.s.amplitude[f.over[k]] * (narrow  ? d.rng.Uniform(0.15, 0.3)
                                             : broad ? d.rng.Uniform(0.3, 0.6)
                                                     : d.rng.Uniform(0.4, 0.7));
  }
  if (f.form == "detent") f.width[0] *= 0.5;
  f.speed = d.s.velocity[f.form == "cross_speed" ? f.over[1] : f.on] *
            (f.form == "speed_bump" ? d.rng.Uniform(0.9, 1.4) : 1.0);
  f.speed_width = f.speed * d.rng.Uniform(0.2, 0.35);
  f.direction = static_cast<int>(d.rng.Index(3)) - 1;
  f.period = d.rng.Uniform(1.2, 3.0);
  d.joints = {f.on};
  if (pair) d.joints.push_back(f.over[1]);
  d.parameters["*"] = {{"form", {{"value", f.form}}}, {"amplitude", d.Value(f.on, f.amplitude, "N*m")}};
}

}  // namespace

const std::vector<std::string>& KnownEffects() {
  static const std::vector<std::string> ids = {"none",
                                               "parameters_only",
                                               "viscous_friction",
                                               "coulomb_friction",
                                               "stribeck_friction",
                                               "asymmetric_friction",
                                               "load_dependent_friction",
                                               "quadratic_drag",
                                               "presliding_hysteresis",
                                               "joint_elasticity",
                                               "backlash",
                                               "actuator_delay",
                                               "actuator_lag",
                                               "torque_gain",
                                               "torque_deadband",
                                               "torque_saturation",
                                               "torque_offset",
                                               "torque_ripple",
                                               "rotor_inertia",
                                               "payload",
                                               "gravity_misalignment",
                                               "encoder_offset",
                                               "sensor_delay",
                                               "position_spring",
                                               "thermal_drift",
                                               "external_disturbance",
                                               "contact",
                                               "joint_coupling",
                                               "base_flexibility",
                                               "sloshing_payload",
                                               "unknown_field"};
  return ids;
}

StrengthRange StrengthsOf(const std::vector<std::string>& effects) {
  const bool springy = std::any_of(effects.begin(), effects.end(), [](const std::string& id) {
    return OneOf(id, {"joint_elasticity", "backlash"});
  });
  return springy ? StrengthRange{0.3, 3} : StrengthRange{0.01, 8};
}

json UnitValue(double value, std::string unit, bool prismatic) {
  if (prismatic) {
    for (const auto& [angular, linear] :
         {std::pair<std::string, std::string>{"N*m", "N"}, {"rad", "m"}, {"kg*m^2", "kg"}}) {
      if (const size_t at = unit.find(angular); at != std::string::npos)
        unit.replace(at, angular.size(), linear);
    }
  }
  return {{"value", value}, {"unit", unit}};
}

json AddEffect(const std::string& id, double strength, const Scales& scales, Rng rng, Truth* truth) {
  Draft draft{scales, rng, strength, truth, json::object(), {}, true, {}, {}};
  if (OneOf(id,
            {"viscous_friction", "quadratic_drag", "coulomb_friction", "stribeck_friction",
             "asymmetric_friction", "load_dependent_friction", "presliding_hysteresis", "thermal_drift"})) {
    Friction(id, draft);
  } else if (id == "joint_coupling") {
    Coupling(draft);
  } else if (OneOf(id, {"joint_elasticity", "backlash"})) {
    SpringyTransmission(id, draft);
  } else if (OneOf(id, {"payload", "gravity_misalignment", "external_disturbance", "contact",
                        "base_flexibility", "sloshing_payload"})) {
    Body(id, draft);
  } else if (id == "parameters_only") {
    Parameters(draft);
  } else if (id == "unknown_field") {
    UnknownField(draft);
  } else {
    RG_CHECK(std::find(KnownEffects().begin(), KnownEffects().end(), id) != KnownEffects().end()) << id;
    Actuator(id, draft);
  }
  json joints = json::array();
  for (int i : draft.joints) joints.push_back(scales.joints[static_cast<size_t>(i)]);
  return {{"id", id},
          {"joints", joints},
          {"localisation", draft.on_joints ? "joints" : "global"},
          {"parameters", draft.parameters},
          {"also_acceptable", draft.acceptable},
          {"equivalents", draft.equivalents}};
}

}  // namespace rg::proof
