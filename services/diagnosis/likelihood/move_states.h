// How the states of windows move in a fit: with a step of the parameters, and where no gradient leads.
#pragma once

#include <vector>

#include "services/diagnosis/likelihood/lineariser.h"

namespace rg::diagnosis {

inline constexpr int kFaces = 20;  // what ChooseFaces costs, in simulations of all windows

// Moves the states of windows [first, last) with a step of the parameters, and their starts to the best fit
// there; writes χ² of the windows simulated from these. `adopted`: χ² so far, where known. Returns how many
// windows were simulated.
size_t MoveStates(Lineariser& lin, int worker, int first, int last, const std::vector<Linear>& linear,
                  const std::vector<BestStart>& best, const VectorXd& step,
                  const std::vector<double>& adopted, NodeStates* states, std::vector<double>* chi2);

// Noise in the start of a resting joint can throw a window off. Retries outliers; returns their number.
size_t TryRecordedStarts(Lineariser& lin, const FitData& data, int threads, NodeStates* states,
                         std::vector<double>* chi2);

// Restarts the windows that fit worst at another face of a gear with play, where that lowers χ²: no gradient
// leads from one face to the other.
void ChooseFaces(const FitData& data, Lineariser& lin, int threads, double noise_scale,
                 std::vector<double>* chi2, NodeStates* states);

// Puts the nodes of every window on its simulation: faces that meet and part bend a motion more than a line
// from node to node could say, and off the simulation fits stay where they start.
void FollowSimulations(const FitData& data, Lineariser& lin, int threads, NodeStates* states);

// Nodes that are not finite, or too far from the recorded motion, return to it. `before`: replaces hidden
// states that are not finite.
void ReturnStrayed(const Lineariser& lin, const FitData& data, const NodeStates& before, NodeStates* states);

}  // namespace rg::diagnosis
