// The identification problem of a task: the paper's parameters and residual, over one window (as the
// paper) or over all windows of a recording, each restarted from the state measured at its start.
//
//   Σ_w Σ_n Σ_j weight_w (q − q̂)²  +  Σ_p α_p (p − p_init)²
//
// A search over a whole recording begins where a regression of the inverse dynamics ends.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording.h"
#include "common/sim/model_file.h"
#include "common/sim/plant.h"
#include "services/sysid/least_squares.h"
#include "services/sysid/paper_problem.h"

namespace realitygrad::v1 {
class IdentifyPayload;
}

namespace rg::jobs {

// Bounds of the search.
enum class BoundsKind {
  kPaper,  // ±20 % on gravity, mass and inertia, 0 ≤ damping ≤ 18, −1.5 ≤ P_d ≤ 1.5
  // What a body and a drive can be, so that what the model lacks (a rotor's reflected inertia, say) has
  // room in what it has: mass 0.3 to 3 ×, inertia 0 to 0.6 kg·m², damping 0 to 30, P_d 0.6 to 1.5; α is
  // then `alpha` over the square of what each may be off (P_d little, damping and inertia much). Of bodies
  // it is the second moments at a given mass that have the inertia's room; centres and axes have FitSpace's.
  kPhysical,
  kNone,
};

struct IdentifyProblemOptions {
  bool whole_recording = true;
  double window_s = 1.0;        // of each window; of the single one
  double window_start_s = 0.0;  // of the single one
  // Weight of one more window, open loop over the whole recording, beside the windows: what makes long
  // predictions hold too. It needs a start that is not far off, so the first rounds go without it.
  double long_weight = 0.0;
  double alpha = 0.0;
  BoundsKind bounds = BoundsKind::kPhysical;
  bool regress = false;   // a search begins at Start(), not at p_init
  bool friction = false;  // fit the effects of WithFriction too
  // Links move as bodies that can exist (sysid/fit_space.h), or by the paper's raw masses and inertias.
  bool consistent_inertias = true;
  sim::SimulatorOptions simulator;
};

IdentifyProblemOptions OptionsOf(const realitygrad::v1::IdentifyPayload& payload);
sysid::Solver SolverOf(const realitygrad::v1::IdentifyPayload& payload);

// The model to be fitted: `model` itself, or, if friction is asked for, with Coulomb friction and rotor
// inertia on every joint that has none yet (nor another law of dry friction, nor a motor behind a spring or a
// gap), at a hundredth of what the catalogue thinks typical.
Result<sim::ModelFile> ModelToFit(const sim::ModelFile& model, const IdentifyProblemOptions& options);

class IdentifyProblem {
 public:
  // `initial`: values of the plant's whole table, p_init for the 71.
  static Result<IdentifyProblem> Create(const sim::Plant& plant, const Eigen::VectorXd& initial,
                                        const recordings::Recording& recording,
                                        const IdentifyProblemOptions& options);

  const sysid::LeastSquaresProblem& problem() const { return problem_; }
  const std::vector<int>& parameters() const { return paper_.parameters(); }
  Eigen::VectorXd FullValues(const Eigen::VectorXd& p) const { return paper_.FullValues(p); }
  // The coordinates p, with what this problem believes of them.
  sysid::FitSpace space() const { return paper_.space().With(problem_); }
  double long_weight() const { return long_weight_; }
  // Where a search begins: at p_init, or, if that costs less, where the regression of the inverse dynamics
  // (services/sysid/initial_regression.h) ends, within the bounds.
  Eigen::VectorXd Start(const sim::Plant& plant, const recordings::Recording& recording) const;
  int windows() const { return paper_.windows(); }

 private:
  IdentifyProblem(sysid::PaperProblem paper, sysid::LeastSquaresProblem problem, double long_weight);
  sysid::PaperProblem paper_;
  sysid::LeastSquaresProblem problem_;  // the paper's, with the bounds that were asked for
  double long_weight_;
};

}  // namespace rg::jobs
