// Forward steps one after another, beside what a first one found; and substitutes: a forward step without a
// kind of effect that the model has.
#pragma once

#include <functional>
#include <set>
#include <string>
#include <vector>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/search/drive_search.h"
#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/search_state.h"
#include "services/diagnosis/search/simplifier.h"

namespace rg::diagnosis {

inline constexpr size_t kFitsInPlace = 2;  // in the place of a kind, or beside what is refused

class FurtherSteps {
 public:
  FurtherSteps(SearchState& state, ForwardStep& step, DriveSearch& drives, Simplifier& simplifier)
      : state_(state), fits_(state.fits), step_(step), drives_(drives), simplifier_(simplifier) {}

  // The search made a forward step from this model.
  void NoteStepFrom(const Candidate& from, bool base) { stepped_from_.insert(KeyOf(from.specs, base)); }

  // Laws of what is recorded come first, with inertials as given or free: where they leave nothing, hidden
  // states are not looked for, and `winner` becomes what they explain. On an ordinary robot inertials stay as
  // the drives left them.
  bool ByLaws(const Candidate& before, Candidate* winner);

  // Forward steps with fixed inertials until nothing is missing: cheaper than freeing inertials.
  Candidate Beside(const Candidate& account);
  // The same beside the best model of this round and the best with hidden states, into `best` where that has
  // more log evidence.
  void BesideBest(const Candidate& before, const Candidate& winner, Candidate* best);

  // A law bends towards what another, missing one leaves, and hides it: each kind of effect in turn is
  // removed and a forward step made without it, until none is better.
  void SubstituteAll(Candidate* best);
  // A forward step from the model without one kind of effect, once for each such model.
  void AddWithoutKind(const Candidate& account, const std::string& kind, Candidate* winner);

 private:
  std::vector<Candidate> Starts(const Candidate& before, const Candidate& winner) const;
  Candidate FurtherLaws(const Candidate& account);
  Candidate Steps(Candidate account, const std::function<void(const Candidate&, Candidate*)>& step);
  bool Substitute(Candidate* best);

  SearchState& state_;
  FitLedger& fits_;
  ForwardStep& step_;
  DriveSearch& drives_;
  Simplifier& simplifier_;
  std::set<std::string> stepped_from_;  // models, by key, that a forward step was made from
};

}  // namespace rg::diagnosis
