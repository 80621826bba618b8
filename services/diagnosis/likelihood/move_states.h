// How the states of windows move in a fit: with a step of the parameters, and where no gradient leads.
#pragma once

#include <vector>

#include "services/diagnosis/likelihood/lineariser.h"

namespace rg::diagnosis {

inline constexpr int kFaces = 20;  // what ChooseFaces costs, in simulations of all windows

// Moves the states of windows [first, last) with a step of the parameters, their starts to what then fits
// best; writes χ² of the windows simulated from there. `adopted`: χ² so far, where known. Returns how many
// windows were simulated.
size_t MoveStates(Lineariser& lin, int worker, int first, int last, const std::vector<Linear>& linear,
                  const std::vector<BestStart>& best, const VectorXd& step,
                  const std::vector<double>& adopted, NodeStates* states, std::vector<double>* chi2);

// Noise throws a joint off that rests at a window's start. Windows that stand out, counted, are tried anew.
size_t TryRecordedStarts(Lineariser& lin, const FitData& data, int threads, NodeStates* states,
                         std::vector<double>* chi2);

// The windows that are met worst start anew where that is nearer to the record: a motor that lies on the
// wrong face at first stays there, whatever the parameters become.
void ChooseFaces(const FitData& data, Lineariser& lin, int threads, double noise_scale,
                 std::vector<double>* chi2, NodeStates* states);

// Puts the nodes of every window on its simulation: faces that meet and part bend a motion more than a line
// from node to node could say, and off the simulation fits stay where they start.
void FollowSimulations(const FitData& data, Lineariser& lin, int threads, NodeStates* states);

// Far from the data only where the model holds it: a node that strays goes back to the record. `before`: what
// hidden states of no value go back to.
void ReturnStrayed(const Lineariser& lin, const FitData& data, const NodeStates& before, NodeStates* states);

}  // namespace rg::diagnosis
