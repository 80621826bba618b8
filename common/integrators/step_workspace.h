// Scratch of the step kernels for up to C joints, and the pieces every integrator is made of.
#pragma once

#include "common/dynamics/kernels.h"
#include "common/integrators/joint_laws.h"
#include "common/integrators/small_linear.h"
#include "common/integrators/step_program.h"

namespace rg::integrators {
inline namespace RG_ISA {

template <int C>
struct StepWorkspace {
  dynamics::KernelWorkspace<double, C> w;
  dynamics::Inertias<double, C> inertias;

  // Set by Prepare from program and values.
  bool rough[C];  // whether the joint has friction levels
  bool any_rough;
  double armature[C];  // rotor inertia at the joint
  double mass[C];      // inertia a joint's force sees, for reversals

  // Of the step being taken.
  alignas(64) double bias[C];  // c(q, v, g) less the point forces
  double force[C], slope[C];   // joint laws at the current v1
  double trial_force[C], trial_slope[C];
  double v1[C], mean[C], half[C], before[C];
  double z1[C * 4];
  alignas(64) double H[C * C];
  double diagonal[C];

  // Point forces: generalised force and its derivatives, row-major.
  double E[C], E_q[C * C], E_v[C * C], E_p[kMaxPointForces * kMaxPointParameters][C];

  // For sensitivities.
  LawGradients gradients;
  alignas(64) double B_q[C * C], B_v[C * C];
};

// Inertias and constants from the values; whenever program or values change.
template <int C>
void Prepare(const StepProgram& program, const StepValues& values, StepWorkspace<C>& s) {
  const int n = program.tree.n;
  for (int k = 0; k < n; ++k) s.inertias.Set(k, values.phi[k]);
  s.any_rough = false;
  for (int i = 0; i < n; ++i) {
    const JointProgram& joint = program.joints[i];
    const double* p = values.joint_parameters + joint.first_parameter;
    // What the ops write at rest tells whether they are friction and how much inertia they add.
    JointLaw<double> law;
    law.step = {1e-3, 0.0, false, values.stick_velocity};
    law.mass = law.reference_mass = values.reference_mass[i];
    law.q0 = law.q1 = law.v0 = law.v1 = law.acceleration = 0.0;
    law.level_positive = law.level_negative = 0.0;
    double z0[kMaxLocals] = {}, z1[kMaxLocals];
    RunOps(program, joint.first_op, joint.first_op + joint.num_ops, p, z0, z1, law);
    bool friction_op = false;
    for (int k = joint.first_op; k < joint.first_op + joint.num_ops; ++k) {
      effects::WithEffectType(program.ops[k].kind, [&]<class E>() {
        if constexpr (requires { E::kFriction; }) friction_op = true;
      });
    }
    s.armature[i] = law.inertia;
    s.rough[i] = friction_op || p[kFriction] != 0.0;
    s.mass[i] = values.reference_mass[i];
    s.any_rough |= s.rough[i];
  }
}

// Generalised force of the point forces at the workspace's kinematics and velocity v, averaged over
// [begin, end], with derivatives where `derivatives`.
template <int C>
void PointForces(const StepProgram& program, const StepValues& values, const double* v, double begin,
                 double end, bool derivatives, StepWorkspace<C>& s);

inline constexpr double kHeld = 1e9;  // a joint with so many times its inertia does not move

// w.M into H's lower triangle, scaled.
template <int C>
RG_INLINE void LoadMass(int n, double scale, const StepWorkspace<C>& s, double* H) {
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j <= i; ++j) H[i * C + j] = s.w.M[j][i] * scale;
  }
}

// The inertia each joint's force sees, link plus rotor, joints that stick held: 1/(M⁻¹)_ii over the joints
// that move. Also checks that M is positive definite: returns the row that is not, or −1.
template <int C>
RG_INLINE int UpdateEffectiveInertias(int n, const double* v, double stick_velocity, StepWorkspace<C>& s) {
  LoadMass(n, 1.0, s, s.H);
  for (int i = 0; i < n; ++i) {
    s.H[i * C + i] += s.armature[i];
    s.mass[i] = s.H[i * C + i];
    if (s.rough[i] && __builtin_fabs(v[i]) <= stick_velocity) s.H[i * C + i] *= kHeld;
  }
  const int bad = Cholesky<C>(n, s.H, s.diagonal);
  if (bad >= 0) return bad;
  if (s.any_rough) {
    double seen[C];
    EffectiveInertias<C>(n, s.H, s.diagonal, seen);
    for (int i = 0; i < n; ++i) {
      if (!(s.rough[i] && __builtin_fabs(v[i]) <= stick_velocity)) s.mass[i] = seen[i];
    }
  }
  return -1;
}

// w.M and, from w.sum, the composite inertias, after Kinematics.
template <int C>
RG_INLINE void MassMatrixHere(const dynamics::Tree& tree, StepWorkspace<C>& s) {
  dynamics::BodyInertias(tree, s.inertias, s.w);
  dynamics::kernel::SumInward(tree, dynamics::kernel::Rows(s.w.sum), 10);
  dynamics::CompositeForces(tree, s.w);
  dynamics::MassMatrix(tree, s.w);
}

// w.c at velocity v, after Kinematics; leaves the composites that Derivatives needs.
template <int C>
RG_INLINE void BiasHere(const dynamics::Tree& tree, const double* gravity, const double* v,
                        StepWorkspace<C>& s) {
  dynamics::CopyIn(tree.n, v, s.w.v);
  dynamics::Velocities(tree, gravity, s.w);
  dynamics::BodyInertias(tree, s.inertias, s.w);
  dynamics::BodyForces(tree, s.w);
  dynamics::kernel::SumInward(tree, dynamics::kernel::Rows(s.w.sum), dynamics::Composite<double, C>::kRows);
  dynamics::kernel::ForEachPack<double>(
      tree, [&](int r) RG_LAMBDA_INLINE { s.w.c.Store(r, Dot(s.w.S.Load(r), s.w.sum.force.Load(r))); });
}

template <int C>
void PointForces(const StepProgram& program, const StepValues& values, const double* v, double begin,
                 double end, bool derivatives, StepWorkspace<C>& s) {
  using D = Dual<double, 16>;
  using math::Vec3;
  const int n = program.tree.n;
  for (int i = 0; i < n; ++i) s.E[i] = 0.0;
  if (derivatives) {
    for (int i = 0; i < n * C; ++i) s.E_q[i] = s.E_v[i] = 0.0;
  }
  if (program.num_point_forces == 0 || program.point_body < 0) return;
  const int body = program.point_body;
  const uint32_t path = program.tree.path[body];
  const Vec3<double> local = {program.point[0], program.point[1], program.point[2]};
  const Vec3<double> p = s.w.R.At(body) * local + s.w.p.At(body);
  Vec3<double> J[C], velocity = {0, 0, 0};
  for (int i = 0; i < n; ++i) {
    J[i] = {0, 0, 0};
    if ((path >> i & 1u) == 0) continue;
    const auto S = s.w.S.At(i);
    J[i] = S.lin + Cross(S.ang, p);
    velocity = velocity + J[i] * v[i];
  }
  for (int k = 0; k < program.num_point_forces; ++k) {
    const PointForce& op = program.point_forces[k];
    D position[3] = {D::Variable(p.x, 0), D::Variable(p.y, 1), D::Variable(p.z, 2)};
    D rate[3] = {D::Variable(velocity.x, 3), D::Variable(velocity.y, 4), D::Variable(velocity.z, 5)};
    D parameters[kMaxPointParameters], force[3] = {};
    for (int m = 0; m < op.num_parameters; ++m) {
      parameters[m] = D::Variable(values.point_parameters[op.first_parameter + m], 6 + m);
    }
    const D* pp = parameters;
    effects::WithEffectType(op.kind, [&]<class E>() {
      if constexpr (requires { E::PointForce(pp, position, rate, begin, end, op.option, force); }) {
        E::PointForce(pp, position, rate, begin, end, op.option, force);
      }
    });
    const Vec3<double> f = {force[0].v, force[1].v, force[2].v};
    for (int i = 0; i < n; ++i) s.E[i] += Dot(J[i], f);
    if (!derivatives) continue;
    for (int j = 0; j < n; ++j) {
      if ((path >> j & 1u) == 0) continue;
      const auto Sj = s.w.S.At(j);
      // How p, its velocity and each J_i move with q_j.
      Vec3<double> dJ[C], drate = {0, 0, 0};
      for (int i = 0; i < n; ++i) {
        dJ[i] = {0, 0, 0};
        if ((path >> i & 1u) == 0) continue;
        const auto Si = s.w.S.At(i);
        dJ[i] = Cross(Si.ang, J[j]);
        if (program.tree.path[i] >> j & 1u) {
          const Vec3<double> ang = Cross(Sj.ang, Si.ang);
          const Vec3<double> lin = Cross(Sj.ang, Si.lin) + Cross(Sj.lin, Si.ang);
          dJ[i] = dJ[i] + lin + Cross(ang, p);
        }
        drate = drate + dJ[i] * v[i];
      }
      const double dp[6] = {J[j].x, J[j].y, J[j].z, drate.x, drate.y, drate.z};
      Vec3<double> df = {0, 0, 0}, df_v = {0, 0, 0};
      for (int m = 0; m < 6; ++m) df = df + Vec3<double>{force[0].d[m], force[1].d[m], force[2].d[m]} * dp[m];
      for (int m = 0; m < 3; ++m) {
        df_v = df_v + Vec3<double>{force[0].d[3 + m], force[1].d[3 + m], force[2].d[3 + m]} * dp[m];
      }
      for (int i = 0; i < n; ++i) {
        s.E_q[i * C + j] += Dot(dJ[i], f) + Dot(J[i], df);
        s.E_v[i * C + j] += Dot(J[i], df_v);
      }
    }
    for (int m = 0; m < op.num_parameters; ++m) {
      const Vec3<double> df = {force[0].d[6 + m], force[1].d[6 + m], force[2].d[6 + m]};
      for (int i = 0; i < n; ++i) s.E_p[k * kMaxPointParameters + m][i] = Dot(J[i], df);
    }
  }
}

}  // namespace RG_ISA
}  // namespace rg::integrators
