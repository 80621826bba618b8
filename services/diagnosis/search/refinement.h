// What is done with a model that a forward step found before it is accepted: exchanges of effects that are
// easily taken for each other, free inertials or fixed ones, longer fits, and whether each new effect is
// needed.
#pragma once

#include <string>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

class Refinement {
 public:
  explicit Refinement(SearchState& state) : state_(state), setting_(state.setting), fits_(state.fits) {}

  // Exchanges each kind that `model` adds to `before`, or its newest, until the score stays. Whether it rose.
  bool Exchange(const Candidate& before, Candidate* model);
  // Exchanges free and fixed base parameters if that halves the misfit of `model`, then exchanges effects:
  // base parameters change which effects can be distinguished.
  // If the result is not consistent, nothing changes and its fits are forgotten, since other moves are
  // still to come.
  void ExchangeMasses(const Candidate& before, Candidate* model);
  // Whether the score stayed when all kinds of this model were exchanged.
  bool IsSettled(const Candidate& model) const { return KeyOf(model.specs, model.base) == settled_; }
  // With inertials free or as given, whichever has more log evidence; free ones must bring `least` more.
  Candidate WithInertialsFreeOrFixed(const Candidate& c, double least);
  // Fitted on from the states of `from` and the values of `rival`; with hidden states also with fixed
  // inertials.
  Candidate Refitted(const Candidate& c, const Candidate& from, const Candidate& rival);
  // Of several effects added at once each must be worth its name, against the models without it and, where
  // inertials were fixed, against those with free ones.
  Candidate Justified(const Candidate& before, Candidate winner);

 private:
  bool Siblings(const Candidate& before, Candidate* winner);

  SearchState& state_;
  const FitSetting& setting_;
  FitLedger& fits_;
  std::string settled_;  // the last model of which all kinds were exchanged in vain
};

}  // namespace rg::diagnosis
