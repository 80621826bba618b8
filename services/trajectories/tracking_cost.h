// Quadratic goal tracking for a mechanical system, in Gauss-Newton form.
//
//   l   = ½ h [ (q−g)ᵀ W_q (q−g) + vᵀ W_v v + aᵀ W_a a + (u−ū)ᵀ W_u (u−ū) ],   a = (v⁺ − v) / h
//   l_N = ½   [ (q−g)ᵀ W_qN (q−g) + vᵀ W_vN v ]
//
// x = (q, v, rest), n joints each; h [s] the control interval; g the goal; all W diagonal.
// a is the mean acceleration over the interval, taken from the step itself, so that holding a pose
// against gravity (or whatever else the plant contains) costs nothing and no second model of gravity is
// needed; its derivatives are the velocity rows of A and B. ū is a reference torque, by default 0.
#pragma once

#include <Eigen/Core>

#include "services/trajectories/control_problem.h"

namespace rg::trajectories {

struct TrackingWeights {
  Eigen::VectorXd position;           // W_q  [1/(rad²·s)]
  Eigen::VectorXd velocity;           // W_v  [s/rad²]
  Eigen::VectorXd acceleration;       // W_a  [s³/rad²]
  Eigen::VectorXd effort;             // W_u  [1/(N²m²·s)]
  Eigen::VectorXd terminal_position;  // W_qN [1/rad²]
  Eigen::VectorXd terminal_velocity;  // W_vN [s²/rad²]

  // The same six figures for each of n joints.
  static TrackingWeights Uniform(int n, double position, double velocity, double acceleration, double effort,
                                 double terminal_position, double terminal_velocity);
  // Every joint like a double integrator under the regulator of ∫ e² + 2ω⁻² v² + ω⁻⁴ a² dt, whose closed
  // loop has both poles at −ω [rad/s]; terminal weights are the diagonal of that regulator's cost to go.
  // `torque_limit` (n × 1) scales a small effort weight that keeps R positive definite where a torque
  // does not act within one interval (lags).
  static TrackingWeights ForBandwidth(double omega, const Eigen::VectorXd& torque_limit);
};

class TrackingCost {
 public:
  // nu = n. nx ≥ 2n.
  TrackingCost(int n, int nx, double interval_s, TrackingWeights weights);

  void set_goal(const VecIn& goal) { goal_ = goal; }                    // n
  void set_effort_reference(const VecIn& torque) { effort_ = torque; }  // n
  const Eigen::VectorXd& goal() const { return goal_; }

  double Stage(const VecIn& x, const VecIn& u, const VecIn& x_next) const;
  void StageQuadratic(const VecIn& x, const VecIn& u, const VecIn& x_next, const MatIn& A, const MatIn& B,
                      QuadraticCost* out);
  double Terminal(const VecIn& x) const;
  void TerminalQuadratic(const VecIn& x, MatOut Q, VecOut q) const;

 private:
  int n_, nx_;
  double h_;
  TrackingWeights w_;
  Eigen::VectorXd goal_, effort_, a_;
  Eigen::MatrixXd a_dx_, a_du_;  // √(h W_a) · da/dx, n × nx, and da/du, n × n
};

}  // namespace rg::trajectories
