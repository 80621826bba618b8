#include "services/proof/generator/hypotheses.h"

#include <algorithm>
#include <cmath>

#include "common/base/check.h"

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
      row = {{"viscous", Value(j.viscous, "N*m*s/rad")}};
    } else if (id == "quadratic_drag") {
      j.quadratic = level / (speed * speed);
      row = {{"quadratic", Value(j.quadratic, "N*m*s^2/rad^2")}};
    } else if (id == "coulomb_friction") {
      j.dry.coulomb_positive = j.dry.coulomb_negative = level;
      row = {{"coulomb", Value(level, "N*m")}};
    } else if (id == "stribeck_friction") {
      j.dry.coulomb_positive = j.dry.coulomb_negative = 0.7 * level;
      j.dry.static_extra = level * d.rng.Uniform(0.5, 0.9);
      j.dry.stribeck_velocity = speed * d.rng.Uniform(0.15, 0.4);
      row = {{"coulomb", Value(0.7 * level, "N*m")},
             {"static", Value(0.7 * level + j.dry.static_extra, "N*m")},
             {"stribeck_velocity", Value(j.dry.stribeck_velocity, "rad/s")}};
    } else if (id == "asymmetric_friction") {
      j.dry.coulomb_positive = level * d.rng.Uniform(1.0, 1.4);
      j.dry.coulomb_negative = level * d.rng.Uniform(0.3, 0.6);
      if (d.rng.Uniform() < 0.5) std::swap(j.dry.coulomb_positive, j.dry.coulomb_negative);
      row = {{"coulomb_positive", Value(j.dry.coulomb_positive, "N*m")},
             {"coulomb_negative", Value(j.dry.coulomb_negative, "N*m")}};
    } else if (id == "load_dependent_friction") {
      j.dry.coulomb_positive = j.dry.coulomb_negative = 0.15 * level;
      j.dry.load_coefficient = std::min(0.6, 0.8 * level / std::max(1e-6, d.s.torque[i]));
      row = {{"coulomb", Value(0.15 * level, "N*m")},
             {"load_coefficient", Value(j.dry.load_coefficient, "1")}};
    } else if (id == "presliding_hysteresis") {
      j.bristle.coulomb = level;
      j.bristle.stiffness = level / d.rng.Uniform(0.02, 0.06);
      j.bristle.damping = 0.2 * std::sqrt(j.bristle.stiffness * d.s.inertia[i]);
      row = {{"coulomb", Value(level, "N*m")}, {"bristle_stiffness", Value(j.bristle.stiffness, "N*m/rad")}};
    } else {  // thermal_drift
      const double last = level * d.rng.Uniform(0.3, 0.5);
      j.dry.coulomb_positive = j.dry.coulomb_negative = last;
      j.dry.thermal_extra = 1.2 * level;
      j.dry.thermal_time = d.s.duration_s * d.rng.Uniform(0.2, 0.5);
      row = {{"initial", Value(last + j.dry.thermal_extra, "N*m")},
             {"final", Value(last, "N*m")},
             {"time_constant", Value(j.dry.thermal_time, "s")}};
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

void SpringyTransmission(const std::string& id, Draft& d) {
  const int i = static_cast<int>(d.rng.Index(d.s.joints.size()));
  Transmission& t = d.Joint(i).transmission;
  const double inertia = d.s.inertia[i];
  const double resonance = 6.283 * d.LogUniform(4, 9) / std::sqrt(std::max(0.05, d.x));
  t.motor_inertia = inertia * d.rng.Uniform(0.25, 0.6);
  t.sensor_on_motor = d.rng.Uniform() < 0.5;
  json& row = d.Row(i);
  if (id == "joint_elasticity") {
    t.stiffness = resonance * resonance * inertia;
    t.damping = 0.1 * std::sqrt(t.stiffness * inertia);
    row = {{"stiffness", Value(t.stiffness, "N*m/rad")}, {"damping", Value(t.damping, "N*m*s/rad")}};
  } else {
    t.gap = 0.03 * d.x * d.rng.Uniform(0.7, 1.6);
    t.stiffness = 6.283 * 6.283 * 400 * inertia;
    t.damping = 0.4 * std::sqrt(t.stiffness * inertia);
    row = {{"gap", Value(t.gap, "rad")},
           {"contact_stiffness", Value(t.stiffness, "N*m/rad")},
           {"contact_damping", Value(t.damping, "N*m*s/rad")}};
  }
  row["motor_inertia"] = Value(t.motor_inertia, "kg*m^2");
  row["sensor_side"] = {{"value", t.sensor_on_motor ? "motor" : "link"}};
  d.joints = {i};
  d.acceptable = {"rotor_inertia", "viscous_friction"};
}

void Actuator(const std::string& id, Draft& d) {
  const int n = static_cast<int>(d.s.joints.size());
  d.joints = DrawJoints(n, id == "actuator_delay" || id == "actuator_lag" || id == "sensor_delay", d.rng);
  const double seconds = d.x * d.LogUniform(0.012, 0.04), factor = d.rng.Uniform(0.1, 0.25);
  const bool stronger = d.rng.Uniform() < 0.5;
  for (int i : d.joints) {
    JointTruth& j = d.Joint(i);
    json& row = d.Row(i);
    if (id == "actuator_delay") {
      j.delay = std::min(0.2, seconds);
      row = {{"delay", Value(j.delay, "s")}};
    } else if (id == "sensor_delay") {
      j.sensor_delay = std::min(0.2, seconds);
      row = {{"delay", Value(j.sensor_delay, "s")}};
    } else if (id == "actuator_lag") {
      j.lag = std::min(0.3, seconds);
      row = {{"time_constant", Value(j.lag, "s")}};
    } else if (id == "torque_gain") {
      j.gain = 1 + (stronger ? 1 : -1) * std::min(0.6, d.x * factor);
      row = {{"gain", Value(j.gain, "1")}};
    } else if (id == "torque_deadband") {
      j.deadband = d.x * 0.5 * (0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i]);
      row = {{"deadband", Value(j.deadband, "N*m")}};
    } else if (id == "torque_saturation") {
      j.saturation = d.s.torque[i] * (0.6 + 1.1 / (1.0 + d.x));
      row = {{"limit", Value(j.saturation, "N*m")}};
    } else if (id == "torque_ripple") {
      j.ripple_amplitude = d.x * 0.5 * (0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i]);
      j.ripple_cycles = 4 + static_cast<double>(d.rng.Index(14));
      j.ripple_phase = d.rng.Uniform(-3, 3);
      row = {{"amplitude", Value(j.ripple_amplitude, "N*m")},
             {"cycles_per_rev", Value(j.ripple_cycles, "1")},
             {"phase", Value(j.ripple_phase, "rad")}};
    } else if (id == "encoder_offset") {
      j.encoder_offset = (stronger ? 1 : -1) * d.x * 0.05;
      row = {{"offset", Value(j.encoder_offset, "rad")}};
    } else if (id == "rotor_inertia") {
      j.armature = d.x * d.s.inertia[i] * (0.2 + factor);
      row = {{"armature", Value(j.armature, "kg*m^2")}};
    } else {  // position_spring
      j.spring_stiffness =
          d.x * 0.8 * (0.3 * d.s.torque[i] + 0.7 * d.s.motion_torque[i]) / std::max(0.05, d.s.amplitude[i]);
      j.spring_center = d.s.home[i] + d.rng.Uniform(-0.5, 0.5) * d.s.amplitude[i];
      row = {{"stiffness", Value(j.spring_stiffness, "N*m/rad")},
             {"cubic", Value(0, "N*m/rad^3")},
             {"center", Value(j.spring_center, "rad")}};
    }
  }
  if (n == 1 && (id == "rotor_inertia" || id == "torque_gain"))
    d.equivalents = {"rotor_inertia", "torque_gain", "parameters_only"};
}

void Body(const std::string& id, Draft& d) {
  d.on_joints = false;
  Truth& t = *d.truth;
  if (id == "payload") {
    t.payload_mass = d.x * 0.15 * d.s.last_mass * d.rng.Uniform(0.6, 1.4);
    for (double& c : t.payload_com) c = d.rng.Uniform(-0.03, 0.03);
    t.payload_com[2] = -0.1;
    d.parameters["*"] = {{"mass", Value(t.payload_mass, "kg")},
                         {"com_x", Value(t.payload_com[0], "m")},
                         {"com_y", Value(t.payload_com[1], "m")},
                         {"com_z", Value(t.payload_com[2], "m")}};
    d.equivalents = {"parameters_only"};
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
                         {"torque", Value(t.disturbance, "N*m")}};
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
  f.on = static_cast<int>(d.rng.Index(static_cast<uint64_t>(n)));
  f.over[0] = f.on;
  f.over[1] = n == 1 ? f.on : (f.on + 1) % n;
  f.form = d.rng.Uniform() < 0.6 ? "bump" : "wave";
  f.amplitude = d.x * 0.9 * (0.3 * d.s.torque[f.on] + 0.7 * d.s.motion_torque[f.on]);
  for (int k = 0; k < 2; ++k) {
    f.center[k] = d.s.home[f.over[k]] + d.rng.Uniform(-0.4, 0.4) * d.s.amplitude[f.over[k]];
    f.width[k] =
        d.s.amplitude[f.over[k]] * (f.form == "bump" ? d.rng.Uniform(0.4, 0.7) : d.rng.Uniform(0.15, 0.3));
  }
  d.joints = {f.on};
  if (f.over[1] != f.on) d.joints.push_back(f.over[1]);
  d.parameters["*"] = {{"form", {{"value", f.form}}}, {"amplitude", Value(f.amplitude, "N*m")}};
}

bool OneOf(const std::string& id, std::initializer_list<const char*> ids) {
  return std::any_of(ids.begin(), ids.end(), [&](const char* x) { return id == x; });
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
