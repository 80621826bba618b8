// Gauss-Newton (Levenberg-Marquardt) over many windows whose initial states are unknown too.
//
//   ½ Σ_w [ Σ_k ρ(r_wk(θ, ξ_w)) + |ξ_w|² ]  +  ½ Σ_i π_i (θ_i − θ0_i)²        lower ≤ θ ≤ upper
//
// θ are the shared unknowns (P), ξ_w those of window w alone: its initial state in units of what is
// known about it beforehand (measured state, sensor noise), so that its prior is the unit normal. r is
// whitened. ρ is Huber's: r² for |r| ≤ k, 2k|r| − k² beyond.
//
// Each window's ξ is eliminated by its own small Schur complement, so the cost grows linearly with the
// number of windows and a step solves P × P. Windows run in groups on several threads; sums are taken in the
// windows' order, so the result does not depend on the number of threads. Bounds hold exactly
// (projected active set). A window whose simulation is not finite or exploded counts as a
// fixed cost above any other and has no say in the step: it does not stop the others, and no step gains by
// breaking one.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "services/sysid/least_squares.h"

namespace rg::sysid {

class ShootingModel {
 public:
  virtual ~ShootingModel() = default;
  virtual int num_parameters() const = 0;  // P
  virtual int num_windows() const = 0;
  virtual int window_unknowns(int window) const = 0;  // size of ξ_w
  virtual int window_residuals(int window) const = 0;
  // r: window_residuals. dr_dtheta: × P and dr_dxi: × window_unknowns, both null or both not; all sized
  // on entry. False: not finite. Called from `threads` threads at once, each with its own `worker`.
  virtual bool Evaluate(int worker, int window, const Eigen::VectorXd& theta, const Eigen::VectorXd& xi,
                        Eigen::VectorXd* r, RowMatrix* dr_dtheta, RowMatrix* dr_dxi) = 0;

  // One window of EvaluateMany: what Evaluate is given and returns.
  struct Evaluation {
    int window = 0;
    const Eigen::VectorXd* xi = nullptr;
    Eigen::VectorXd* r = nullptr;
    RowMatrix *dr_dtheta = nullptr, *dr_dxi = nullptr;
    bool ok = false;
  };
  // Windows that are cheaper together than one by one: as many as this, or more, are handed to EvaluateMany.
  virtual int side_by_side() const { return 1; }
  // The Jacobians of all or of none. A window's result must not depend on the others, not by a bit.
  virtual void EvaluateMany(int worker, const Eigen::VectorXd& theta, std::vector<Evaluation>* windows);
};

struct ShootingOptions {
  int max_iterations = 30;
  double huber = 3.0;                // k, in stddev; infinity: plain least squares
  double relative_tolerance = 1e-5;  // ends when the cost falls by less, twice in a row
  double initial_damping = 1e-3;
  int threads = 1;
};

struct ShootingProblem {
  ShootingModel* model = nullptr;     // not owned
  Eigen::VectorXd theta0;             // P
  Eigen::VectorXd prior_information;  // P, π ≥ 0: 1/stddev²
  Eigen::VectorXd scale;              // P, > 0: a typical change, for the damping
  Eigen::VectorXd lower, upper;       // P
};

struct ShootingSolution {
  Eigen::VectorXd theta;
  std::vector<Eigen::VectorXd> xi;         // per window
  std::vector<Eigen::VectorXd> residuals;  // per window, whitened; empty where not finite
  double cost = 0.0;
  int iterations = 0;
  int failed_windows = 0;  // at the solution
  Termination termination = Termination::kFailed;
  Eigen::MatrixXd information;  // P × P: the data's, ξ eliminated, without the priors, robust weights in
  // How much more the windows' scores vary than `information` says, averaged over what the data
  // determine: 1 when the noise is white and as assumed; larger with model error (sandwich estimator,
  // windows as clusters).
  double variance_inflation = 1.0;
};

using ShootingProgress = std::function<void(int iteration, double cost)>;

// Starts from `theta` and ξ = 0, or from `xi` when it is not empty.
ShootingSolution SolveShooting(const ShootingProblem& problem, const Eigen::VectorXd& theta,
                               const std::vector<Eigen::VectorXd>& xi, const ShootingOptions& options,
                               const StopCondition& stop, const ShootingProgress& progress = {});

}  // namespace rg::sysid
