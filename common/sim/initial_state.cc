// Internal states that fit a position, a velocity and a command.
#include <algorithm>

#include "common/base/check.h"
#include "common/effects/effect_list.h"
#include "common/sim/simulator_impl.h"

namespace rg::sim {
namespace {

// The program's actuator and transmission stages at rest under a constant command.
void SettleJoint(const integrators::StepProgram& program, int k, const double* parameters, double q, double v,
                 double command, double reference_mass, double time, double* z) {
  constexpr double kLong = 1e9;  // s: any lag has settled
  const integrators::JointProgram& joint = program.joints[k];
  effects::JointLaw<double> law;
  law.step = {kLong, time, false, 1e-6};
  law.mass = law.reference_mass = reference_mass;
  law.q0 = law.q1 = q;
  law.v0 = law.v1 = v;
  law.acceleration = 0.0;
  law.drive = parameters[integrators::kForceGain] * command;
  for (int i = 0; i < joint.num_ops; ++i) {
    const integrators::LawOp& op = program.ops[joint.first_op + i];
    const double* p = parameters + op.parameter;
    double* states = z + joint.first_state + op.state;
    double start[8] = {};
    law.z0 = start;
    law.z1 = states;
    law.option = op.option;
    effects::WithEffectType(op.kind, [&]<class E>() {
      if constexpr (requires { E::Settle(p, law, states); }) {
        E::Settle(p, law, states);
      } else if constexpr (E::kPhase < effects::Phase::kCoupling) {
        if constexpr (requires { E::Apply(p, law); }) E::Apply(p, law);
      }
    });
  }
}

}  // namespace

void Simulator::Impl::SettleInternalStates(const Eigen::VectorXd& position, const Eigen::VectorXd& velocity,
                                           const Eigen::VectorXd& u, double time,
                                           Eigen::VectorXd* internal) const {
  const internal::PlantData& d = data();
  internal->setZero(d.num_internal_states());
  for (int i = 0; i < n(); ++i) {
    const int k = d.first_joint + i;
    const auto& joint = d.program.joints[k];
    SettleJoint(d.program, k, values.joint_parameters().data() + joint.first_parameter, position[i],
                velocity[i], u[i], d.reference_mass[k], time, internal->data());
  }
}

State Simulator::MakeState(const Eigen::VectorXd& q, const Eigen::VectorXd& v, double time,
                           const Eigen::VectorXd* u) const {
  RG_CHECK(q.size() == impl_->n() && v.size() == impl_->n()) << q.size() << " " << v.size();
  State x;
  x.q = q;
  x.v = v;
  x.time = time;
  impl_->SettleInternalStates(q, v, u != nullptr ? *u : Eigen::VectorXd::Zero(q.size()).eval(), time, &x.z);
  return x;
}

State Simulator::MakeState(const Eigen::VectorXd& q, const Eigen::VectorXd& v, double time,
                           const CommandSignal& command) const {
  Eigen::VectorXd u(q.size());
  for (int i = 0; i < u.size(); ++i) u[i] = command.At(i, time - impl_->Delay(i));
  return MakeState(q, v, time, &u);
}

State Simulator::MakeStateFromMeasurement(const Eigen::VectorXd& q, const Eigen::VectorXd& v, double time,
                                          const CommandSignal& command) const {
  const internal::PlantData& d = impl_->data();
  Eigen::VectorXd position = q;
  for (int j = 0; j < impl_->n(); ++j) {
    position[j] -= impl_->Offset(j);
    if (d.sensors[j].delay >= 0 && d.sensors[j].delays_position) position[j] += impl_->SensorDelay(j) * v[j];
  }
  State x = MakeState(position, v, time, command);
  // MakeState has put the motor at link + deflection; here the motor is what was measured.
  for (int j = 0; j < impl_->n(); ++j) {
    const int motor = d.sensors[j].motor_state;
    if (motor < 0) continue;
    x.q[j] -= x.z[motor] - position[j];
    x.z[motor] = position[j];
  }
  return x;
}

}  // namespace rg::sim
