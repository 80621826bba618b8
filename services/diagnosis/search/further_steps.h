// Forward steps one after another, beside what a first one found.
#pragma once

#include <functional>
#include <vector>

#include "services/diagnosis/search/drive_search.h"
#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

class FurtherSteps {
 public:
  FurtherSteps(SearchState& state, ForwardStep& step, DriveSearch& drives)
      : state_(state), fits_(state.fits), step_(step), drives_(drives) {}

  // Adds effects without hidden states, base parameters fixed or free. If nothing is then missing, effects
  // with hidden states are not tried, and `winner` becomes the result. `laws`: the best so far. On an
  // ordinary robot base parameters stay as DriveSearch chose them.
  bool ByLaws(const Candidate& before, bool base, Candidate* laws, Candidate* winner);

  // Forward steps with fixed inertials until nothing is missing, cheaper than freeing inertials, beside the
  // best model of this round and the best with hidden states; into `best` where that has more log evidence.
  void BesideBest(const Candidate& before, const Candidate& winner, Candidate* best);

 private:
  std::vector<Candidate> Starts(const Candidate& before, const Candidate& winner) const;
  Candidate FurtherLaws(const Candidate& account);
  Candidate Steps(Candidate account, const std::function<void(const Candidate&, Candidate*)>& step);

  SearchState& state_;
  FitLedger& fits_;
  ForwardStep& step_;
  DriveSearch& drives_;
};

}  // namespace rg::diagnosis
