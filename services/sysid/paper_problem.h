// The identification problem of Collins et al. as their paper sets it:
//
//   Σ_n Σ_j (q_nj − q̂_nj(p))²  +  Σ_i α_i (p_i − p_init,i)²
//
// over one window of a recording, in joint space, the simulated state set to the robot's at its start,
// on the simulator's step grid with the recorded positions linearly interpolated to it. 71 parameters on
// the Mico²: gravity 3, masses, damping, force gains P_d, inertias xx, yy, zz of every link. Several windows
// are summed, with weights if wanted; those of one length are simulated side by side.
//
// Raw masses and inertias may leave the bodies that can exist. With `consistent_inertias` all ten inertial
// parameters of the heaviest link of each moving body take their place, and p is in the coordinates of
// FitSpace, in which every point is a body: as many unknowns (75 on the Mico²), centres of mass among them.
//
// Bounds of the bounded solver: ±20 % on gravity, mass and inertia, 0 ≤ damping ≤ 18, −1.5 ≤ P_d ≤ 1.5.
// Parameters at zero with relative bounds (gravity x, y; links without inertia) are thereby fixed. Of a body:
// ±20 % on the mass, and at a given mass on its second moments; its centre and its axes are fixed.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording.h"
#include "common/sim/plant.h"
#include "common/sim/simulator.h"
#include "services/sysid/fit_space.h"
#include "services/sysid/least_squares.h"

namespace rg::sysid {

struct PaperWindow {
  double start_s = 0.0;   // after the recording's first row
  double length_s = 0.2;  // infinity: to the end
  double weight = 1.0;    // of its squared residuals, > 0
};

struct PaperOptions {
  std::vector<PaperWindow> windows = {{}};
  // true: residuals on the simulator's step grid (the paper's); false: at the recording's rows only.
  bool interpolate = true;
  double relative_bound = 0.2;
  double damping_upper = 18.0;
  double gain_bound = 1.5;
  // Parameters beyond the paper's (indices into the plant's table), after them: what an augmented plant
  // has of friction and rotors. Bounds and scale are the table's.
  std::vector<int> extra_parameters;
  bool consistent_inertias = false;  // bodies instead of the paper's raw masses and inertias
  double alpha = 0.0;  // regulariser of every parameter in units of its scale: α_i = alpha / scale_i²
  sim::SimulatorOptions simulator;
};

class PaperProblem {
 public:
  // `initial`: values of the plant's whole table at which the search starts (p_init). With
  // consistent_inertias a link in it that is no body is replaced by the nearest that is.
  // Error: a window that holds fewer than two rows or lies outside the recording.
  static Result<PaperProblem> Create(const sim::Plant& plant, const Eigen::VectorXd& initial,
                                     const recordings::Recording& recording,
                                     const PaperOptions& options = {});
  ~PaperProblem();
  PaperProblem(PaperProblem&&) noexcept;
  PaperProblem& operator=(PaperProblem&&) noexcept;

  // To be given to Solve and RunHops; valid as long as this object. One thread at a time.
  const LeastSquaresProblem& problem() const;
  // Indices into the plant's table of what p stands for: the paper's order, bodies, then extra_parameters.
  const std::vector<int>& parameters() const;
  // The coordinates p.
  const FitSpace& space() const;
  // The whole table with what was fitted replaced.
  Eigen::VectorXd FullValues(const Eigen::VectorXd& p) const;
  int windows() const;
  // Times of the residuals, window by window; residual k·n + j is joint j at times()[k].
  const std::vector<double>& times() const;

 private:
  struct Impl;
  explicit PaperProblem(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rg::sysid
