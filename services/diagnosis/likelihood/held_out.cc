#include "services/diagnosis/likelihood/held_out.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "services/diagnosis/likelihood/followed_fit.h"
#include "services/diagnosis/likelihood/jumps.h"
#include "services/diagnosis/likelihood/screen.h"
#include "services/diagnosis/likelihood/swing_starts.h"
#include "services/sysid/fit_space.h"

namespace rg::diagnosis {

namespace {

constexpr int kRestartIterations = 3;     // of the windows' starts alone
constexpr double kWindowShare = 0.5;      // of the windows, that a continuous swing must fit
constexpr double kWorthSimulating = 1.0;  // nats that the linear model promises
constexpr int kFreeIterations = 8;        // where hidden starts are free; as many more while the cost falls

// In units of the parameters' priors.
struct Learned {
  MatrixXd before, after;  // P × P: precision without and with the held-out rows
  VectorXd gradient;       // P: of the held-out rows
};

Learned LearnedFrom(const FitData& held_out, const Candidate& c, const NodeStates& states,
                    const LiftedOptions& options) {
  const auto P = static_cast<long>(c.parameters.size());
  const Screen screen = MakeScreen(held_out, FitModel{*c.plant, c.fit.values, c.parameters}, states, {},
                                   options, {}, 0, Rng(1));
  const VectorXd sigma = sysid::PriorStddevs(c.parameters);
  Learned out;
  out.before = MatrixXd::Identity(P, P) + sigma.asDiagonal() * c.fit.information * sigma.asDiagonal();
  out.after = out.before + sigma.asDiagonal() * screen.gram.topLeftCorner(P, P) * sigma.asDiagonal();
  out.gradient = sigma.cwiseProduct(screen.gram.col(P).head(P));
  return out;
}

// Starts of the windows with hidden states continued from the window before, itself fitted with a free
// start: a motor keeps its deflection against the link. (Carried along the recorded motion instead, the
// sensors' noise would excite a stiff spring at every row.) A window without a predecessor starts as fitted.
NodeStates Continued(const FitData& held_out, const sim::Plant& plant, const VectorXd& values,
                     const FitResult& followed, const LiftedOptions& options, NodeStates starts) {
  const int n = held_out.n;
  sim::Simulator simulator(plant, {.integrator = options.integrator, .step_s = options.step_s});
  simulator.SetParameters(values);
  for (size_t w = 0; w < starts.size(); ++w) {
    const NodeWindow &window = held_out.windows[w], &before = held_out.windows[w > 0 ? w - 1 : 0];
    if (w == 0 || !FollowsOn(before, window)) {
      if (followed.states[w].col(0).allFinite()) starts[w].col(0) = followed.states[w].col(0);
      continue;
    }
    // Simulated, since the lifted nodes are those of the linear model.
    const VectorXd from = followed.states[w - 1].col(0);
    const auto simulated = SimulatedTo(window.t.front(), held_out, simulator, before, from);
    if (!simulated) continue;
    const VectorXd& end = *simulated;
    auto start = starts[w].col(0);
    start = followed.states[w].col(0);
    start.tail(end.size() - 2 * n) = end.tail(end.size() - 2 * n);
    for (int j = 0; j < n; ++j) {
      const int at = MotorOf(plant, plant.joint_names()[j]), motor = 2 * n + at;
      if (at < 0) continue;
      start[motor] += start[j] - end[j], start[motor + 1] += start[n + j] - end[n + j];
    }
  }
  return starts;
}

// Of each window the likelier start of two: the one predicted, or the one that fits with what its distance
// from the predicted one costs. Where contact is met a little earlier than predicted, only the latter counts.
void TakeLikelier(const FitResult& other, FitResult* out) {
  if (!out->ok || !other.ok) return;
  for (size_t w = 0; w < out->window_chi2.size(); ++w) {
    if (!(other.window_chi2[w] < out->window_chi2[w])) continue;
    out->chi2 += other.window_chi2[w] - out->window_chi2[w];
    out->window_chi2[w] = other.window_chi2[w], out->states[w] = other.states[w];
  }
}

// `swing_continues`: as in HeldOut.
FitResult Restarted(const FitData& held_out, const Candidate& c, const VectorXd& values,
                    const LiftedOptions& options, bool* swing_continues = nullptr) {
  const FitModel model{*c.plant, values, {}};
  if (c.plant->num_states() == 2 * held_out.n) return Fit(held_out, model, options);
  LiftedOptions free = options;
  free.free_hidden = true, free.iterations = kFreeIterations, free.more_iterations = kFreeIterations;
  double work = 0;
  NodeStates swinging;
  if (HasPendulum(c.specs))
    swinging = FollowedStates(held_out, model, free, InitialStates(held_out, model, free), true, &work);
  FitResult followed = Fit(held_out, model, free, swinging.empty() ? nullptr : &swinging);
  if (!followed.ok) {
    FitResult out = Fit(held_out, model, options);
    out.work += followed.work + work;
    return out;
  }
  if (swing_continues != nullptr && HasPendulum(c.specs)) {
    // Free starts absorb some of the noise.
    const double fits = kExplained * std::max(0.0, 1 - c.plant->num_states() / RowsPerWindow(held_out));
    *swing_continues =
        TypicalChi2(held_out, followed.window_chi2, options.noise_scale, kWindowShare) < fits &&
        SwingsOn(held_out, *c.plant, &followed, free).value_or(false);
  }
  const NodeStates starts =
      Continued(held_out, *c.plant, values, followed, options, InitialStates(held_out, model, options));
  FitResult out = Fit(held_out, model, options, &starts);
  out.work += followed.work + work;
  if (HasPlay(c.specs)) TakeLikelier(WithJumpsInPlay(held_out, *c.plant, std::move(followed), free), &out);
  return out;
}

}  // namespace

HeldOut PredictHeldOut(const FitData& held_out, const Candidate& fitted, const LiftedOptions& options) {
  LiftedOptions restarts = KeepingStep(AsFitted(options, fitted.fit));
  restarts.iterations = kRestartIterations, restarts.more_iterations = 0, restarts.free_hidden = false;
  HeldOut out;
  const FitResult fit = Restarted(held_out, fitted, fitted.fit.values, restarts, &out.swing_continues);
  const auto P = static_cast<long>(fitted.parameters.size());
  out.work = fit.work + LinearisationWork(held_out, restarts, fitted.plant->num_states(), P);
  for (const double chi2 : fit.window_chi2) out.windows.push_back(-0.5 * chi2 / options.noise_scale);
  const double misfit = 0.5 * fit.chi2 / options.noise_scale;
  out.log_density = -misfit;
  out.freedom =
      std::max(0.0, held_out.Rows() - 2.0 * held_out.judged() * static_cast<double>(held_out.windows.size()));
  out.deficit_stddev = std::sqrt(0.5 * out.freedom);
  if (fit.ok && P > 0 && fitted.fit.information.rows() == P) {
    const Learned learned = LearnedFrom(held_out, fitted, fit.states, restarts);
    const Eigen::LLT<MatrixXd> before(learned.before), after(learned.after);
    if (before.info() == Eigen::Success && after.info() == Eigen::Success) {
      for (long i = 0; i < P; ++i)
        out.log_density += std::log(before.matrixLLT()(i, i)) - std::log(after.matrixLLT()(i, i));
      const VectorXd step = after.solve(learned.gradient);
      // The gain by their own best parameters is simulated: where windows diverge, the linear model promises
      // anything.
      if (0.5 * step.dot(learned.gradient) > kWorthSimulating) {
        const sysid::FitSpace space(fitted.parameters, false);
        const VectorXd theta = (fitted.fit.theta + space.prior_stddev().cwiseProduct(step))
                                   .cwiseMax(space.lower())
                                   .cwiseMin(space.upper());
        const FitResult moved = Restarted(
            held_out, fitted, sysid::WithFitted(fitted.parameters, fitted.fit.values, theta), restarts);
        const double paid = 0.5 * step.dot(learned.before * step);
        if (moved.ok)
          out.log_density += std::max(0.0, misfit - 0.5 * moved.chi2 / options.noise_scale - paid);
        out.work += moved.work;
      }
    }
  }
  out.deficit = -0.5 * out.freedom - out.log_density;
  return out;
}

}  // namespace rg::diagnosis
