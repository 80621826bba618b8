// Backward steps: removes effects that an accepted model does not need, and replaces richer laws by plain
// ones.
#pragma once

#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "services/diagnosis/search/fit_ledger.h"

namespace rg::diagnosis {

class Simplifier {
 public:
  // needed(a, b): log evidence that b must bring in the place of a. beside(c): that any addition to c must.
  // explained(c): log evidence that the effects of c bring.
  Simplifier(const FitSetting& setting, FitLedger& fits,
             std::function<double(const Candidate&, const Candidate&)> needed,
             std::function<double(const Candidate&)> beside,
             std::function<double(const Candidate&)> explained)
      : setting_(setting),
        fits_(fits),
        needed_(std::move(needed)),
        beside_(std::move(beside)),
        explained_(std::move(explained)) {}

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

  const FitSetting& setting_;
  FitLedger& fits_;
  std::function<double(const Candidate&, const Candidate&)> needed_;
  std::function<double(const Candidate&)> beside_, explained_;
};

}  // namespace rg::diagnosis
