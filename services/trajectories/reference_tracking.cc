#include "services/trajectories/reference_tracking.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <cstdio>

#include "common/sim/simulator.h"
#include "services/trajectories/plant_problem.h"

namespace rg::trajectories {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kPosition = 0.05, kVelocity = 0.5;  // rad, rad/s: errors that weigh as much as …
constexpr double kEffort = 0.25;                     // … this share of the torque limit
constexpr double kWithoutLimit = 10.0;               // N·m, where the model has none
constexpr double kLeft = 1e-3;                       // rad/s² of acceleration that may be left

// Friction smoothed over ± stick_velocity, as plans see it (mpc_controller.h).
sim::SimulatorOptions Simulation() { return {.step_s = 0.005, .stick_velocity = 0.05}; }

Status CannotFollow(const sim::Plant& plant, const VectorXd& wanted, const VectorXd& got, double t) {
  Eigen::Index worst = 0;
  (wanted - got).cwiseAbs().maxCoeff(&worst);
  char text[200];
  std::snprintf(text, sizeof text, "motion: no torque makes the model's %s follow it at %.3g s",
                plant.joint_names()[static_cast<size_t>(worst)].c_str(), t);
  return InvalidError(text);
}

// The torque at which the acceleration at (q, v) is `wanted`: Newton's method on the simulator's
// acceleration, exact after one step for a rigid plant. `u` holds the start.
Status InverseDynamics(sim::Simulator& simulator, const VectorXd& q, const VectorXd& v,
                       const VectorXd& wanted, double t, VectorXd* u) {
  const Eigen::Index n = q.size();
  VectorXd a(n), moved_a(n);
  MatrixXd da_du(n, n);
  const auto acceleration = [&](const VectorXd& torque, VectorXd* out) {
    const sim::State state = simulator.MakeState(q, v, t, &torque);
    return simulator.Acceleration(state, torque, out) && out->allFinite();
  };
  for (int step = 0; step < 8; ++step) {
    if (!acceleration(*u, &a)) break;
    if ((a - wanted).cwiseAbs().maxCoeff() < kLeft) return Status::Ok();
    for (Eigen::Index j = 0; j < n; ++j) {
      VectorXd moved = *u;
      moved[j] += 1.0;
      if (!acceleration(moved, &moved_a)) return CannotFollow(simulator.plant(), wanted, a, t);
      da_du.col(j) = moved_a - a;
    }
    *u += da_du.fullPivLu().solve(wanted - a);
    if (!u->allFinite()) break;
  }
  return CannotFollow(simulator.plant(), wanted, a, t);
}

Status CheckTorque(const sim::Plant& plant, const VectorXd& u, const VectorXd& limit, double t) {
  for (Eigen::Index j = 0; j < u.size(); ++j) {
    if (std::abs(u[j]) <= limit[j]) continue;
    char text[200];
    std::snprintf(text, sizeof text, "motion: %s needs a torque of %.4g at %.3g s, its limit is %.4g",
                  plant.joint_names()[static_cast<size_t>(j)].c_str(), u[j], t, limit[j]);
    return InvalidError(text);
  }
  return Status::Ok();
}

// d(q, v)⁺/d(q, v) and d(q, v)⁺/du over one interval; internal states settled at u.
bool Linearised(sim::Simulator& simulator, const VectorXd& q, const VectorXd& v, const VectorXd& u,
                double interval, MatrixXd* A, MatrixXd* B) {
  sim::State state = simulator.MakeState(q, v, 0.0, &u);
  sim::Linearization linearization;
  if (!simulator.Advance(state, u, interval, &linearization).ok()) return false;
  const Eigen::Index n = q.size();
  *A = linearization.A.topLeftCorner(2 * n, 2 * n);
  *B = linearization.B.topRows(2 * n);
  return A->allFinite() && B->allFinite();
}

}  // namespace

Result<TrackingPlan> PlanTracking(const sim::Plant& plant, const VectorXd& values, const MotionFn& motion,
                                  double duration_s, double interval_s, const VectorXd& torque_limit) {
  const PlanningModel planned = MakePlanningModel(plant, values);
  const PlanningModel stiff = WithStiffDrives(planned);
  sim::Simulator step(planned.plant, Simulation()), rigid(stiff.plant, Simulation());
  step.SetParameters(planned.values), rigid.SetParameters(stiff.values);
  const int n = plant.num_joints(), K = std::max(1, static_cast<int>(std::lround(duration_s / interval_s)));
  TrackingPlan plan;
  plan.interval_s = interval_s;
  plan.q.resize(n, K), plan.v.resize(n, K), plan.effort.resize(n, K);
  plan.gain.resize(static_cast<size_t>(K));
  std::vector<MatrixXd> A(static_cast<size_t>(K)), B(static_cast<size_t>(K));
  VectorXd q(n), v(n), a(n), u = VectorXd::Zero(n);
  for (int k = 0; k < K; ++k) {
    const double t = k * interval_s;
    motion(t + 0.5 * interval_s, &q, &v, &a);
    RG_RETURN_IF_ERROR(InverseDynamics(rigid, q - planned.encoder_offset, v, a, t, &u));
    RG_RETURN_IF_ERROR(CheckTorque(plant, u, torque_limit, t));
    motion(t, &q, &v, &a);
    plan.q.col(k) = q, plan.v.col(k) = v, plan.effort.col(k) = u;
    const auto i = static_cast<size_t>(k);
    if (!Linearised(step, q - planned.encoder_offset, v, u, interval_s, &A[i], &B[i]))
      return InvalidError("motion: the model cannot be stepped at " + std::to_string(t) + " s");
  }
  VectorXd weight(2 * n);
  weight << VectorXd::Constant(n, 1 / (kPosition * kPosition)),
      VectorXd::Constant(n, 1 / (kVelocity * kVelocity));
  const VectorXd scale = torque_limit.unaryExpr(
      [](double limit) { return kEffort * (std::isfinite(limit) ? limit : kWithoutLimit); });
  const MatrixXd R = scale.cwiseAbs2().cwiseInverse().asDiagonal();
  MatrixXd P = weight.asDiagonal();
  for (int k = K - 1; k >= 0; --k) {
    const auto i = static_cast<size_t>(k);
    const MatrixXd PB = P * B[i];
    plan.gain[i] = (R + B[i].transpose() * PB).llt().solve(PB.transpose() * A[i]);
    P = A[i].transpose() * P * (A[i] - B[i] * plan.gain[i]);
    P = 0.5 * (P + P.transpose()).eval();
    P.diagonal() += weight;
  }
  return plan;
}

}  // namespace rg::trajectories
