// Scratch of the step kernels for up to C joints, and the pieces every integrator is made of.
#pragma once

#include "common/dynamics/kernels.h"
#include "common/integrators/bound_joints.h"
#include "common/integrators/coupled_drives.h"
#include "common/integrators/joint_laws.h"
#include "common/integrators/small_linear.h"
#include "common/integrators/step_program.h"

namespace rg::integrators {
inline namespace RG_ISA {

// What has gone wrong in which lanes; a lane that failed stays out of all that follows.
template <class T>
struct StepFailure {
  math::Mask<T> failed = false;
  StepStatus status = StepStatus::kOk;  // of the first failure
  int joint = -1;

  RG_INLINE void Add(math::Mask<T> lanes, StepStatus what, int where) {
    const math::Mask<T> fresh = And(lanes, Not(failed));
    if (!Any(fresh)) return;
    if (status == StepStatus::kOk) status = what, joint = where;
    failed = Or(failed, fresh);
  }
  RG_INLINE bool all() const { return All(failed); }
  StepResult Result() const { return {status, joint, math::BitsOf(failed)}; }
};

// N: the number of joints where the compiler may know it, else 0.
template <class T, int C, int N>
struct StepWorkspace {
  static constexpr RG_INLINE int Joints(const dynamics::Tree& tree) { return N > 0 ? N : tree.n; }

  dynamics::KernelWorkspace<T, C> w;
  dynamics::Inertias<T, C> inertias;
  LawPacks<T, C> laws;
  StepState<T, C> input;

  // Set by Prepare from program and values; of joints and coupled drives.
  T gravity[3];
  bool rough[C];  // whether the law has friction levels
  bool any_rough;
  T armature[C];          // rotor inertia in the law
  alignas(64) T mass[C];  // inertia a law's force sees, for reversals

  // Of the step being taken.
  StepFailure<T> failure;
  alignas(64) T bias[C];             // c(q, v, g) less the point forces
  alignas(64) T force[C], slope[C];  // at the current v1; coupled drives' own behind the joints'
  alignas(64) T trial_force[C], trial_slope[C];
  alignas(64) T v1[C], trial[C];
  T mean[C], half[C], before[C];
  T z1[C * kMaxStates];
  alignas(64) T H[C * C];
  T diagonal[C];
  // Whether H holds the factor of M/h less these slopes.
  bool factored;
  T factored_slope[C];

  // Point forces: generalised force and its derivatives, row-major.
  T E[C], E_q[C * C], E_v[C * C], E_p[kMaxPointForces * kMaxPointParameters][C];

  // For sensitivities.
  LawGradients<T, C> gradients;
  T by_ratio[kMaxDrives];          // of a coupled drive's own force by κ, the joints moving as they do
  math::Row<T, C> inverse[C];      // H⁻¹ by columns
  math::Row<T, C> B_q[C], B_v[C];  // what dq0 and dv0 are multiplied with; later H⁻¹ times that
};

// Inertias and constants from the values; whenever program or values change.
template <class T, int C, int N>
void Prepare(const StepProgram& program, const StepValues& values, StepWorkspace<T, C, N>& s) {
  const int n = s.Joints(program.tree);
  for (int k = 0; k < n; ++k) {
    T phi[10];
    for (int i = 0; i < 10; ++i) phi[i] = T(values.phi[k][i]);
    s.inertias.Set(k, phi);
  }
  for (int i = 0; i < 3; ++i) s.gravity[i] = T(values.gravity[i]);
  s.any_rough = false;
  for (int i = 0; i < program.num_laws(); ++i) {
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
        if constexpr (requires { E::WritesFriction(0); }) {
          friction_op |= E::WritesFriction(program.ops[k].option);
        } else if constexpr (requires { E::kFriction; }) {
          friction_op = true;
        }
      });
    }
    s.armature[i] = T(law.inertia);
    s.rough[i] = friction_op || p[kFriction] != 0.0;
    s.mass[i] = T(values.reference_mass[i]);
    if (i < n) s.E[i] = T(0.0);
    s.any_rough |= s.rough[i];
  }
  MakeLawPacks(program, values, s.rough, &s.laws);
}

// Generalised force of the point forces at the workspace's kinematics and velocity v, averaged over
// [begin, end], with derivatives where `derivatives`.
template <class T, int C, int N>
void PointForces(const StepProgram& program, const StepValues& values, const T* v, T begin, T end,
                 bool derivatives, StepWorkspace<T, C, N>& s);

inline constexpr double kHeld = 1e9;  // a joint with so many times its inertia does not move
// A coupled drive neither; less, for it stands off the diagonal too, where its joints' inertia is a
// difference.
inline constexpr double kHeldDrive = 1e6;

// The mass matrix at the workspace's kinematics, of the free joints.
template <class T, int C, int N>
RG_INLINE void MassMatrixHere(const StepProgram& program, StepWorkspace<T, C, N>& s) {
  dynamics::CompositeForces(program.tree, s.w);
  dynamics::MassMatrix(program.tree, s.w);
  FoldMatrix<T, C>(program, s.Joints(program.tree), s.w.M);
}

// s.bias = w.c less the point forces.
template <class T, int C, int N>
RG_INLINE void SetBias(const StepProgram& program, StepWorkspace<T, C, N>& s) {
  for (int i = 0; i < s.Joints(program.tree); ++i) s.bias[i] = s.w.c[i] - s.E[i];
  FoldForces(program, s.bias);
}

// Laws at end velocities v1 (of all laws), on the free joints.
template <class T, int C>
RG_INLINE void FreeForces(const LawContext<T, C>& c, const T* v1, T* force, T* slope, T* z1) {
  Forces(c, v1, force, slope, z1);
  AddDriveForces(*c.program, *c.values, force);
  FoldForces(*c.program, force);
  FoldSlopes(*c.program, slope);
}

// w.M into H's lower triangle, scaled.
template <class T, int C, int N>
RG_INLINE void LoadMass(int n, T scale, const StepWorkspace<T, C, N>& s, T* H) {
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j <= i; ++j) H[i * C + j] = s.w.M[j][i] * scale;
  }
}

// The coupled drives' part of that: their rotors into H, those that stick held. s.mass: of one that sticks.
template <class T, int C, int N, class Sticks>
RG_INLINE void AddDriveInertias(const StepProgram& program, const StepValues& values, const Sticks& sticks,
                                StepWorkspace<T, C, N>& s) {
  ForEachDrive<T>(program, values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
    const T rotor = s.armature[r.law];
    s.mass[r.law] = s.w.M[r.joint][r.joint] + s.armature[r.joint] + rotor;
    const T held = math::Select(sticks(r.law), s.mass[r.law] * T(kHeldDrive), rotor);
    AddDriveSquare<T, C>(r, s.rough[r.law] ? held : rotor, s.H);
  });
}

// s.mass of the coupled drives, 1/(Rᵀ H⁻¹ R), from H's factor.
template <class T, int C, int N, class Sticks>
RG_INLINE void SetDriveMasses(const StepProgram& program, const StepValues& values, const Sticks& sticks,
                              StepWorkspace<T, C, N>& s) {
  const int n = s.Joints(program.tree);
  ForEachDrive<T>(program, values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
    T x[C];
    for (int i = 0; i < n; ++i) x[i] = T(0.0);
    x[r.joint] = T(1.0);
    x[r.other] = r.ratio;
    DropBoundRows(program, x);
    CholeskySolve<T, C>(n, s.H, s.diagonal, x);
    const T seen = T(1.0) / r.Of(x);
    s.mass[r.law] = s.rough[r.law] ? math::Select(sticks(r.law), s.mass[r.law], seen) : seen;
  });
}

// The inertia each law's force sees, link plus rotor, what sticks held: 1/(M⁻¹)_ii over the joints that move.
// v: of all laws. Also checks that M is positive definite.
template <class T, int C, int N>
RG_INLINE void UpdateEffectiveInertias(const StepProgram& program, const StepValues& values, const T* v,
                                       StepWorkspace<T, C, N>& s) {
  const int n = s.Joints(program.tree);
  s.factored = false;
  LoadMass(n, T(1.0), s, s.H);
  const auto sticks = [&](int i) RG_LAMBDA_INLINE { return math::Abs(v[i]) <= T(values.stick_velocity); };
  for (int i = 0; i < n; ++i) {
    const T inertia = s.H[i * C + i] + s.armature[i];
    s.mass[i] = inertia;
    s.H[i * C + i] = s.rough[i] ? math::Select(sticks(i), inertia * T(kHeld), inertia) : inertia;
  }
  AddDriveInertias(program, values, sticks, s);
  SetApart<T, C>(program, s.H);
  int row = -1;
  const math::Mask<T> bad = Cholesky<T, C>(n, s.H, s.diagonal, &row);
  s.failure.Add(bad, StepStatus::kMassMatrixNotPositive, row);
  if (s.any_rough && !s.failure.all()) {
    T seen[C];
    EffectiveInertias<T, C>(n, s.H, s.diagonal, seen);
    for (int i = 0; i < n; ++i) {
      s.mass[i] = s.rough[i] ? math::Select(sticks(i), s.mass[i], seen[i]) : seen[i];
    }
    SetDriveMasses(program, values, sticks, s);
  }
  for (int i = 0; i < program.tree.num_ties; ++i) {
    const dynamics::Tie& tie = program.tree.ties[i];
    s.mass[tie.follower] = s.mass[tie.driver] * T(1.0 / (tie.ratio * tie.ratio));
  }
}

// w.c at velocity v, after Kinematics; leaves the composites that Derivatives needs.
template <class T, int C, int N>
RG_INLINE void BiasHere(const dynamics::Tree& tree, const T* v, StepWorkspace<T, C, N>& s) {
  dynamics::CopyIn(tree.n, v, s.w.v);
  dynamics::Velocities(tree, s.gravity, s.w);
  dynamics::BodyInertias(tree, s.inertias, s.w);
  dynamics::BodyForces(tree, s.w);
  dynamics::kernel::SumInward(tree, dynamics::kernel::Rows(s.w.sum), dynamics::Composite<T, C>::kRows);
  dynamics::kernel::ForEachPack<T>(
      tree, [&](int r) RG_LAMBDA_INLINE { s.w.c.Store(r, Dot(s.w.S.Load(r), s.w.sum.force.Load(r))); });
}

template <class T, int C, int N>
void PointForces(const StepProgram& program, const StepValues& values, const T* v, T begin, T end,
                 bool derivatives, StepWorkspace<T, C, N>& s) {
  using D = Dual<T, 16>;
  using math::Vec3;
  const int n = s.Joints(program.tree);
  if (program.num_point_forces == 0 || program.point_body < 0) return;
  for (int i = 0; i < n; ++i) s.E[i] = T(0.0);
  if (derivatives) {
    for (int i = 0; i < n * C; ++i) s.E_q[i] = s.E_v[i] = T(0.0);
  }
  const int body = program.point_body;
  const uint32_t path = program.tree.path[body];
  const Vec3<T> local = {T(program.point[0]), T(program.point[1]), T(program.point[2])};
  const Vec3<T> p = s.w.R.At(body) * local + s.w.p.At(body);
  Vec3<T> J[C], velocity = {T(0.0), T(0.0), T(0.0)};
  for (int i = 0; i < n; ++i) {
    J[i] = {T(0.0), T(0.0), T(0.0)};
    if ((path >> i & 1u) == 0) continue;
    const auto S = s.w.S.At(i);
    J[i] = S.lin + Cross(S.ang, p);
    velocity = velocity + J[i] * v[i];
  }
  for (int k = 0; k < program.num_point_forces; ++k) {
    const PointForce& op = program.point_forces[k];
    D position[3] = {D::Variable(p.x, 0), D::Variable(p.y, 1), D::Variable(p.z, 2)};
    D rate[3] = {D::Variable(velocity.x, 3), D::Variable(velocity.y, 4), D::Variable(velocity.z, 5)};
    D parameters[kMaxPointParameters], force[3];
    for (D& f : force) f = D(T(0.0));
    for (int m = 0; m < op.num_parameters; ++m) {
      parameters[m] = D::Variable(T(values.point_parameters[op.first_parameter + m]), 6 + m);
    }
    const D* pp = parameters;
    effects::WithEffectType(op.kind, [&]<class E>() {
      if constexpr (requires { E::PointForce(pp, position, rate, begin, end, op.option, force); }) {
        E::PointForce(pp, position, rate, begin, end, op.option, force);
      }
    });
    const Vec3<T> f = {force[0].v, force[1].v, force[2].v};
    for (int i = 0; i < n; ++i) s.E[i] += Dot(J[i], f);
    if (!derivatives) continue;
    for (int j = 0; j < n; ++j) {
      if ((path >> j & 1u) == 0) continue;
      const auto Sj = s.w.S.At(j);
      // How p, its velocity and each J_i move with q_j.
      Vec3<T> dJ[C], drate = {T(0.0), T(0.0), T(0.0)};
      for (int i = 0; i < n; ++i) {
        dJ[i] = {T(0.0), T(0.0), T(0.0)};
        if ((path >> i & 1u) == 0) continue;
        const auto Si = s.w.S.At(i);
        dJ[i] = Cross(Si.ang, J[j]);
        if (program.tree.path[i] >> j & 1u) {
          const Vec3<T> ang = Cross(Sj.ang, Si.ang);
          const Vec3<T> lin = Cross(Sj.ang, Si.lin) + Cross(Sj.lin, Si.ang);
          dJ[i] = dJ[i] + lin + Cross(ang, p);
        }
        drate = drate + dJ[i] * v[i];
      }
      const T dp[6] = {J[j].x, J[j].y, J[j].z, drate.x, drate.y, drate.z};
      Vec3<T> df = {T(0.0), T(0.0), T(0.0)}, df_v = {T(0.0), T(0.0), T(0.0)};
      for (int m = 0; m < 6; ++m) df = df + Vec3<T>{force[0].d[m], force[1].d[m], force[2].d[m]} * dp[m];
      for (int m = 0; m < 3; ++m) {
        df_v = df_v + Vec3<T>{force[0].d[3 + m], force[1].d[3 + m], force[2].d[3 + m]} * dp[m];
      }
      for (int i = 0; i < n; ++i) {
        s.E_q[i * C + j] += Dot(dJ[i], f) + Dot(J[i], df);
        s.E_v[i * C + j] += Dot(J[i], df_v);
      }
    }
    for (int m = 0; m < op.num_parameters; ++m) {
      const Vec3<T> df = {force[0].d[6 + m], force[1].d[6 + m], force[2].d[6 + m]};
      for (int i = 0; i < n; ++i) s.E_p[k * kMaxPointParameters + m][i] = Dot(J[i], df);
    }
  }
}

}  // namespace RG_ISA
}  // namespace rg::integrators
