// The generator's own reality: which physics a proof case has, in plain figures. Deliberately shares
// nothing with common/effects: it is the other side of the examination.
#pragma once

#include <algorithm>
#include <initializer_list>
#include <limits>
#include <map>
#include <string>
#include <vector>

namespace rg::proof {

// Whether an effect is one of these.
inline bool OneOf(const std::string& effect, std::initializer_list<const char*> effects) {
  return std::any_of(effects.begin(), effects.end(), [&](const char* e) { return effect == e; });
}

struct DryFriction {                                  // level as a function of speed, direction, load, time
  double coulomb_positive = 0, coulomb_negative = 0;  // N·m, kinetic level in each direction
  double static_extra = 0, stribeck_velocity = 1;     // level at rest = kinetic + extra, Gaussian in v
  double load_coefficient = 0;                        // grows with |drive torque|
  double thermal_extra = 0, thermal_time = 1;         // extra · exp(−t/T)
  bool any() const {
    return coulomb_positive > 0 || coulomb_negative > 0 || static_extra > 0 || load_coefficient > 0 ||
           thermal_extra > 0;
  }
};

struct Bristle {
  double stiffness = 0, damping = 0, coulomb = 0;
};

// A motor behind a spring, with a gap (0: elasticity).
struct Transmission {
  double stiffness = 0, damping = 0, motor_inertia = 0, gap = 0;
  bool sensor_on_motor = false;
};

struct JointTruth {
  double viscous = 0, quadratic = 0, armature = 0;
  DryFriction dry;
  Bristle bristle;
  Transmission transmission;
  double delay = 0, lag = 0, gain = 1, deadband = 0, torque_offset = 0;
  double saturation = std::numeric_limits<double>::infinity();
  double ripple_amplitude = 0, ripple_cycles = 0, ripple_phase = 0;
  double encoder_offset = 0, sensor_delay = 0;
  double spring_stiffness = 0, spring_cubic = 0, spring_center = 0;
};

// Structured force that no row of the catalogue makes (fields.h has the laws).
struct Field {
  std::string form;
  int on = -1;                                   // the joint it acts on
  int over[2] = {0, 0};                          // joints whose positions it depends on; both the same: one
  double amplitude = 0;                          // N·m or N
  double center[2] = {0, 0}, width[2] = {1, 1};  // of these positions
  double speed = 1, speed_width = 1;             // scale or peak of a speed, rad/s or m/s
  int direction = 0;                             // of a speed: both, or that of its sign
  double period = 1;                             // s
};

struct LinkChange {
  double mass_factor = 1, inertia_factor = 1;
  double com_shift[3] = {0, 0, 0};
};

struct Truth {
  std::vector<JointTruth> joint;
  std::map<std::string, LinkChange> links;
  double payload_mass = 0, payload_com[3] = {0, 0, 0};
  double tilt = 0, azimuth = 0;
  int coupling_from = -1, coupling_to = -1;
  double coupling = 0;
  int disturbed = -1;
  double disturbance = 0, disturbance_start = 0, disturbance_end = 0;
  double contact_stiffness = 0, contact_damping = 0, contact_height = -1e9;
  double base_stiffness = 0, base_damping = 0;
  double slosh_mass = 0, slosh_length = 0;
  Field field;
};

}  // namespace rg::proof
