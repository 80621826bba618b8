// What an accepted account does not need: effects that are about nothing or not worth their names, and richer
// forms than the data have.
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
  // explained(c): what the effects of c bring.
  Simplifier(const FitSetting& setting, FitLedger& fits,
             std::function<double(const Candidate&, const Candidate&)> needed,
             std::function<double(const Candidate&)> beside,
             std::function<double(const Candidate&)> explained)
      : setting_(setting),
        fits_(fits),
        needed_(std::move(needed)),
        beside_(std::move(beside)),
        explained_(std::move(explained)) {}

  // All of it: Prune, then plainer laws in the place of richer ones.
  void Run(Candidate* best);
  // Takes out what is about nothing, and one by one what the data do not pay for.
  void Prune(Candidate* best);
  // Takes out all at once what is about nothing.
  void DropNothing(Candidate* best);

 private:
  bool GivesWayToBodies(const std::vector<effects::EffectSpec>& without, size_t i, Candidate* best);
  void GainsGiveWay(Candidate* best);
  void Replace(const Candidate& by, Candidate* best);
  TrialSpecs PlainForm(const Candidate& c, const std::string& id) const;
  void Plainer(Candidate* best);
  void FirstRotor(Candidate* best);
  void ByDirection(Candidate* best);
  void OffsetsOfSome(Candidate* best);
  void OwnLaws(Candidate* best);

  const FitSetting& setting_;
  FitLedger& fits_;
  std::function<double(const Candidate&, const Candidate&)> needed_;
  std::function<double(const Candidate&)> beside_, explained_;
};

}  // namespace rg::diagnosis
