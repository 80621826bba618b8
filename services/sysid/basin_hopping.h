// Basin hopping (Wales & Doye 1997) as independent pieces.
//
// A chain is a HopState: all there is to know to go on, small enough to travel as a task's checkpoint.
// RunHops advances it by a number of hops or for a time; what it draws in hop k depends on (seed, chain,
// k) only, so a chain that was cut and resumed is the chain that was not. Chains run anywhere; Exchange
// gives one the best of the others between pieces.
//
// One hop: perturb the current point uniformly by ± step_size of the search range (clipped to it), solve
// locally, accept by Metropolis on the relative change of cost; the step size is adapted so that about
// half of the hops are accepted. Hop 0 of chain 0 solves from p_init; hop 0 of the others starts
// uniformly within the search range (Collins et al.).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "common/base/status.h"
#include "services/sysid/least_squares.h"

namespace rg::sysid {

struct HopRecord {
  int hop = 0;
  double cost = 0.0;  // the hop's local minimum
  double best = 0.0;  // of the chain, after the hop
  double step_size = 0.0;
  bool accepted = false;
  // Where it began, if at a point of the chain itself (its first, or its best on a cost function that is
  // new); infinite: a start that was drawn.
  double start = std::numeric_limits<double>::infinity();
};

struct HopState {
  uint64_t seed = 0;
  int chain = 0;
  int hops = 0;  // completed; also the counter of the random numbers
  double step_size = 0.2;
  int accepted = 0;  // since the step size was last adapted
  int since_adapted = 0;
  Eigen::VectorXd current, best;  // empty before the first hop ended
  double current_cost = 0.0, best_cost = 0.0;
  bool from_current = false;  // the next hop solves from `current` itself, unperturbed
  int first_hop = 0;          // on the present cost function (see ChangeCost)
  bool agreed = false;        // on the cost function before
  bool taken = false;         // `best` is another chain's
  std::vector<double>
      others;  // costs of the other chains' hops, as far as known, on the present cost function
  std::vector<HopRecord> history;

  bool started() const { return best.size() > 0; }
};

struct HopOptions {
  SolveOptions solve;
  double temperature = 0.05;  // a hop that raises the cost by this share is accepted with 1/e
  double target_acceptance = 0.5;
  int adapt_interval = 8;                            // hops between adaptations
  double adapt_factor = 0.8;                         // step_size *= or /= this
  double min_step_size = 0.01, max_step_size = 1.0;  // share of the search range
};

// Both limits hold; a hop cut by the clock or a cancel keeps its best point but is not counted as done.
struct HopBudget {
  int hops = 1 << 30;
  double seconds = 1e30;
};

HopState StartChain(uint64_t seed, int chain);
// Later iterations of the loop: hop 0 starts at `p` (the last optimum) whatever the chain's number.
HopState StartChainAt(uint64_t seed, int chain, const Eigen::VectorXd& p, double cost);

// `progress` gets stage "hops", done = hops of this call. Ends at the budget, late by at most one
// evaluation, or when `cancel` (may be null) is set.
HopState RunHops(const LeastSquaresProblem& problem, const HopOptions& options, HopState state,
                 const HopBudget& budget, const Clock& clock, const ProgressFn& progress = {},
                 const CancelToken* cancel = nullptr);

// The chain goes on from `best` if that is lower than its own best. True if it took it.
bool Exchange(const Eigen::VectorXd& best, double best_cost, HopState* state);
// The same with all that other chains found so far on the same cost function, but a best that is within 1 %
// of theirs stays: another start is worth more than the rest. States of this chain among them and those that
// have not begun do not count. The number of the chain whose best it took, or −1.
int ExchangeAll(const std::vector<HopState>& others, HopState* state);

// The cost function is another from here on, and `cost` that of the best point, from which the next hop
// solves.
void ChangeCost(double cost, HopState* state);

// Whether the search has converged: three hops from different points, of this chain or known of others, ended
// within 1 % of the best cost. They came to one minimum, or to several that fit equally well. Once hops
// agreed on one cost function, one hop from there is enough on the
// next, by the chain that found that point.
bool Agrees(const HopState& state);

// JSON, doubles exact. Parse refuses what it does not understand.
std::string SerializeHopState(const HopState& state);
Result<HopState> ParseHopState(const std::string& text);

}  // namespace rg::sysid
