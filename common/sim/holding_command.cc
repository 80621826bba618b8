#include "common/sim/holding_command.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <utility>
#include <vector>

#include "common/base/check.h"

namespace rg::sim {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr double kInstant = 1e-3;    // s: over which a robot is let go
constexpr double kAtRest = 1e-5;     // rad/s or m/s after it
constexpr int kNewtonSteps = 8;
constexpr double kPush = 0.02;       // of the largest command, to see how a joint answers
constexpr double kLeastPush = 1e-3;  // N·m or N
constexpr double kDamping = 1e-10;   // of the normal equations: joints that stick answer nothing

// Speeds after an instant from rest; not finite where it cannot be simulated.
VectorXd LetGo(Simulator& simulator, const VectorXd& q, const VectorXd& u) {
  State x = simulator.MakeState(q, VectorXd::Zero(q.size()), 0, &u);
  if (!simulator.Advance(x, u, kInstant).ok()) return VectorXd::Constant(q.size(), std::nan(""));
  return x.v;
}

}  // namespace

VectorXd HoldingCommand(Simulator& simulator, const VectorXd& q, const VectorXd& u) {
  const double push = std::max(kLeastPush, kPush * u.cwiseAbs().maxCoeff());
  // A joint that dry friction holds creeps.
  const double rest = std::max(kAtRest, simulator.options().stick_velocity);
  VectorXd held = u;
  for (int step = 0; step < kNewtonSteps; ++step) {
    const VectorXd v = LetGo(simulator, q, held);
    if (!v.allFinite()) return u;
    if (v.cwiseAbs().maxCoeff() < rest) return held;
    MatrixXd answer(q.size(), q.size());
    for (Eigen::Index j = 0; j < q.size(); ++j) {
      VectorXd pushed = held;
      pushed[j] += push;
      answer.col(j) = (LetGo(simulator, q, pushed) - v) / push;
    }
    if (!answer.allFinite()) return u;
    MatrixXd normal = answer.transpose() * answer;
    normal.diagonal().array() += kDamping * std::max(1e-12, normal.diagonal().maxCoeff());
    held -= normal.ldlt().solve(answer.transpose() * v);
  }
  return u;
}

CommandSignal HeldBefore(const CommandSignal& command, const VectorXd& held) {
  constexpr double kLongBefore = 10.0;  // s: any drive has settled
  if (command.hold() != Hold::kZeroOrder || command.size() == 0) return command;
  std::vector<double> times = {command.times().front() - kLongBefore};
  times.insert(times.end(), command.times().begin(), command.times().end());
  MatrixXd values(held.size(), command.size() + 1);
  values << held, command.values();
  auto out = CommandSignal::Create(std::move(times), std::move(values), Hold::kZeroOrder);
  RG_CHECK(out.ok()) << out.status().ToString();
  return out->WithMotion(command.motion());
}

}  // namespace rg::sim
