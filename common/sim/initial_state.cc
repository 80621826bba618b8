// Internal states that fit a position, a velocity and a command.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/check.h"
#include "common/dynamics/dynamics.h"
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

// Angles of a hinge and their rates (φ₁, φ̇₁, φ₂, φ̇₂) at which the rod hangs down and does not turn in W,
// while the robot is at q with speeds v. Where gravity is along the hinge's first axis: at rest in the link.
Eigen::Vector4d HangingStill(const internal::Rod& rod, const Eigen::Vector3d& gravity,
                             const Eigen::VectorXd& q, const Eigen::VectorXd& v) {
  constexpr double kLeast = 0.1;  // sine of the angle between rod and axis
  if (!(gravity.norm() > 0)) return Eigen::Vector4d::Zero();
  dynamics::Workspace workspace;
  Eigen::MatrixXd J(6, q.size());
  const model::Pose X_WT = dynamics::FrameKinematics(*rod.arm, workspace, q, rod.tool, J);
  const Eigen::Vector3d down = X_WT.rotation.transpose() * gravity.normalized();
  const Eigen::Vector3d turn = X_WT.rotation.transpose() * (J.topRows(3) * v);
  const Eigen::Vector3d rate = down.cross(turn);
  // The rod is along −sin φ₂·a + cos φ₂·(sin φ₁·b − cos φ₁·c) in the link's axes from the hinge's first.
  const int a = rod.hinge, b = (a + 1) % 3, c = (a + 2) % 3;
  const double across = std::hypot(down[b], down[c]), first = std::atan2(down[b], -down[c]),
               second = std::atan2(-down[a], across);
  if (across < kLeast) return {first, 0.0, second, 0.0};
  return {first, (down[b] * rate[c] - down[c] * rate[b]) / (across * across), second, -rate[a] / across};
}

}  // namespace

void Simulator::Impl::SettleInternalStates(const Eigen::VectorXd& position, const Eigen::VectorXd& velocity,
                                           const Eigen::VectorXd& u, double time,
                                           Eigen::VectorXd* internal) const {
  const internal::PlantData& d = data();
  internal->setZero(d.num_internal_states());
  for (int i = 0; i < n(); ++i) {
    const int k = d.kernel[i];
    const auto& joint = d.program.joints[k];
    SettleJoint(d.program, k, values.joint_parameters().data() + joint.first_parameter, position[i],
                velocity[i], u[i], d.reference_mass[k], time, internal->data());
  }
  if (d.rod.hinge >= 0) internal->tail<4>() = HangingStill(d.rod, values.gravity(), position, velocity);
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
  // Of a command that changes at this instant the drive has followed the one before.
  const auto before = [](double t) { return std::nextafter(t, -std::numeric_limits<double>::infinity()); };
  for (int i = 0; i < u.size(); ++i) u[i] = command.At(i, before(time - impl_->Delay(i)));
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
