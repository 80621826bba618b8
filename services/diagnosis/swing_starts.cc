#include "services/diagnosis/swing_starts.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/lineariser.h"
#include "services/sysid/parallel.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr int kIterations = 6;       // of a window alone
constexpr Eigen::Index kEvery = 20;  // sample of a motion, to see how its link is turned
constexpr double kFollowOn = 0.9;    // of the χ² before, which another round must come below
constexpr double kMet = 2.0;  // χ² per row below which a window's start is not looked for any further

// A start whose hidden states are those at the end of `before` as simulated from its own start.
bool GoesOn(const FitData& data, sim::Simulator& simulator, const NodeWindow& before, const VectorXd& from,
            double to, VectorXd* start) {
  const long n = data.n;
  const sim::State x{
      from.head(n), from.segment(n, n), from.tail(from.size() - 2 * n), before.t.front(), {}, {}};
  const sim::Trajectory out = simulator.Simulate(x, data.recordings[before.recording].command, {to});
  if (!out.outcome.ok() || !out.state.allFinite()) return false;
  start->tail(from.size() - 2 * n) = out.state.col(0).tail(from.size() - 2 * n);
  return true;
}

// One window alone, from a start of its own.
FitResult Alone(FitData* one, const NodeWindow& window, const FitModel& model, const LiftedOptions& options,
                const MatrixXd& states) {
  one->windows = {window};
  const NodeStates from = {states};
  return Fit(*one, model, options, &from);
}

bool OnRod(const EffectSpec& e) { return e.options.count("form") > 0 && e.options.at("form") == "rod"; }

}  // namespace

bool HasRod(const std::vector<EffectSpec>& specs) {
  return std::any_of(specs.begin(), specs.end(),
                     [](const EffectSpec& e) { return e.id == "sloshing_payload" && OnRod(e); });
}

bool HasMassInSprings(const std::vector<EffectSpec>& specs) {
  return std::any_of(specs.begin(), specs.end(),
                     [](const EffectSpec& e) { return e.id == "sloshing_payload" && !OnRod(e); });
}

bool SwingsOnLastLink(const std::vector<EffectSpec>& specs) {
  return std::any_of(specs.begin(), specs.end(), [](const EffectSpec& e) {
    const auto point = e.options.find("point");
    return e.id == "sloshing_payload" && point != e.options.end() && point->second == "last_link";
  });
}

NodeStates FollowedStates(const FitData& data, const FitModel& given, const LiftedOptions& options,
                          NodeStates states, double* work) {
  const FitModel model{given.plant, given.values, {}};
  std::map<int, std::vector<size_t>> by_recording;  // windows in the order of time
  for (size_t w = 0; w < data.windows.size(); ++w) by_recording[data.windows[w].recording].push_back(w);
  std::vector<std::vector<size_t>> chains;
  for (auto& [recording, chain] : by_recording) {
    std::stable_sort(chain.begin(), chain.end(), [&](size_t a, size_t b) {
      return data.windows[a].t.front() < data.windows[b].t.front();
    });
    chains.push_back(chain);
  }
  std::vector<double> spent(chains.size(), 0.0);
  LiftedOptions alone = options;
  alone.threads = 1, alone.iterations = kIterations, alone.more_iterations = kIterations;
  sysid::ParallelFor(options.threads, static_cast<int>(chains.size()), [&](int, int c) {
    FitData one = data;
    sim::Simulator simulator(model.plant, {.integrator = options.integrator, .step_s = options.step_s});
    simulator.SetParameters(model.values);
    Lineariser lineariser(data, model, false, alone);
    const std::vector<int> no_motor(static_cast<size_t>(data.n), -1);
    const NodeWindow* before = nullptr;
    VectorXd from;
    for (const size_t w : chains[static_cast<size_t>(c)]) {
      const NodeWindow& window = data.windows[w];
      std::vector<MatrixXd> starts;
      VectorXd on = states[w].col(0);
      if (before != nullptr && FollowsOn(*before, window) &&
          GoesOn(data, simulator, *before, from, window.t.front(), &on)) {
        MatrixXd carried = states[w];
        carried.col(0) = on;
        lineariser.CarryHidden(0, window, no_motor, &carried);
        starts.push_back(std::move(carried));
      }
      starts.push_back(states[w]);
      FitResult best;
      for (const MatrixXd& start : starts) {
        const FitResult fit = Alone(&one, window, model, alone, start);
        spent[static_cast<size_t>(c)] += fit.work;
        if (fit.ok && (!best.ok || fit.chi2 < best.chi2)) best = fit;
        if (best.ok && best.chi2 < kMet * best.rows * options.noise_scale) break;
      }
      if (best.ok) states[w] = best.states[0];
      before = &window, from = states[w].col(0);
    }
  });
  for (const double cost : spent) *work += cost;
  return states;
}

FitResult FitFollowed(const FitData& data, FitModel model, const LiftedOptions& options, int rounds) {
  FitResult best;
  double work = 0;
  NodeStates states = InitialStates(data, model, options);
  for (int round = 0; round < rounds; ++round) {
    const NodeStates start = FollowedStates(data, model, options, std::move(states), &work);
    FitResult fit = Fit(data, model, options, &start);
    work += fit.work;
    if (!fit.ok) break;
    const bool better = !best.ok || fit.chi2 < kFollowOn * best.chi2;
    if (!best.ok || fit.evidence > best.evidence) best = fit;
    if (!better || fit.chi2 < kMet * fit.rows * options.noise_scale) break;
    model.values = fit.values, states = std::move(fit.states);
  }
  best.work = work;
  return best;
}

std::vector<EffectSpec> RodStarts(const FitData& data, const sim::Plant& nominal, const EffectSpec& springs) {
  const model::RobotModel& model = nominal.model();
  const std::string& link = SwingsOnLastLink({springs})
                                ? model.link(model.joint(model.num_joints() - 1).child_link).name
                                : model.end_effector().name;
  const model::Frame frame = *model.FindFrame(link);
  const dynamics::Mechanism mechanism(model);
  dynamics::Workspace workspace;
  const Eigen::Vector3d gravity = nominal.options().gravity;
  Eigen::Vector3d along = Eigen::Vector3d::Zero();
  for (const FineMotion& fine : data.fine) {
    for (Eigen::Index k = 0; k < fine.q.cols(); k += kEvery) {
      const model::Pose pose = dynamics::FramePose(mechanism, workspace, fine.q.col(k), frame);
      along += (pose.rotation.transpose() * gravity).cwiseAbs2();
    }
  }
  const auto& of = springs.values.begin()->second;
  // As a point it would swing with this length; a body that is not small does with L + r²/L, and from r = 0
  // no fit leads away.
  const double swings = of.at("mass") * gravity.norm() / of.at("stiffness");
  EffectSpec rod = effects::MakeSpec("sloshing_payload", {},
                                     {{"mass", of.at("mass")},
                                      {"length", 0.9 * swings},
                                      {"radius", 0.3 * swings},
                                      {"damping", of.at("damping")}});
  rod.options = springs.options;
  rod.options["form"] = "rod";
  std::array<int, 3> axes = {0, 1, 2};
  std::stable_sort(axes.begin(), axes.end(), [&](int a, int b) { return along[a] < along[b]; });
  std::vector<EffectSpec> out;
  for (const int axis : {axes[0], axes[1]}) {
    rod.options["hinge"] = std::string(1, "xyz"[axis]);
    out.push_back(rod);
  }
  return out;
}

}  // namespace rg::diagnosis
