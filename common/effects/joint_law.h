// The scalar law of one joint over one step: which average force F̄ acts on it, given that its velocity
// goes from v0 to v1 while the step lasts. Effects of the actuator, transmission and joint stages each
// contribute to this record, in the order of Phase; Force() adds it up. The step solver finds the v1 of
// all joints at once (integrators/velocity_step.h): since F̄ falls with v1 (friction is monotone), the
// solution is unique, and stiff laws need no small step.
//
// Weights. A force that is smooth over the step is taken at  v_θ = v0 + θ·(v1 − v0)  with
//   θ(x) = 1/2 + x/(12 + 2x),  x = h·(stiffness of the law)/(inertia)   in [1/2, 1)
// which is the exponentially fitted weight 1/(1−e^{−x}) − 1/x to third order: the midpoint (second
// order) while the step resolves the law, backward Euler (no ringing) where it does not. Inertia here
// is a constant of the joint, so that derivatives stay exact; it decides accuracy, not stability.
//
// Sign functions (Coulomb) change sign inside a step: see SignForce().
#pragma once

#include "common/effects/dual.h"

namespace rg::effects {
inline namespace RG_ISA {

// Order in which effects act on the torque that flows from the command to the link.
enum class Phase {
  kGain,
  kDeadband,
  kSaturation,
  kCommand,  // what a lag follows as it does the command
  kLag,
  kRipple,
  kCoupling,
  kTransmission,
  kJoint,
  kLoad,      // friction that depends on the transmitted torque, known only now
  kNotLocal,  // acts elsewhere: command timing, body, sensor, environment
};

template <class T>
struct StepContext {
  T h;                // step [s]; 0 for an instantaneous force (explicit integrators)
  T t;                // time at the step's begin [s]
  bool first_order;   // all weights 1 (semi-implicit Euler)
  double sign_width;  // half width of the ramp that stands for the jump of sign(v) [rad/s]
};

template <class S>
struct JointLaw {
  using T = Base<S>;

  // Given.
  StepContext<T> step;
  T mass;             // inertia the joint's force sees now, 1/(M⁻¹)_ii [kg·m²]; no derivative is taken
  T reference_mass;   // a constant of the same kind
  S q0, q1, v0, v1;   // position and velocity at begin and end of the step
  S acceleration;     // (v1 − v0)/h
  S coupled{};        // drive torque of the joint that is coupled to this one, before its own coupling, or
                      // position of the joint that this one sees, predicted for the step's middle
  bool rough = true;  // whether any friction level may differ from zero
  const S* z0;        // internal states of the effect at work at the step's begin …
  S* z1;              // … and, written by it, at its end

  int option = 0;  // of the effect at work: index into the values of its only option

  // Written by the effects, from what the joint itself has.
  S drive{};      // torque of the actuator; starts as force_gain · command
  S link{};       // torque that reaches the link; the transmission's output (drive where it is rigid)
  S force{};      // further forces on the joint
  S viscous{};    // Σ damping coefficients
  S quadratic{};  // Σ coefficients of v|v|
  S level_positive{}, level_negative{};  // Σ friction levels for v > 0, for v < 0, each ≥ 0
  S inertia{};                           // Σ reflected inertia

  // Weight for a law that relaxes at rate·h = x.
  RG_INLINE S Weight(const S& x) const {
    if (step.first_order) return S(T(1));
    const S y = Select(x > T(0), x, S(T(0)));
    return T(0.5) + y / (T(12) + T(2) * y);
  }
  // Weight for a law that oscillates, x = (h·ω)²: damps only what the step cannot resolve.
  S OscillationWeight(const S& x) const {
    if (step.first_order) return S(T(1));
    const S y = x * x;
    return T(0.5) + T(0.5) * y / (T(16) + y);
  }
  RG_INLINE S VelocityAt(const S& theta) const { return v0 + theta * (v1 - v0); }
  S PositionAt(const S& theta) const { return q0 + theta * (q1 - q0); }

  S Force() const {
    return rough ? SmoothForce() + SignForce(level_positive, level_negative) : SmoothForce();
  }

  // All but the friction levels.
  RG_INLINE S SmoothForce() const { return link + force - SmoothFriction() - inertia * acceleration; }

  // d·v + b·v|v| at the weighted velocity.
  RG_INLINE S SmoothFriction() const {
    const S stiffness = viscous + T(2) * quadratic * Abs(v0);
    const S v = VelocityAt(Weight(stiffness * (step.h / reference_mass)));
    return (viscous + quadratic * Abs(v)) * v;
  }

  // −c₊ for v > 0, +c₋ for v < 0, anything between at rest, averaged over the step.
  //
  // Where v changes sign inside the step the average is that of the exact motion under constant other
  // forces: with α the fraction of time before the reversal (v0 > 0 > v1) and s = mass/h,
  //   F̄ = c₋ − C·α,   C·α² − (C + s(v0 − v1))·α + s·v0 = 0,   C = c₊ + c₋.
  // At v1 = 0 all values from −c₊ to c₋ − C·min(1, s·v0/C) are taken (the joint sticks from there on):
  // a ramp of half width sign_width stands for that jump, so a joint at rest under load creeps by less
  // than sign_width. Monotone in v1. Without the averaging a reversal would cost a velocity error of
  // order c·h/mass, first order in h.
  S SignForce(const S& positive, const S& negative) const {
    if (!All(step.h > T(0))) {  // instantaneous, smooth
      const S x = v1 / Sqrt(v1 * v1 + T(step.sign_width * step.sign_width));
      return Select(x > T(0), -(positive * x), -(negative * x));
    }
    const T width = T(step.sign_width);
    // All slide on in their direction: no need to look further.
    const auto forward = And(v1 > width, Not(v0 < T(0))), backward = And(v1 < -width, Not(v0 > T(0)));
    if (All(Or(forward, backward))) return Select(forward, -positive, negative);
    const S above = SignForceAbove(positive, negative);  // at v1 ≥ width, or at +width inside the ramp
    const S below = -SignForceMirrored(positive, negative);
    const S ramp = T(0.5) * (above + below) + (above - below) * (v1 * (T(0.5) / width));
    return Select(v1 > width, above, Select(v1 < -width, below, ramp));
  }

 private:
  // Average force when the step ends at v1 ≥ 0 (v1 clipped to it).
  S SignForceAbove(const S& positive, const S& negative) const {
    return Select(v0 < T(0), -positive + Crossing(-v0, -v1, negative + positive), -positive);
  }
  S SignForceMirrored(const S& positive, const S& negative) const {
    return Select(v0 > T(0), -negative + Crossing(v0, v1, negative + positive), -negative);
  }
  // C·α for a start at a > 0 that ends at b ≤ 0 (clipped).
  S Crossing(const S& a, const S& b, const S& total) const {
    if (step.first_order) return S(T(0));
    const T s = mass / step.h;
    const S end = Select(b < T(0), b, S(T(0)));
    const S B = total + s * (a - end);
    const S disc = B * B - T(4) * s * total * a;
    const S root = Sqrt(Select(disc > T(0), disc, S(T(0))));
    return total * (T(2) * s) * a / (B + root + T(1e-300));
  }
};

// A linear spring towards q = 0 with a damper.
template <class S>
void SpringAndDamper(const S& stiffness, const S& damping, JointLaw<S>& law) {
  const S weight = law.OscillationWeight(stiffness * (law.step.h * law.step.h / law.reference_mass));
  law.force -= stiffness * law.PositionAt(weight);
  law.viscous += damping;
}

}  // namespace RG_ISA
}  // namespace rg::effects
