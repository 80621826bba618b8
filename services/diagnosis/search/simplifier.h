// Backward steps: removes effects that an accepted model does not need, and replaces richer laws by plain
// ones.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

class Simplifier {
 public:
  explicit Simplifier(SearchState& state) : state_(state), setting_(state.setting), fits_(state.fits) {}

  // Prune, then plain laws in the place of richer ones.
  void Run(Candidate* best);
  // Removes effects that are not significantly different from absence, then one by one those whose removal a
  // refit does not reject.
  void Prune(Candidate* best);
  // The former alone, all at once.
  void DropAbsent(Candidate* best);

 private:
  bool YieldsToInertials(const std::vector<effects::EffectSpec>& without, size_t i, Candidate* best);
  void GainsYieldToInertials(Candidate* best);
  void Replace(const Candidate& by, Candidate* best);
  TrialSpecs PlainForm(const Candidate& c, const std::string& id) const;
  void UsePlainLaws(Candidate* best);
  void UsePlainLaw(const std::string& richer, const TrialSpecs& specs, Candidate* best);
  void FirstRotorAsInertia(Candidate* best);

  SearchState& state_;
  const FitSetting& setting_;
  FitLedger& fits_;
};

}  // namespace rg::diagnosis
