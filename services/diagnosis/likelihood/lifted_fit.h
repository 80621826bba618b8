// Fits a plant with effects to recordings: lifted multiple shooting.
//
// Every window carries its own states x_k at nodes about 10 ms apart. With e_k the correction of x_k,
//
//   e_{k+1} = A_k e_k + P_k δθ + B_k δτ_k + d_k ,   d_k = F(x_k, u_k; θ) − x_{k+1}
//   y_k     = h(x_k) + H_k e_k + … + ν_k            ν: white, sensors' noise
//
// is linear, so θ and every window's e_0 (eliminated by QR) follow from one least-squares problem, and the
// states from a forward pass. Iterated, this is Gauss-Newton for the whole problem: at the solution d = 0
// and each window is one simulation. Since the states start at the recorded motion and not at what a wrong
// model makes of it, a wrong model or a sensitive arm does not break it (Albersmeyer & Diehl 2010).
//
// δτ are features, candidate forces: screen.h.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <initializer_list>
#include <string_view>
#include <vector>

#include "common/sim/plant.h"
#include "common/sim/simulator.h"
#include "services/diagnosis/data/fit_data.h"
#include "services/sysid/fit_parameters.h"

namespace rg::diagnosis {

using effects::EffectSpec;

// States at the nodes of every window: nx × (N + 1) each.
using NodeStates = std::vector<MatrixXd>;

struct FitModel {
  sim::Plant plant;
  VectorXd values;                              // of the plant's table
  std::vector<sysid::FitParameter> parameters;  // free ones; θ0 = nominal, prior_stddev
};

struct LiftedOptions {
  int iterations = 6;
  int more_iterations = 0;       // while each lowers the cost
  double still_falling = 0.005;  // by this share of it
  // The cost that it must come to: it ends where, at the pace at which it falls, it would not in the
  // iterations that are left. 0: none.
  double to_beat = 0;
  int threads = 1;
  double noise_scale = 1.0;  // residual variance in units of the sensors' noise
  double step_s = 2e-3;      // of the simulator
  // The step is halved down to this if its error is large against the fit's misfit. Error that the parameters
  // absorb hides no missing effect, and counts only in the last fit of a search (for_values).
  double shortest_step_s = 3e-4;
  bool for_values = false;  // not sent to workers: such a fit is made where the search runs
  // Hidden states start where they fit best; else where they are given, a motor with its link.
  bool free_hidden = true;
  sim::Integrator integrator = sim::Integrator::kLeapfrog;
};

// What a computation costs, the same on every machine: about its seconds on one thread of a core of 2024. Of
// simulating all windows of a plant with so many states; of linearising them in so many unknowns; and of a
// screen of so many columns beside parameters, with draws of the null.
double SimulationWork(const FitData& data, const LiftedOptions& options, long states);
double LinearisationWork(const FitData& data, const LiftedOptions& options, long states, long columns);
double ScreenWork(const FitData& data, const LiftedOptions& options, long states, long parameters,
                  long columns, int draws);

// How the names of lags' states begin, which commands alone settle, and those of bristles, which their joint
// settles as soon as it slides; the joint's name follows.
inline constexpr std::string_view kLagState = "lagged_torque.";
inline constexpr std::string_view kBristleState = "bristle.";
// Place of the position of a joint's motor, which a spring or play lets move, among the hidden states; its
// speed follows. −1: none.
int MotorOf(const sim::Plant& plant, const std::string& joint);
// Whether a plant has hidden states of other kinds than these; any that the commands alone do not settle, as
// they do a lag's.
bool HasStatesBut(std::initializer_list<std::string_view> kinds, const sim::Plant& plant);
inline bool HasFreeStates(const sim::Plant& plant) { return HasStatesBut({kLagState}, plant); }

struct FitResult {
  VectorXd values;
  NodeStates states;
  double chi2 = 0;  // of the simulated windows, far residuals softened; of a mass in springs with its jumps
  std::vector<double> window_chi2;  // (jumps.h)
  double prior_cost = 0;            // Σ ((θ−θ0)/σ)²
  MatrixXd information;             // P × P, without priors, divided by noise_scale
  VectorXd stddev;                  // P, posterior
  VectorXd theta;                   // P
  int rows = 0;
  int iterations = 0;
  double step_s = 0;  // that the simulator took; 0: no fit
  double work = 0;    // of all its simulations and linearisations
  bool ok = false;
  // log evidence: −½χ²/s² − ½ prior cost − ½ log det(1 + σ H σ) − what free hidden starts cost
  double evidence = 0;
};

// ½ log det of the factored matrix.
double HalfLogDet(const Eigen::LLT<MatrixXd>& factor);

// What data of an information H (P × P) leave of a prior N(·, diag σ²).
struct Posterior {
  double half_log_det = 0;  // ½ log det(1 + σHσ), the Occam factor, nats
  VectorXd stddev;          // P
};
Posterior PosteriorOf(const MatrixXd& information, const VectorXd& sigma);

// The same for fits that keep their step.
LiftedOptions KeepingStep(LiftedOptions options);
// With the step that a fit took: for what goes on from its result.
LiftedOptions AsFitted(LiftedOptions options, const FitResult& fit);

NodeStates InitialStates(const FitData& data, const FitModel& model, const LiftedOptions& options);
// `start`: states to start from, the plant's own layout; without them from the recorded motion.
FitResult Fit(const FitData& data, const FitModel& model, const LiftedOptions& options,
              const NodeStates* start = nullptr);
// The states of a fitted plant as a start for another: what both have is kept.
NodeStates CarriedStates(const FitData& data, const FitModel& to, const sim::Plant& from,
                         const NodeStates& states, const LiftedOptions& options);

}  // namespace rg::diagnosis
