#include "services/diagnosis/likelihood/followed_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>

#include "common/base/parallel.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/lineariser.h"
#include "services/diagnosis/likelihood/swing_starts.h"

namespace rg::diagnosis {

namespace {

constexpr int kOneWindow = 6;              // of a window alone, and as many more while they pay
constexpr size_t kNearestSwings = 3;       // that are followed to their end
constexpr int kLook = 1;                   // the same, of each of the swings that it may start from
constexpr double kFollowOn = 0.9;          // of the χ² before, which another round must come below
constexpr double kPieces[] = {0.25, 0.5};  // of a window, on the way
constexpr int kRounds = 6;                 // over pieces of either length
constexpr double kAlone = 2.5;        // times its work, what a window costs that is fitted alone: few lanes
constexpr double kMostPieces = 0.7;   // of all, that are fitted with all that are met
constexpr double kMostWindows = 0.5;  // the same of windows, at first
constexpr int kGrowths = 4;           // of the windows that are met
constexpr double kMostMet = 0.8;      // of the windows, from where the others were lost by chance
constexpr double kFewMet = 0.5;       // of them, below which the model lacks more than their starts

// One window alone, from a start of its own.
FitResult Alone(FitData* one, const NodeWindow& window, const FitModel& model, LiftedOptions options,
                const MatrixXd& states, int iterations) {
  one->windows = {window};
  const NodeStates from = {states};
  options.iterations = options.more_iterations = iterations;
  return Fit(*one, model, KeepingStep(options), &from);
}

// Windows, their states followed at the model's values, and how well these meet the record.
struct Followed {
  const FitData& data;
  const LiftedOptions& options;
  NodeStates states;
  std::vector<double> chi2;
  double work = 0;

  void Follow(const FitModel& model, bool anew) {
    states = FollowedStates(data, model, options, std::move(states), anew, &work, &chi2);
  }

  // The windows that are met best, and all that are met, so many at least.
  std::vector<size_t> MetBest(double share) const {
    std::vector<size_t> order(data.windows.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::ranges::stable_sort(order, [&](size_t a, size_t b) { return chi2[a] < chi2[b]; });
    const double met = kFitted * options.noise_scale * RowsPerWindow(data);
    auto count = static_cast<size_t>(std::ceil(share * static_cast<double>(order.size())));
    while (count < order.size() && chi2[order[count]] < met) ++count;
    order.resize(count);
    std::ranges::sort(order);
    return order;
  }

  // How many of them a fit meets.
  long Met(const std::vector<double>& window_chi2) const {
    const double met = kFitted * options.noise_scale * RowsPerWindow(data);
    return std::ranges::count_if(window_chi2, [&](double c) { return c < met; });
  }

  // A fit to those of them. A window whose start was not found lies far off whatever the mass is, and no step
  // would pay.
  FitResult FitTo(const std::vector<size_t>& which, const FitModel& model) {
    FitData some = data;
    some.windows.clear();
    NodeStates start;
    for (const size_t w : which) some.windows.push_back(data.windows[w]), start.push_back(states[w]);
    FitResult fit = Fit(some, model, options, &start);
    work += fit.work;
    for (size_t i = 0; fit.ok && i < which.size(); ++i) states[which[i]] = fit.states[i];
    return fit;
  }
};

// Calls fn(window, its first column there, piece) for every piece of the windows.
template <class Fn>
void ForEachPiece(const std::vector<NodeWindow>& windows, const std::vector<NodeWindow>& pieces,
                  const Fn& fn) {
  size_t p = 0;
  for (size_t w = 0; w < windows.size(); ++w) {
    const NodeWindow& window = windows[w];
    for (; p < pieces.size() && pieces[p].recording == window.recording &&
           pieces[p].t.front() >= window.t.front() && pieces[p].t.back() <= window.t.back();
         ++p) {
      const auto at = std::lower_bound(window.t.begin(), window.t.end(), pieces[p].t.front());
      fn(w, at - window.t.begin(), p);
    }
  }
}

// The model and the states of all windows as pieces of them tell it: over short ones a fit finds what swings
// from far off, and over whole windows no step leads there. Returns its cost.
double FindOverPieces(const FitData& data, double piece_s, const LiftedOptions& options, FitModel* model,
                      NodeStates* states) {
  FitData pieces = data;
  pieces.windows = InPieces(data.windows, piece_s, data.RowNoise());
  if (pieces.windows.empty()) return 0;
  Followed f{pieces, options, NodeStates(pieces.windows.size()), {}};
  ForEachPiece(data.windows, pieces.windows, [&](size_t w, Eigen::Index first, size_t p) {
    f.states[p] = (*states)[w].middleCols(first, static_cast<Eigen::Index>(pieces.windows[p].t.size()));
  });
  for (int round = 0; round < kRounds; ++round) {
    f.Follow(*model, false);
    const VectorXd before = model->values;
    const FitResult fit = f.FitTo(f.MetBest(kMostPieces), *model);
    if (!fit.ok) break;
    model->values = fit.values;
    bool moved = false;
    for (size_t i = 0; i < model->parameters.size(); ++i) {
      const int at = model->parameters[i].index;
      moved = moved || std::abs(fit.values[at] - before[at]) > fit.stddev[i];
    }
    if (!moved) break;
  }
  ForEachPiece(data.windows, pieces.windows, [&](size_t w, Eigen::Index first, size_t p) {
    (*states)[w].middleCols(first, f.states[p].cols()) = f.states[p];
  });
  return f.work;
}

}  // namespace

std::optional<VectorXd> SimulatedTo(double to, const FitData& data, sim::Simulator& simulator,
                                    const NodeWindow& window, const VectorXd& from) {
  const long n = data.n;
  const sim::State x{
      from.head(n), from.segment(n, n), from.tail(from.size() - 2 * n), window.t.front(), {}, {}};
  const sim::Trajectory out = simulator.Simulate(x, data.recordings[window.recording].command, {to});
  if (!out.outcome.ok() || !out.state.allFinite()) return std::nullopt;
  return out.state.col(0);
}

NodeStates FollowedStates(const FitData& data, const FitModel& given, const LiftedOptions& options,
                          NodeStates states, bool anew, double* work, std::vector<double>* chi2) {
  if (chi2 != nullptr) chi2->assign(data.windows.size(), std::numeric_limits<double>::infinity());
  const FitModel model{given.plant, given.values, {}};
  std::map<int, std::vector<size_t>> by_recording;  // windows in the order of time
  for (size_t w = 0; w < data.windows.size(); ++w) by_recording[data.windows[w].recording].push_back(w);
  std::vector<std::vector<size_t>> chains;
  for (auto& [recording, chain] : by_recording) {
    std::ranges::stable_sort(
        chain, [&](size_t a, size_t b) { return data.windows[a].t.front() < data.windows[b].t.front(); });
    chains.push_back(chain);
  }
  std::vector<double> spent(chains.size(), 0.0);
  LiftedOptions alone = options;
  alone.threads = 1;
  ParallelFor(options.threads, static_cast<int>(chains.size()), [&](int, int c) {
    FitData one = data;
    sim::Simulator simulator(model.plant, {.integrator = options.integrator, .step_s = options.step_s});
    simulator.SetParameters(model.values);
    Lineariser lineariser(data, model, false, alone);
    const std::vector<int> no_motor(static_cast<size_t>(data.n), -1);
    const NodeWindow* before = nullptr;
    VectorXd from;
    for (const size_t w : chains[c]) {
      const NodeWindow& window = data.windows[w];
      FitResult best;
      // Whether none is needed any more.
      const auto met = [&] { return best.ok && best.chi2 < kFitted * best.rows * options.noise_scale; };
      const auto attempt = [&](const MatrixXd& start) {
        const FitResult fit = Alone(&one, window, model, alone, start, kOneWindow);
        spent[c] += fit.work;
        if (fit.ok && (!best.ok || fit.chi2 < best.chi2)) best = fit;
      };
      const auto carried = [&](const VectorXd& start) {
        MatrixXd out = states[w];
        out.col(0) = start;
        lineariser.CarryHidden(0, window, no_motor, &out);
        return out;
      };
      if (before != nullptr && FollowsOn(*before, window)) {
        // Where what is hidden goes on from there.
        if (const auto end = SimulatedTo(window.t.front(), data, simulator, *before, from)) {
          VectorXd on = states[w].col(0);
          on.tail(on.size() - 2 * data.n) = end->tail(on.size() - 2 * data.n);
          attempt(carried(on));
        }
      }
      if (!met()) attempt(states[w]);
      if (anew && !met()) {
        std::vector<FitResult> looks;
        std::vector<VectorXd> starts = SwingsFrom(simulator, states[w].col(0));
        if (before == nullptr) {
          for (VectorXd& start : LetGo(data, simulator, window, states[w].col(0)))
            starts.push_back(std::move(start));
        }
        for (const VectorXd& start : starts) {
          looks.push_back(Alone(&one, window, model, alone, carried(start), kLook));
          spent[c] += looks.back().work;
        }
        std::erase_if(looks, [](const FitResult& look) { return !look.ok; });
        std::ranges::stable_sort(looks,
                                 [](const FitResult& a, const FitResult& b) { return a.chi2 < b.chi2; });
        for (size_t i = 0; i < std::min(kNearestSwings, looks.size()) && !met(); ++i)
          attempt(looks[i].states[0]);
      }
      if (best.ok) states[w] = best.states[0];
      if (best.ok && chi2 != nullptr) (*chi2)[w] = best.chi2;
      before = &window, from = states[w].col(0);
    }
  });
  for (const double cost : spent) *work += kAlone * cost;
  return states;
}

FitResult FitFollowed(const FitData& data, FitModel model, const LiftedOptions& options, int rounds) {
  FitResult best;
  const LiftedOptions on_the_way = KeepingStep(options);
  Followed f{data, on_the_way, InitialStates(data, model, options), {}};
  size_t met = data.windows.size();
  for (int round = 0; round < rounds; ++round) {
    // Anew where only a few windows were lost on the way.
    if (round == 0 || met > kMostMet * static_cast<double>(data.windows.size())) {
      for (const double part : kPieces)
        f.work += FindOverPieces(data, part * data.nodes.window_s, on_the_way, &model, &f.states);
    }
    f.Follow(model, true);
    // What is met tells the model, and the model where more windows start.
    met = 0;
    for (int more = 0; more < kGrowths; ++more) {
      const std::vector<size_t> first = f.MetBest(kMostWindows);
      if (first.size() <= met) break;
      met = first.size();
      if (met == data.windows.size()) break;
      const FitResult part = f.FitTo(first, model);
      if (!part.ok) break;
      model.values = part.values, f.Follow(model, true);
    }
    FitResult fit = Fit(data, model, options, &f.states);
    f.work += fit.work;
    if (!fit.ok) break;
    const bool better = !best.ok || fit.chi2 < kFollowOn * best.chi2;
    if (!best.ok || fit.evidence > best.evidence) best = fit;
    if (!better || fit.chi2 < kExplained * fit.rows * options.noise_scale) break;
    if (static_cast<double>(f.Met(fit.window_chi2)) < kFewMet * static_cast<double>(data.windows.size()))
      break;
    model.values = fit.values, f.states = std::move(fit.states);
  }
  best.work = f.work;
  return best;
}

}  // namespace rg::diagnosis
