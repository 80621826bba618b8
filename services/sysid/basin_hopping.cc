#include "services/sysid/basin_hopping.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "common/base/rng.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;
using nlohmann::json;
constexpr char kFormat[] = "realitygrad.hop_state/1";

// Whether the next hop begins at a point of the chain itself.
bool BeginsAtOwnPoint(const HopState& state) {
  return state.from_current || (state.hops == 0 && state.chain == 0);
}

VectorXd DrawStart(const LeastSquaresProblem& problem, const HopState& state, Rng* rng) {
  if (BeginsAtOwnPoint(state)) return state.from_current ? state.current : problem.initial;
  const VectorXd range = problem.search_upper - problem.search_lower;
  VectorXd p(range.size());
  for (int i = 0; i < p.size(); ++i) {
    if (state.hops == 0) {
      p[i] = rng->Uniform(problem.search_lower[i], problem.search_upper[i]);
    } else {
      // The current point may lie outside the search range (unbounded solver): only the step is clipped.
      const double low = std::min(problem.search_lower[i], state.current[i]);
      const double high = std::max(problem.search_upper[i], state.current[i]);
      p[i] = std::clamp(state.current[i] + rng->Uniform(-1.0, 1.0) * state.step_size * range[i], low, high);
    }
  }
  return p;
}

bool Accept(const HopState& state, double cost, double temperature, Rng* rng) {
  const double draw = rng->Uniform();  // drawn always: the sequence does not depend on the outcome
  if (state.hops == 0 || cost <= state.current_cost) return true;
  const double scale = temperature * std::max(state.current_cost, std::numeric_limits<double>::min());
  return draw < std::exp(-(cost - state.current_cost) / scale);
}

void KeepBest(const SolveSummary& solved, HopState* state) {
  if (!std::isfinite(solved.cost)) return;
  if (state->started() && solved.cost >= state->best_cost) return;
  state->best = solved.p;
  state->best_cost = solved.cost;
  state->taken = false;
}

void AdaptStep(const HopOptions& options, bool accepted, HopState* state) {
  state->accepted += accepted ? 1 : 0;
  if (++state->since_adapted < options.adapt_interval) return;
  const double rate = static_cast<double>(state->accepted) / state->since_adapted;
  state->step_size *= rate > options.target_acceptance ? 1.0 / options.adapt_factor : options.adapt_factor;
  state->step_size = std::clamp(state->step_size, options.min_step_size, options.max_step_size);
  state->accepted = state->since_adapted = 0;
}

// True when the hop was finished, not cut.
bool RunOneHop(const LeastSquaresProblem& problem, const HopOptions& options, const StopCondition& stop,
               HopState* state) {
  Rng rng =
      Rng(state->seed).Split(static_cast<uint64_t>(state->chain)).Split(static_cast<uint64_t>(state->hops));
  const VectorXd start = DrawStart(problem, *state, &rng);
  const SolveSummary solved = Solve(problem, start, options.solve, stop);
  KeepBest(solved, state);
  if (solved.termination == Termination::kStopped) return false;

  const bool finite = std::isfinite(solved.cost);
  const bool accepted = finite && Accept(*state, solved.cost, options.temperature, &rng);
  if (accepted || state->hops == 0) {
    state->current = finite ? solved.p : problem.initial;
    state->current_cost = finite ? solved.cost : std::numeric_limits<double>::max();
  }
  if (!state->started()) {  // not even the first start was finite: fall back on p_init, and say so by cost
    state->best = problem.initial;
    state->best_cost = std::numeric_limits<double>::max();
  }
  HopRecord record{state->hops, solved.cost, state->best_cost, state->step_size, accepted};
  if (BeginsAtOwnPoint(*state)) record.start = solved.start_cost;
  state->history.push_back(record);
  state->from_current = false;
  ++state->hops;
  AdaptStep(options, accepted, state);
  return true;
}

// Whether a cost is as good as the best: half a percent of the residuals' RMS.
bool Near(double cost, double best) { return cost <= 1.01 * best; }

json VectorToJson(const VectorXd& v) { return json(std::vector<double>(v.data(), v.data() + v.size())); }

VectorXd VectorFromJson(const json& j) {
  const auto values = j.get<std::vector<double>>();
  return Eigen::Map<const VectorXd>(values.data(), static_cast<int>(values.size()));
}

// JSON has no infinity: a failed hop's cost travels as null.
json NumberToJson(double x) { return std::isfinite(x) ? json(x) : json(); }
double NumberFromJson(const json& j) {
  return j.is_null() ? std::numeric_limits<double>::infinity() : j.get<double>();
}

}  // namespace

HopState StartChain(uint64_t seed, int chain) {
  HopState state;
  state.seed = seed;
  state.chain = chain;
  return state;
}

HopState StartChainAt(uint64_t seed, int chain, const VectorXd& p, double cost) {
  HopState state = StartChain(seed, chain);
  state.current = p;
  state.current_cost = cost;
  state.from_current = true;
  return state;
}

HopState RunHops(const LeastSquaresProblem& problem, const HopOptions& options, HopState state,
                 const HopBudget& budget, const Clock& clock, const ProgressFn& progress,
                 const CancelToken* cancel) {
  CheckProblem(problem);
  const StopCondition stop(clock, budget.seconds, cancel);
  for (int done = 0; done < budget.hops && !stop.ShouldStop(); ++done) {
    if (!RunOneHop(problem, options, stop, &state)) break;
    if (progress) {
      progress({"hops", static_cast<double>(done + 1), static_cast<double>(budget.hops),
                "best residual " + std::to_string(state.best_cost)});
    }
  }
  return state;
}

bool Exchange(const VectorXd& best, double best_cost, HopState* state) {
  if (state->started() && best_cost >= state->best_cost) return false;
  state->best = state->current = best;
  state->best_cost = state->current_cost = best_cost;
  state->taken = true;
  return true;
}

int ExchangeAll(const std::vector<HopState>& others, HopState* state) {
  int from = -1;
  state->others.clear();
  for (const HopState& theirs : others) {
    if (theirs.chain == state->chain || !theirs.started()) continue;
    const bool better = !state->started() || !Near(state->best_cost, theirs.best_cost);
    if (better && Exchange(theirs.best, theirs.best_cost, state)) from = theirs.chain;
    for (const HopRecord& h : theirs.history)
      if (h.hop >= theirs.first_hop) state->others.push_back(h.cost);
  }
  return from;
}

void ChangeCost(double cost, HopState* state) {
  state->agreed = Agrees(*state);
  state->current = state->best;
  state->current_cost = state->best_cost = cost;
  state->from_current = true;
  state->first_hop = state->hops;
  state->others.clear();
}

bool Agrees(const HopState& state) {
  const int hops = !state.agreed ? 3 : state.taken ? 0 : 1;
  const auto near = [&](double cost) { return Near(cost, state.best_cost); };
  return std::ranges::count_if(state.history,
                               [&](const HopRecord& h) { return h.hop >= state.first_hop && near(h.cost); }) +
             std::ranges::count_if(state.others, near) >=
         hops;
}

std::string SerializeHopState(const HopState& state) {
  json history = json::array();
  for (const HopRecord& h : state.history) {
    history.push_back(
        {h.hop, NumberToJson(h.cost), NumberToJson(h.best), h.step_size, h.accepted, NumberToJson(h.start)});
  }
  json others = json::array();
  for (const double cost : state.others) others.push_back(NumberToJson(cost));
  return json{{"format", kFormat},
              {"seed", state.seed},
              {"chain", state.chain},
              {"hops", state.hops},
              {"step_size", state.step_size},
              {"accepted", state.accepted},
              {"since_adapted", state.since_adapted},
              {"current", VectorToJson(state.current)},
              {"best", VectorToJson(state.best)},
              {"current_cost", NumberToJson(state.current_cost)},
              {"best_cost", NumberToJson(state.best_cost)},
              {"from_current", state.from_current},
              {"first_hop", state.first_hop},
              {"agreed", state.agreed},
              {"taken", state.taken},
              {"others", others},
              {"history", history}}
      .dump();
}

Result<HopState> ParseHopState(const std::string& text) {
  try {
    const json j = json::parse(text);
    if (j.at("format") != kFormat) return InvalidError("hop state: format is not " + std::string(kFormat));
    HopState state;
    state.seed = j.at("seed").get<uint64_t>();
    state.chain = j.at("chain").get<int>();
    state.hops = j.at("hops").get<int>();
    state.step_size = j.at("step_size").get<double>();
    state.accepted = j.at("accepted").get<int>();
    state.since_adapted = j.at("since_adapted").get<int>();
    state.current = VectorFromJson(j.at("current"));
    state.best = VectorFromJson(j.at("best"));
    state.current_cost = NumberFromJson(j.at("current_cost"));
    state.best_cost = NumberFromJson(j.at("best_cost"));
    // Absent in states that earlier versions wrote.
    state.from_current = j.value("from_current", state.hops == 0 && state.current.size() > 0);
    state.first_hop = j.value("first_hop", 0);
    state.agreed = j.value("agreed", false);
    state.taken = j.value("taken", false);
    for (const json& cost : j.value("others", json::array())) state.others.push_back(NumberFromJson(cost));
    for (const json& h : j.at("history")) {
      HopRecord record{h.at(0).get<int>(), NumberFromJson(h.at(1)), NumberFromJson(h.at(2)),
                       h.at(3).get<double>(), h.at(4).get<bool>()};
      if (h.size() > 5) record.start = NumberFromJson(h.at(5));
      state.history.push_back(record);
    }
    return state;
  } catch (const json::exception& e) {
    return InvalidError(std::string("hop state: ") + e.what());
  }
}

}  // namespace rg::sysid
