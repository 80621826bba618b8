// What a search asks recordings that are kept aside, and what it does where a model does not predict them.
// Without such recordings nothing.
#pragma once

#include <optional>

#include "services/diagnosis/search/held_out_judge.h"
#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

class HeldOutChecks {
 public:
  explicit HeldOutChecks(SearchState& state);

  // Whether few effects with fixed inertials explain the recordings and the held-out ones to within their
  // noise: then free inertials are no rival.
  bool ExplainedWithFixedInertials(const Candidate& before, const Candidate& named);
  // Whether a model predicts held-out recordings worse than to within their noise.
  bool Refuses(const Candidate& model);
  // A model must predict held-out recordings to within their noise, or explain half of what is missing
  // there, which `without` leaves: else it is dropped. excited_by: as in SearchResult.
  void Run(const Candidate& without, Candidate* best, int* excited_by);
  // The densities of the best model and of its rivals, the likeliest of which takes its place.
  void CompareRivals(SearchResult* out);

 private:
  bool Holds(const Candidate& model, double needed);
  bool SwingsOn(const Candidate& best, const Candidate& without);

  SearchState& state_;
  FitLedger& fits_;
  std::optional<HeldOutJudge> judge_;  // where recordings are kept aside
};

}  // namespace rg::diagnosis
