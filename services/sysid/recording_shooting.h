// Multiple shooting over recordings: the ShootingModel that simulates.
//
// A recording is cut into windows (recordings/windows.h). Within a window the unknowns ξ are the initial
// state in units of what is known of it: q0 = measured + σ_q ξ_q, v0 = measured or smoothed + σ_v ξ_v, and,
// where the plant has internal states and `internal_state_stddev` > 0, z0 = settled + σ_z ξ_z. Residuals
// are positions and, where measured, velocities, at the window's rows (thinned to a rate), each divided
// by its scale: the sensors' noise at first, what the residuals themselves show later.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "common/recordings/noise.h"
#include "common/sim/plant.h"
#include "common/sim/simulator.h"
#include "services/sysid/fit_space.h"
#include "services/sysid/initial_regression.h"
#include "services/sysid/multiple_shooting.h"

namespace rg::sysid {

struct RecordingShootingOptions {
  double window_s = 1.0;
  double residual_rate_hz = 25.0;  // at most about this many rows per second become residuals
  bool use_velocity = true;        // where it is measured
  int max_windows = 1 << 30;       // more are thinned evenly
  double internal_state_stddev = 0.0;
  sim::SimulatorOptions simulator;
};

// Scales of residuals and initial states per joint, n each.
struct ShootingScales {
  Eigen::VectorXd position, velocity;                  // of residuals
  Eigen::VectorXd initial_position, initial_velocity;  // σ_q, σ_v
};
ShootingScales ScalesOf(const recordings::SensorNoise& noise);

class RecordingShooting final : public ShootingModel {
 public:
  // `values`: the plant's table; the fit parameters in it are replaced by p(θ). `space`, `recordings` and
  // what they point to outlive this. `workers` simulators are made.
  RecordingShooting(const sim::Plant& plant, const Eigen::VectorXd& values, const FitSpace& space,
                    const std::vector<FitRecording>& recordings, const ShootingScales& scales,
                    const RecordingShootingOptions& options, int workers);
  ~RecordingShooting() override;

  int num_parameters() const override;
  int num_windows() const override;
  int window_unknowns(int window) const override;
  int window_residuals(int window) const override;
  bool Evaluate(int worker, int window, const Eigen::VectorXd& theta, const Eigen::VectorXd& xi,
                Eigen::VectorXd* r, RowMatrix* dr_dtheta, RowMatrix* dr_dxi) override;
  // In SIMD lanes where the plant allows them (sim/simulator.h) and there is more than one window.
  int side_by_side() const override;
  void EvaluateMany(int worker, const Eigen::VectorXd& theta, std::vector<Evaluation>* windows) override;

  // Spread of a solution's residuals per joint in SI units: median absolute value · 1.4826, robust;
  // velocity is empty where it is not used.
  void ResidualSpread(const std::vector<Eigen::VectorXd>& residuals, Eigen::VectorXd* position,
                      Eigen::VectorXd* velocity) const;

 private:
  struct Window;
  struct Worker;
  // Initial state of a window at ξ, under the worker's present parameters.
  sim::State StartOf(const Worker& worker, const Window& window, const Eigen::VectorXd& xi) const;
  // False: the simulation failed.
  bool WriteWindow(const Window& window, const sim::Trajectory& out, const Eigen::VectorXd& theta,
                   Eigen::VectorXd* r, RowMatrix* dr_dtheta, RowMatrix* dr_dxi) const;
  void WriteResiduals(const Window& window, const sim::Trajectory& out, Eigen::VectorXd* r) const;
  void WriteJacobians(const Window& window, const sim::Trajectory& out, RowMatrix* dr_dtheta,
                      RowMatrix* dr_dxi) const;

  int n_, nz_, P_;
  bool with_velocity_ = false;
  const FitSpace& space_;
  ShootingScales scales_;
  RecordingShootingOptions options_;
  std::vector<Window> windows_;
  std::vector<std::unique_ptr<Worker>> workers_;
};

// Bounds and priors of a shooting problem from the fit space.
ShootingProblem ShootingProblemFor(ShootingModel* model, const FitSpace& space);

}  // namespace rg::sysid
