// What can be named beside a force that is not in the catalogue.
//
// A force of unknown form bends every law that is fitted in its place or beside it, and a grid of weights
// follows it coarsely. But any force at all on one joint may be integrated out (free_force.h): what the
// recordings then still say of other joints and of the robot as a whole holds whatever its form.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

class NamesBesideForce {
 public:
  NamesBesideForce(SearchState& state, ForwardStep& step)
      : state_(state), setting_(state.setting), fits_(state.fits), step_(step) {}

  // A model with an unnamed force, or that lacks everything, becomes one with an unnamed force on some joint
  // and effects on others, where any force there and these effects together are consistent with the noise and
  // have most log evidence, that of such a force alone included. Whether it did.
  bool Run(Candidate* best);

 private:
  struct Explanation {
    int joint = 0;
    Candidate without;    // the model without the force and the effects
    TrialSpecs names;     // that model's effects and what is named; empty: the force is all
    double evidence = 0;  // per row, of names and any force together, structure prior included
    double left = 0;      // χ² per row
  };
  // The best first.
  std::vector<Explanation> Explanations();
  // Any force on a joint, alone and with the best names beside it, if any.
  void AddOn(int joint, const Candidate& without, const FitData& some, const std::vector<uint32_t>& places,
             std::vector<Explanation>* out);
  bool MayBe(const Scored& h, int joint) const;
  // The force as a grid of weights, a new one or what the model before has on that joint. Nothing where an
  // effect is inadmissible in the fit that leaves least, or absent by its strength.
  std::optional<Candidate> Fitted(const Explanation& e, const Candidate& before);

  SearchState& state_;
  const FitSetting& setting_;
  FitLedger& fits_;
  ForwardStep& step_;
};

}  // namespace rg::diagnosis
