// All effects as types, in the order of EFFECTS.md. To add one: its file, and its line here (twice: the
// include and the list). An effect's place in the list is its number in a running program only; files
// store ids.
#pragma once

#include "common/effects/actuator_delay.h"
#include "common/effects/actuator_lag.h"
#include "common/effects/asymmetric_friction.h"
#include "common/effects/backlash.h"
#include "common/effects/base_flexibility.h"
#include "common/effects/contact.h"
#include "common/effects/coulomb_friction.h"
#include "common/effects/encoder_offset.h"
#include "common/effects/external_disturbance.h"
#include "common/effects/gravity_misalignment.h"
#include "common/effects/joint_coupling.h"
#include "common/effects/joint_elasticity.h"
#include "common/effects/load_dependent_friction.h"
#include "common/effects/payload.h"
#include "common/effects/position_spring.h"
#include "common/effects/presliding_hysteresis.h"
#include "common/effects/quadratic_drag.h"
#include "common/effects/rotor_inertia.h"
#include "common/effects/sensor_delay.h"
#include "common/effects/sloshing_payload.h"
#include "common/effects/stribeck_friction.h"
#include "common/effects/thermal_drift.h"
#include "common/effects/torque_deadband.h"
#include "common/effects/torque_gain.h"
#include "common/effects/torque_offset.h"
#include "common/effects/torque_ripple.h"
#include "common/effects/torque_saturation.h"
#include "common/effects/unknown_field.h"
#include "common/effects/unknown_field_pair.h"
#include "common/effects/viscous_friction.h"

namespace rg::effects {
inline namespace RG_ISA {

template <class... E>
struct TypeList {
  static constexpr int kSize = sizeof...(E);
};

using EffectList =
    TypeList<ViscousFriction, CoulombFriction, StribeckFriction, AsymmetricFriction, LoadDependentFriction,
             QuadraticDrag, PreslidingHysteresis, JointElasticity, Backlash, ActuatorDelay, ActuatorLag,
             TorqueGain, TorqueDeadband, TorqueSaturation, TorqueOffset, TorqueRipple, RotorInertia, Payload,
             GravityMisalignment, EncoderOffset, SensorDelay, PositionSpring, ThermalDrift,
             ExternalDisturbance, Contact, JointCoupling, BaseFlexibility, SloshingPayload, UnknownField,
             UnknownFieldPair>;

// Calls f.template operator()<E>() for the effect type with this number.
template <class F, class... E>
RG_INLINE void WithEffectType(int kind, TypeList<E...>, F&& f) {
  int number = 0;
  (void)((number++ == kind ? (f.template operator()<E>(), true) : false) || ...);
}
template <class F>
RG_INLINE void WithEffectType(int kind, F&& f) {
  WithEffectType(kind, EffectList{}, f);
}

// Number of internal states per joint.
template <class E>
constexpr int StatesOf() {
  if constexpr (requires { E::kStates; }) {
    return E::kStates;
  } else {
    return 0;
  }
}

}  // namespace RG_ISA
}  // namespace rg::effects
