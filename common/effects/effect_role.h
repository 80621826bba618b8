// Where an effect enters the simulation. Each role has one hook, which the effect implements as a
// static template over the scalar S (double or Dual), so that value and derivative share one text.
#pragma once

namespace rg::effects {

enum class Role {
  // Apply(const S* p, JointLaw<S>& law): on the way from command to joint force (joint_law.h).
  // With kStates > 0 and kStateNames: internal states law.z0 → law.z1.
  kJointLaw,
  // p[0] shifts the command's time: u(t − p[0]).
  kCommandDelay,
  // AddInertia(const S* p, S* phi): adds to the ten barycentric parameters of the last body, taken in the
  // frame of the child link of the last joint: m, m·c (3), I_xx, I_xy, I_xz, I_yy, I_yz, I_zz about the
  // link's origin.
  kBodyInertia,
  // Turn(const S* p, S* g): turns the gravity vector (3, base frame).
  kGravity,
  // With joints as kJointLaw; without: PointForce(...) adds a force (3, N) on the origin of the
  // end-effector link, base frame, from that point's position and velocity.
  kJointOrPointForce,
  // Measure(const S* p, S* q): what the sensor makes of a joint position.
  kSensorOffset,
  // p[0] makes the measured state old: q(t − p[0]), v(t − p[0]).
  kSensorDelay,
  // Adds bodies to the tree, see sim/plant_data.h; Apply acts on each of their joints.
  kExtraBodies,
};

}  // namespace rg::effects
