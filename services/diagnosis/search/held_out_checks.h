// What a search asks recordings that are kept aside, and what it does where a model does not predict them.
// Without such recordings nothing.
#pragma once

#include <optional>

#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/further_steps.h"
#include "services/diagnosis/search/held_out_judge.h"
#include "services/diagnosis/search/refinement.h"
#include "services/diagnosis/search/search_state.h"
#include "services/diagnosis/search/simplifier.h"
#include "services/diagnosis/search/unnamed_forces.h"

namespace rg::diagnosis {

class HeldOutChecks {
 public:
  HeldOutChecks(SearchState& state, ForwardStep& step, FurtherSteps& further, Refinement& refinement,
                Simplifier& simplifier, UnnamedForces& unnamed);

  // Whether few effects with fixed inertials explain the recordings and the held-out ones to within their
  // noise: then free inertials are no rival.
  bool ExplainedWithFixedInertials(const Candidate& before, const Candidate& named);
  // The same of one unnamed force that scores better than what has names, into `out`: then nothing is looked
  // for with free inertials.
  bool ExplainedByOneForce(const Candidate& before, const Candidate& named, Candidate* out);

  // A model must predict held-out recordings to within their noise. Where it does not, whatever was fitted,
  // or a forward step finds beside it, that predicts them better takes its place; a model that explains less
  // than half of what is missing there, which `without` leaves, is dropped. excited_by: as in SearchResult.
  void Run(const Candidate& without, Candidate* best, int* excited_by);
  // The densities of the best model and of its rivals, the likeliest of which takes its place.
  void CompareRivals(SearchResult* out);

 private:
  bool JudgesFewNames() const;
  bool Predicts(const Candidate& account, double needed);
  bool SwingsOn(const Candidate& best, const Candidate& without);
  bool ReplaceRefused(const Candidate& without, bool first, Candidate* best);
  void TryUnnamed(bool base, bool with_names);
  void AddToRefused(const Candidate refused, Candidate* with);

  SearchState& state_;
  FitLedger& fits_;
  ForwardStep& step_;
  FurtherSteps& further_;
  Refinement& refinement_;
  Simplifier& simplifier_;
  UnnamedForces& unnamed_;
  std::optional<HeldOutJudge> judge_;  // where recordings are kept aside
};

}  // namespace rg::diagnosis
