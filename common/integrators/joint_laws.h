// Evaluates the joints' scalar laws (effects/joint_law.h): forces and slopes for the velocity solver,
// gradients by all local variables for sensitivities. One text for both: Law() over the scalar.
//
// Laws are evaluated by registers, never one by one: with T = Lanes<N> a register holds one joint of N
// windows; with T = double it holds joints of the one robot that have the same effects (LawPack).
#pragma once

#include "common/effects/effect_list.h"
#include "common/integrators/coupled_drives.h"
#include "common/integrators/step_program.h"
#include "common/math/lanes.h"

namespace rg::integrators {
inline namespace RG_ISA {

using effects::Dual;
using effects::JointLaw;
using math::Mask;
using math::Pack;

// How positions follow velocities within the step, and where forces are taken.
struct Scheme {
  bool first_order;    // semi-implicit Euler: q⁺ = q + h v⁺, weights 1
  bool instantaneous;  // no step: force at (q, v), for explicit integrators
};

// StepInput as the kernel's scalars, in the workspace (arrays of C laws, 64-byte aligned).
template <class T, int C>
struct StepState {
  alignas(64) T q[C] = {};
  alignas(64) T v[C] = {};
  alignas(64) T command[C] = {};
  const T* z;
  const T* command_weights;
  T t, h, inverse_h;

  void Load(const StepProgram& program, const StepValues& values, const StepInput& input, int n) {
    const auto at = [](const double* p) { return reinterpret_cast<const T*>(p); };
    for (int i = 0; i < n; ++i) {
      q[i] = at(input.q)[i];
      v[i] = at(input.v)[i];
      command[i] = at(input.command)[i];
    }
    SetDrives(program, values);
    z = at(input.z);
    command_weights = at(input.command_weights);
    t = *at(input.t);
    h = *at(input.h);
    inverse_h = T(1.0) / h;
  }
  // Where coupled drives are, after a change of q or v.
  RG_INLINE void SetDrives(const StepProgram& program, const StepValues& values) {
    integrators::SetDrives(program, values, q);
    integrators::SetDrives(program, values, v);
  }
};

// Joints (or coupled drives) whose laws are evaluated in one register.
template <class T>
struct LawPack {
  static constexpr int kWidth = math::kPackWidth<T>;
  int joints[kWidth];  // those past `count` repeat the first
  int count = 0;
  bool in_place = false;  // the joints are a whole aligned register of the robot's laws, or its last
  bool rough = false;     // whether any friction level may differ from zero
};

// The number that joint l of a pack has in a register.
template <class T>
RG_INLINE T LaneOf(const Pack<T>& x, int l) {
  if constexpr (LawPack<T>::kWidth == 1) {
    return x;
  } else {
    return x[l];
  }
}

template <class T, int C>
struct LawPacks {
  int count = 0;
  int num_uncoupled = 0;  // packs of joints that feel another one's drive torque come after these
  LawPack<T> packs[C];
  Pack<T> reference_mass[C];          // per pack
  Pack<T> parameters[C][kMaxLocals];  // per pack

  RG_INLINE static Pack<T> Gather(const LawPack<T>& pack, const T* x) {
    if constexpr (LawPack<T>::kWidth == 1) {
      return x[pack.joints[0]];
    } else {
      if (pack.in_place) return math::LoadPack(x + pack.joints[0]);
      Pack<T> out;
      for (int l = 0; l < LawPack<T>::kWidth; ++l) out.Set(l, x[pack.joints[l]]);
      return out;
    }
  }
  RG_INLINE static void Scatter(const LawPack<T>& pack, Pack<T> x, T* out) {
    if constexpr (LawPack<T>::kWidth == 1) {
      out[pack.joints[0]] = x;
    } else {
      if (pack.in_place) return math::StorePack(out + pack.joints[0], x);
      for (int l = 0; l < pack.count; ++l) out[pack.joints[l]] = x[l];
    }
  }
};

// Whether the laws of two joints are the same program.
inline bool SameLaw(const StepProgram& program, int a, int b) {
  const JointProgram &x = program.joints[a], &y = program.joints[b];
  if (x.num_ops != y.num_ops || x.num_actuator_ops != y.num_actuator_ops || x.num_states != y.num_states ||
      x.num_parameters != y.num_parameters || (x.coupled_to >= 0) != (y.coupled_to >= 0)) {
    return false;
  }
  for (int k = 0; k < x.num_ops; ++k) {
    const LawOp &p = program.ops[x.first_op + k], &q = program.ops[y.first_op + k];
    if (p.kind != q.kind || p.parameter != q.parameter || p.state != q.state || p.option != q.option) {
      return false;
    }
  }
  return true;
}

template <class T, int C>
void MakeLawPacks(const StepProgram& program, const StepValues& values, const bool* rough,
                  LawPacks<T, C>* out) {
  constexpr int kWidth = LawPack<T>::kWidth;
  const int n = program.num_laws();
  out->count = 0;
  for (const bool coupled : {false, true}) {
    if (coupled) out->num_uncoupled = out->count;
    const int begin = out->count;
    for (int i = 0; i < n; ++i) {
      if ((program.joints[i].coupled_to >= 0) != coupled) continue;
      int place = begin;
      while (place < out->count &&
             (out->packs[place].count == kWidth || !SameLaw(program, out->packs[place].joints[0], i))) {
        ++place;
      }
      if (place == out->count) out->packs[out->count++] = {};
      LawPack<T>& pack = out->packs[place];
      pack.joints[pack.count++] = i;
      pack.rough |= rough[i];
    }
  }
  for (int k = 0; k < out->count; ++k) {
    LawPack<T>& pack = out->packs[k];
    pack.in_place =
        pack.joints[0] % kWidth == 0 && (pack.count == kWidth || pack.joints[0] + pack.count == n);
    for (int l = 1; l < pack.count; ++l) pack.in_place &= pack.joints[l] == pack.joints[0] + l;
    for (int l = pack.count; l < kWidth; ++l) pack.joints[l] = pack.joints[0];
    const auto each = [&](auto value) {
      if constexpr (kWidth == 1) {
        return Pack<T>(value(pack.joints[0]));
      } else {
        Pack<T> x;
        for (int l = 0; l < kWidth; ++l) x.Set(l, value(pack.joints[l]));
        return x;
      }
    };
    out->reference_mass[k] = each([&](int i) { return values.reference_mass[i]; });
    for (int m = 0; m < program.joints[pack.joints[0]].num_parameters; ++m) {
      out->parameters[k][m] =
          each([&](int i) { return values.joint_parameters[program.joints[i].first_parameter + m]; });
    }
  }
}

template <class T, int C>
struct LawContext {
  const StepProgram* program;
  const StepValues* values;
  const StepState<T, C>* input;
  Scheme scheme;
  const T* mass;  // per law, inertia its force sees
  const LawPacks<T, C>* packs;
};

template <class S>
void RunOps(const StepProgram& program, int begin, int end, const S* parameters, const S* z0, S* z1,
            JointLaw<S>& law) {
  for (int k = begin; k < end; ++k) {
    const LawOp& op = program.ops[k];
    law.option = op.option;
    law.z0 = z0 + op.state;
    law.z1 = z1 + op.state;
    const S* p = parameters + op.parameter;
    effects::WithEffectType(op.kind, [&]<class E>() {
      if constexpr (requires { E::Apply(p, law); }) E::Apply(p, law);
    });
  }
}

// What a register of laws is given beside its local variables.
template <class P>
struct LawSetting {
  effects::StepContext<P> step;
  P inverse_h, mass, reference_mass;
  bool rough;
};

// What every law starts with. parameters: at least the joint's first.
template <class S>
RG_INLINE JointLaw<S> BeginLaw(const LawSetting<effects::Base<S>>& at, const S& v1, const S& v0, const S& q0,
                               const S& u, const S& coupled, const S* parameters) {
  using P = effects::Base<S>;
  JointLaw<S> law;
  law.step = at.step;
  law.mass = at.mass;
  law.reference_mass = at.reference_mass;
  law.rough = at.rough;
  law.q0 = q0;
  law.v0 = v0;
  law.v1 = v1;
  law.q1 = at.step.first_order ? q0 + at.step.h * v1 : q0 + (P(0.5) * at.step.h) * (v0 + v1);
  law.acceleration = (v1 - v0) * at.inverse_h;
  law.coupled = coupled;
  law.drive = law.link = parameters[kForceGain] * u;
  law.viscous = parameters[kDamping];
  law.level_positive = law.level_negative = parameters[kFriction];
  return law;
}

// Force on the joints of one pack, `joint` the program of each. v1, q0 …: the local variables; parameters:
// all of the joint's; z0, z1: its states. `drive`: the torque after the actuator stage, which coupled
// joints feel.
template <class S>
S Law(const StepProgram& program, const JointProgram& joint, const LawSetting<effects::Base<S>>& at,
      const S& v1, const S& v0, const S& q0, const S& u, const S& coupled, const S* z0, const S* parameters,
      S* z1, S* drive) {
  JointLaw<S> law = BeginLaw(at, v1, v0, q0, u, coupled, parameters);
  const int actuators = joint.first_op + joint.num_actuator_ops;
  RunOps(program, joint.first_op, actuators, parameters, z0, z1, law);
  *drive = law.drive;
  int next = actuators;
  for (; next < joint.first_op + joint.num_ops && joint.coupled_to >= 0 && next == actuators; ++next) {
    RunOps(program, next, next + 1, parameters, z0, z1, law);  // the coupling
  }
  law.link = law.drive;
  RunOps(program, next, joint.first_op + joint.num_ops, parameters, z0, z1, law);
  return law.Force();
}

// The same where a joint has neither effects nor friction levels: all of it stays in registers. It does not
// depend on the position.
template <class S>
RG_INLINE S PlainLaw(const LawSetting<effects::Base<S>>& at, const S& v1, const S& v0, const S& u,
                     const S& gain, const S& damping) {
  using P = effects::Base<S>;
  const S none(P(0.0)), parameters[] = {gain, damping, none};
  return BeginLaw(at, v1, v0, none, u, none, parameters).SmoothForce();
}

// Whether that is so for the joints of a pack, and no other joint asks for their torque.
template <class T, int C>
RG_INLINE bool IsPlain(const LawContext<T, C>& c, const LawPack<T>& pack, bool rough) {
  return c.program->joints[pack.joints[0]].num_ops == 0 && !rough && c.packs->num_uncoupled == c.packs->count;
}

template <class T, int C>
RG_INLINE LawSetting<Pack<T>> SettingOf(const LawContext<T, C>& c, int k) {
  using P = Pack<T>;
  const LawPack<T>& pack = c.packs->packs[k];
  const bool instantaneous = c.scheme.instantaneous;
  return {{instantaneous ? P(0.0) : P(c.input->h), P(c.input->t), c.scheme.first_order,
           instantaneous ? c.values->rk4_sign_width : c.values->stick_velocity},
          instantaneous ? P(0.0) : P(c.input->inverse_h),
          LawPacks<T, C>::Gather(pack, c.mass),
          c.packs->reference_mass[k],
          pack.rough};
}

// What the local variable kCoupled is: the drive torque of the joint this one is coupled to, or the
// position of the one it sees.
template <class T, int C>
RG_INLINE Pack<T> CoupledOf(const LawContext<T, C>& c, const LawPack<T>& pack, const T* drives) {
  const auto one = [&](int joint) {
    const JointProgram& program = c.program->joints[joint];
    if (program.coupled_to >= 0) return drives[program.coupled_to];
    if (program.sees < 0) return T(0.0);
    const T ahead = c.scheme.instantaneous ? T(0.0) : T(0.5) * c.input->h;
    return c.input->q[program.sees] + ahead * c.input->v[program.sees];
  };
  if constexpr (LawPack<T>::kWidth == 1) {
    return one(pack.joints[0]);
  } else {
    Pack<T> out(0.0);
    for (int l = 0; l < LawPack<T>::kWidth; ++l) {
      const JointProgram& program = c.program->joints[pack.joints[l]];
      if (program.coupled_to >= 0 || program.sees >= 0) out.Set(l, one(pack.joints[l]));
    }
    return out;
  }
}

// State k of each joint of a pack.
template <class T, int C>
RG_INLINE Pack<T> StateOf(const LawContext<T, C>& c, const LawPack<T>& pack, int k) {
  if constexpr (LawPack<T>::kWidth == 1) {
    return c.input->z[c.program->joints[pack.joints[0]].first_state + k];
  } else {
    Pack<T> out;
    for (int l = 0; l < LawPack<T>::kWidth; ++l) {
      out.Set(l, c.input->z[c.program->joints[pack.joints[l]].first_state + k]);
    }
    return out;
  }
}

// Forces F and slopes dF/dv1 of each law at end velocities v1; z1 (num_states) is written too. force, slope,
// v1: 64-byte aligned, C.
template <class T, int C>
void Forces(const LawContext<T, C>& c, const T* v1, T* force, T* slope, T* z1) {
  using P = Pack<T>;
  using S = Dual<P, 1>;
  using Packs = LawPacks<T, C>;
  T drives[C];
  for (int k = 0; k < c.packs->count; ++k) {
    const LawPack<T>& pack = c.packs->packs[k];
    const JointProgram& joint = c.program->joints[pack.joints[0]];
    if (IsPlain(c, pack, pack.rough)) {
      const Pack<T>* p = c.packs->parameters[k];
      const S f = PlainLaw<S>(SettingOf(c, k), S::Variable(Packs::Gather(pack, v1), 0),
                              S(Packs::Gather(pack, c.input->v)), S(Packs::Gather(pack, c.input->command)),
                              S(p[kForceGain]), S(p[kDamping]));
      Packs::Scatter(pack, f.v, force);
      Packs::Scatter(pack, f.d[0], slope);
      continue;
    }
    S parameters[kMaxLocals], z[kMaxStates], end[kMaxStates], drive;
    for (int m = 0; m < joint.num_parameters; ++m) parameters[m] = S(c.packs->parameters[k][m]);
    for (int m = 0; m < joint.num_states; ++m) z[m] = S(StateOf(c, pack, m));
    const S f = Law<S>(*c.program, joint, SettingOf(c, k), S::Variable(Packs::Gather(pack, v1), 0),
                       S(Packs::Gather(pack, c.input->v)), S(Packs::Gather(pack, c.input->q)),
                       S(Packs::Gather(pack, c.input->command)), S(CoupledOf(c, pack, drives)), z, parameters,
                       end, &drive);
    Packs::Scatter(pack, f.v, force);
    Packs::Scatter(pack, f.d[0], slope);
    if (c.packs->num_uncoupled < c.packs->count) {
      for (int l = 0; l < pack.count; ++l) drives[pack.joints[l]] = LaneOf<T>(drive.v, l);
    }
    for (int m = 0; m < joint.num_states; ++m) {
      for (int l = 0; l < pack.count; ++l) {
        z1[c.program->joints[pack.joints[l]].first_state + m] = LaneOf<T>(end[m].v, l);
      }
    }
  }
}

// Gradients by local variables: of the force, of the drive torque (where joints are coupled), of each
// internal state's end value; [local][joint]. Those by internal states also on their own, zero where a joint
// has fewer.
template <class T, int C>
struct LawGradients {
  alignas(64) T force_by_state[kMaxStates][C];
  alignas(64) T state_by_state[kMaxStates][kMaxStates][C];
  alignas(64) T force[kMaxLocals][C];
  alignas(64) T drive[kMaxLocals][C];
  alignas(64) T state[kMaxStates][kMaxLocals][C];
  bool alone[kMaxStates];  // no joint's state of this number depends on motion or on other states

  void FindAlone(int n, int states) {
    for (int k = 0; k < states; ++k) {
      Mask<Pack<T>> depends = false;
      const auto add = [&](const T* by, int r) RG_LAMBDA_INLINE {
        const Pack<T> x = math::LoadPack(by + r);
        depends = Or(depends, Or(x > Pack<T>(0.0), x < Pack<T>(0.0)));
      };
      for (int r = 0; r < n; r += math::kPackWidth<T>) {
        for (const int local : {kEndVelocity, kVelocity, kPosition}) add(state[k][local], r);
        for (int m = 0; m < states; ++m) {
          if (m != k) add(state_by_state[k][m], r);
        }
      }
      alone[k] = !Any(depends);
    }
  }
};

// Which local variables of a pack's joints gradients are taken by, each with its place in the dual numbers.
struct Seeds {
  int count = 0;
  int local[kMaxLocals];
  int8_t place[kMaxLocals];  // −1: none

  void Add(int k) {
    place[k] = static_cast<int8_t>(count);
    local[count++] = k;
  }
};

template <class T, int C>
Seeds SeedsOf(const LawContext<T, C>& c, const LawPack<T>& pack, const Directions& directions) {
  const JointProgram& joint = c.program->joints[pack.joints[0]];
  uint64_t used = 1u << kEndVelocity | 1u << kVelocity | 1u << kPosition;
  used |= ((uint64_t{1} << joint.num_states) - 1) << kFirstState;
  for (int l = 0; l < pack.count; ++l) {
    const JointProgram& own = c.program->joints[pack.joints[l]];
    used |= directions.used_locals[pack.joints[l]];
    if (own.coupled_to >= 0 || own.sees >= 0) used |= 1u << kCoupled;
  }
  Seeds seeds;
  for (int k = 0; k < joint.num_locals(); ++k) {
    seeds.place[k] = -1;
    if (used >> k & 1u) seeds.Add(k);
  }
  return seeds;
}

template <int W, class T, int C>
void PackGradient(const LawContext<T, C>& c, int k, bool rough, const Seeds& seeds, const T* v1, T* drives,
                  LawGradients<T, C>* out) {
  using P = Pack<T>;
  using S = Dual<P, W>;
  using Packs = LawPacks<T, C>;
  const LawPack<T>& pack = c.packs->packs[k];
  const JointProgram& joint = c.program->joints[pack.joints[0]];
  const auto variable = [&](P value, int local) RG_LAMBDA_INLINE {
    return seeds.place[local] < 0 ? S(value) : S::Variable(value, seeds.place[local]);
  };
  S parameters[kMaxLocals], z[kMaxStates], end[kMaxStates], drive;
  for (int m = 0; m < joint.num_states; ++m) z[m] = variable(StateOf(c, pack, m), kFirstState + m);
  for (int m = 0; m < joint.num_parameters; ++m) {
    parameters[m] = variable(c.packs->parameters[k][m], kFirstState + joint.num_states + m);
  }
  LawSetting<P> setting = SettingOf(c, k);
  setting.rough = rough;
  const S f = Law<S>(*c.program, joint, setting, variable(Packs::Gather(pack, v1), kEndVelocity),
                     variable(Packs::Gather(pack, c.input->v), kVelocity),
                     variable(Packs::Gather(pack, c.input->q), kPosition),
                     variable(Packs::Gather(pack, c.input->command), kCommand),
                     variable(CoupledOf(c, pack, drives), kCoupled), z, parameters, end, &drive);
  const bool coupling = c.packs->num_uncoupled < c.packs->count;
  if (coupling) Packs::Scatter(pack, drive.v, drives);
  for (int i = 0; i < seeds.count; ++i) {
    const int local = seeds.local[i], state = local - kFirstState;
    const bool by_state = state >= 0 && state < joint.num_states;
    Packs::Scatter(pack, f.d[i], out->force[local]);
    if (by_state) Packs::Scatter(pack, f.d[i], out->force_by_state[state]);
    if (coupling) Packs::Scatter(pack, drive.d[i], out->drive[local]);
    for (int s = 0; s < joint.num_states; ++s) {
      Packs::Scatter(pack, end[s].d[i], out->state[s][local]);
      if (by_state) Packs::Scatter(pack, end[s].d[i], out->state_by_state[s][state]);
    }
  }
}

template <class T, int C>
RG_INLINE void PlainGradient(const LawContext<T, C>& c, int k, const T* v1, LawGradients<T, C>* out) {
  using Packs = LawPacks<T, C>;
  constexpr int kLocals[] = {kEndVelocity, kVelocity, kCommand, kFirstState + int{kForceGain},
                             kFirstState + int{kDamping}};
  using S = Dual<Pack<T>, 5>;
  const LawPack<T>& pack = c.packs->packs[k];
  const Pack<T>* p = c.packs->parameters[k];
  const S f = PlainLaw<S>(SettingOf(c, k), S::Variable(Packs::Gather(pack, v1), 0),
                          S::Variable(Packs::Gather(pack, c.input->v), 1),
                          S::Variable(Packs::Gather(pack, c.input->command), 2),
                          S::Variable(p[kForceGain], 3), S::Variable(p[kDamping], 4));
  for (int i = 0; i < 5; ++i) Packs::Scatter(pack, f.d[i], out->force[kLocals[i]]);
  Packs::Scatter(pack, Pack<T>(T(0.0)), out->force[kPosition]);
}

template <class T, int C>
void Gradients(const LawContext<T, C>& c, const Directions& directions, const T* v1,
               LawGradients<T, C>* out) {
  alignas(64) T drives[C];
  for (int k = 0; k < c.packs->count; ++k) {
    const LawPack<T>& pack = c.packs->packs[k];
    // A friction level of zero changes no force, but it has a derivative.
    bool rough = pack.rough;
    for (int l = 0; l < pack.count; ++l) rough |= directions.friction[pack.joints[l]];
    if (IsPlain(c, pack, rough)) {
      PlainGradient(c, k, v1, out);
      continue;
    }
    const Seeds seeds = SeedsOf(c, pack, directions);
    if (seeds.count <= 6) {
      PackGradient<6>(c, k, rough, seeds, v1, drives, out);
    } else if (seeds.count <= 8) {
      PackGradient<8>(c, k, rough, seeds, v1, drives, out);
    } else if (seeds.count <= 12) {
      PackGradient<12>(c, k, rough, seeds, v1, drives, out);
    } else if (seeds.count <= 24) {
      PackGradient<24>(c, k, rough, seeds, v1, drives, out);
    } else {
      PackGradient<kMaxLocals>(c, k, rough, seeds, v1, drives, out);
    }
  }
  out->FindAlone(c.program->tree.n, c.program->max_states);
}

}  // namespace RG_ISA
}  // namespace rg::integrators
