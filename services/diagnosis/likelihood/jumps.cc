#include "services/diagnosis/likelihood/jumps.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "common/base/parallel.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/lineariser.h"
#include "services/diagnosis/likelihood/swing_starts.h"

namespace rg::diagnosis {

namespace {

constexpr double kInstant = 1e-6;    // s
constexpr double kSingular = 1e-12;  // of the largest, that a covariance has of its own
constexpr int kEnough = 4;           // of so many meetings one must be of windows that are both met
constexpr double kOfItsSwing = 0.1;  // of the nats that hanging still would be off by, of a step that goes on

// Rows that say of a plant's state what goes on, k × nx.
MatrixXd AsRows(const std::vector<VectorXd>& of, long nx) {
  MatrixXd out(of.size(), nx);
  for (size_t i = 0; i < of.size(); ++i) out.row(i) = of[i];
  return out;
}

// The states of a moving mass.
MatrixXd OfMass(const sim::Plant& plant) {
  std::vector<VectorXd> out;
  const auto& names = plant.internal_state_names();
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i].find(".slosh_") != std::string::npos || names[i].find(".swing_") != std::string::npos)
      out.push_back(VectorXd::Unit(plant.num_states(), 2L * plant.num_joints() + static_cast<long>(i)));
  }
  return AsRows(out, plant.num_states());
}

bool IsPlay(const EffectSpec& e) { return !effects::InferenceOf(e.id).stays.empty(); }

// Where each motor behind play is against its link, and how fast.
MatrixXd OfPlay(const sim::Plant& plant) {
  std::vector<VectorXd> out;
  const long n = plant.num_joints(), nx = plant.num_states();
  for (const EffectSpec& e : plant.effects()) {
    if (!IsPlay(e)) continue;
    for (const std::string& joint : e.joints) {
      const long link = plant.model().FindJoint(joint), motor = 2 * n + MotorOf(plant, joint);
      out.push_back(VectorXd::Unit(nx, motor) - VectorXd::Unit(nx, link));
      out.push_back(VectorXd::Unit(nx, motor + 1) - VectorXd::Unit(nx, n + link));
    }
  }
  return AsRows(out, nx);
}

// χ² of k normal variables that one of a hundred exceeds (Wilson & Hilferty 1931).
double OnePercentChi2(double k) {
  const double spread = 2.0 / (9.0 * k);
  return k * std::pow(1.0 - spread + kZ99OneSided * std::sqrt(spread), 3);
}

// The window with a node at `t`, where nothing is measured.
void ContinueTo(double t, NodeWindow* window) {
  const long k = window->q.cols();
  for (const auto m : kNodeMatrices) {
    MatrixXd& of = window->*m;
    of.conservativeResize(Eigen::NoChange, k + 1);
    of.col(k) = MatrixXd(of.col(k - 1));
  }
  window->t.push_back(t), window->measured.push_back(0);
  window->before.emplace_back(), window->after.emplace_back();
}

// `data` with windows that end where the next begins: their nodes need not divide a window's rows.
FitData Meeting(const FitData& data) {
  FitData out = data;
  for (size_t w = 1; w < out.windows.size(); ++w) {
    NodeWindow& before = out.windows[w - 1];
    const double t = out.windows[w].t.front();
    if (FollowsOn(before, out.windows[w]) && t > before.t.back() + kInstant) ContinueTo(t, &before);
  }
  return out;
}

// What a window alone knows of what goes on.
struct Ends {
  VectorXd start, end;
  MatrixXd start_covariance, end_covariance;
  bool ok = false;
};

// Inverse of a precision whose states have units of their own; what no row depends on (a lag's start, which
// is not free) has no share in it.
MatrixXd Inverse(const MatrixXd& precision) {
  const VectorXd root = precision.diagonal().cwiseSqrt();
  const VectorXd scale = (root.array() > 0).select(root.cwiseInverse(), 0.0);
  MatrixXd scaled = scale.asDiagonal() * precision * scale.asDiagonal();
  scaled.diagonal().array() += kSingular;
  return scale.asDiagonal() * scaled.ldlt().solve(MatrixXd::Identity(scaled.rows(), scaled.cols())) *
         scale.asDiagonal();
}

Ends EndsOf(Lineariser& lin, int worker, int window, const MatrixXd& of, MatrixXd states,
            const ArrivalCost& loose, double noise_scale) {
  Ends out;
  lin.Simulate(worker, window, &states);
  Linear linear;
  lin.Run(worker, window, states, nullptr, nullptr, true, &linear);
  if (!linear.ok || !states.allFinite()) return out;
  MatrixXd precision = linear.J_e().transpose() * linear.J_e() / noise_scale;
  precision.diagonal() += loose.precision;
  const MatrixXd covariance = Inverse(precision);
  const MatrixXd to_end = linear.Node(linear.nodes() - 1).leftCols(precision.cols());
  out.start = of * states.col(0), out.end = of * states.col(states.cols() - 1);
  out.start_covariance = of * covariance * of.transpose();
  const MatrixXd end_covariance = to_end * covariance * to_end.transpose();
  out.end_covariance = of * end_covariance * of.transpose();
  out.ok = out.start_covariance.allFinite() && out.end_covariance.allFinite();
  return out;
}

// Nats that a step takes; infinite where it is beyond numbers.
double StepNats(const VectorXd& step, const MatrixXd& covariance) {
  const double nats = 0.5 * step.dot(Inverse(covariance) * step);
  return nats >= 0 && std::isfinite(nats) ? nats : std::numeric_limits<double>::infinity();
}

// A step of a rod's states (angle and rate about the first axis of its hinge, then about the second) with
// angles within half a turn.
VectorXd Wrapped(VectorXd step) {
  for (const int angle : {0, 2}) step[angle] = std::remainder(step[angle], 2 * M_PI);
  return step;
}

// The other angles at which a rod lies and moves alike.
VectorXd TheOtherWay(const VectorXd& rod) {
  return (VectorXd(4) << rod[0] + M_PI, rod[1], M_PI - rod[2], -rod[3]).finished();
}

// What each window alone knows of it.
std::vector<Ends> AllEnds(const FitData& data, const sim::Plant& plant, const MatrixXd& of,
                          const FitResult& fit, const LiftedOptions& options) {
  const FitData meeting = Meeting(data);
  Lineariser lin(meeting, FitModel{plant, fit.values, {}}, false, options);
  const std::vector<ArrivalCost> loose = ArrivalCosts(plant, fit.states);
  std::vector<Ends> ends(data.windows.size());
  ParallelFor(options.threads, static_cast<int>(ends.size()), [&](int worker, int w) {
    const auto i = static_cast<size_t>(w);
    ends[i] = EndsOf(lin, worker, w, of, fit.states[i], loose[i], options.noise_scale);
  });
  return ends;
}

// Whether a window goes on from the one before, as far as both tell.
bool Meet(const FitData& data, const std::vector<Ends>& ends, size_t w) {
  return w > 0 && FollowsOn(data.windows[w - 1], data.windows[w]) && ends[w - 1].ok && ends[w].ok;
}

// Of a rod, whose two ways to lie alike are one.
double RodStepNats(const VectorXd& from, const MatrixXd& covariance, const Ends& to) {
  const VectorXd sign = (VectorXd(4) << 1, 1, -1, -1).finished();
  const MatrixXd turned = sign.asDiagonal() * covariance * sign.asDiagonal();
  return std::min(StepNats(Wrapped(to.start - from), covariance + to.start_covariance),
                  StepNats(Wrapped(to.start - TheOtherWay(from)), turned + to.start_covariance));
}

FitResult WithJumpsOf(const MatrixXd& of, const FitData& data, const sim::Plant& plant, FitResult fit,
                      const LiftedOptions& options) {
  const std::vector<Ends> ends = AllEnds(data, plant, of, fit, options);
  const int nx = plant.num_states();
  fit.work += LinearisationWork(data, options, nx, nx);
  for (size_t w = 1; w < ends.size(); ++w) {
    if (!Meet(data, ends, w)) continue;
    const double nats =
        StepNats(ends[w].start - ends[w - 1].end, ends[w - 1].end_covariance + ends[w].start_covariance);
    if (std::isinf(nats)) {  // thrown beyond what numbers hold
      fit.ok = false;
      continue;
    }
    fit.chi2 += 2 * nats * options.noise_scale, fit.window_chi2[w] += 2 * nats * options.noise_scale;
    fit.evidence -= nats;
  }
  return fit;
}

}  // namespace

FitResult WithJumps(const FitData& data, const sim::Plant& plant, FitResult fit,
                    const LiftedOptions& options) {
  return WithJumpsOf(OfMass(plant), data, plant, std::move(fit), options);
}

bool HasPlay(const std::vector<EffectSpec>& specs) { return std::ranges::any_of(specs, IsPlay); }

FitResult WithJumpsInPlay(const FitData& data, const sim::Plant& plant, FitResult fit,
                          const LiftedOptions& options) {
  return WithJumpsOf(OfPlay(plant), data, plant, std::move(fit), options);
}

std::optional<bool> SwingsOn(const FitData& data, const sim::Plant& plant, FitResult* fitted,
                             const LiftedOptions& options) {
  const FitResult& fit = *fitted;
  const MatrixXd mass = OfMass(plant);
  const std::vector<Ends> ends = AllEnds(data, plant, mass, fit, options);
  const double noise = 0.5 * OnePercentChi2(static_cast<double>(mass.rows()));
  sim::Simulator simulator(plant, {.integrator = options.integrator, .step_s = options.step_s});
  simulator.SetParameters(fit.values);
  fitted->work += LinearisationWork(data, options, plant.num_states(), plant.num_states());
  const double met_below = kFitted * options.noise_scale * RowsPerWindow(data);
  const auto met = [&](size_t w) { return fit.window_chi2[w] < met_below; };
  int meetings = 0, both_met = 0, goes_on = 0;
  for (size_t w = 1; w < ends.size(); ++w) {
    if (!Meet(data, ends, w)) continue;
    ++meetings;
    if (!met(w - 1) || !met(w)) continue;
    const MatrixXd& known = ends[w - 1].end_covariance;
    const VectorXd hangs = mass * HangingFrom(simulator, fit.states[w].col(0));
    const double step = RodStepNats(ends[w - 1].end, known, ends[w]);
    const double swing = RodStepNats(hangs, known, ends[w]);
    ++both_met, goes_on += step < noise || (std::isfinite(swing) && step < kOfItsSwing * swing);
  }
  if (meetings == 0) return std::nullopt;
  return kEnough * both_met >= meetings && 2 * goes_on > both_met;
}

double TrueJumps(const FitData& data, const sim::Plant& plant, double noise_scale) {
  if (!HasMassInSprings(plant.effects())) return 0;
  double meetings = 0;
  for (size_t w = 1; w < data.windows.size(); ++w)
    meetings += FollowsOn(data.windows[w - 1], data.windows[w]);
  return meetings * static_cast<double>(OfMass(plant).rows()) * noise_scale;
}

}  // namespace rg::diagnosis
