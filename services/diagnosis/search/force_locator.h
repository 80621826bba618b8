// On which joint a force is missing, and which other effects are significant whatever that force is.
//
// A missing force biases every law that is fitted without it. But a force of any course in time on one joint
// can be integrated out (free_force.h). If the recordings are then explained, the missing force acts on that
// joint, and the remaining scores of other joints and of the robot do not depend on its form.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

class ForceLocator {
 public:
  ForceLocator(SearchState& state, ForwardStep& step)
      : state_(state), setting_(state.setting), fits_(state.fits), step_(step) {}

  // For a model with an unnamed force, or without effects and inconsistent with the noise. Replaces it by an
  // unnamed force on one joint and effects on others, if these with any force there are consistent with the
  // noise and have the most log evidence, such a force alone included. Whether it did.
  bool NameBeside(Candidate* best);
  // The joints on each of which any force beside `around`, alone or with effects on others, leaves hardly
  // more than noise. None where a force on any joint would do.
  std::set<int> Where(const Candidate& around);
  // `winner` becomes what acts on such a joint, with what is named on others; an unnamed force there
  // (SearchState::place) where no effect is consistent with the noise. False where no joint suffices, or
  // nothing found replaces `around`.
  bool Explain(const Candidate& around, Candidate* winner);
  // Before free base parameters are tried. Asks the joint on which any force leaves less than half of the
  // misfit that a force on any other joint leaves. If an effect on that joint leaves a hundredth or
  // nothing, `winner` becomes it.
  bool ExplainByName(const Candidate& around, Candidate* winner);

 private:
  struct Explanation {
    int joint = 0;
    Candidate without;                 // the model without the force and the effects
    TrialSpecs names;                  // that model's effects and what is named
    std::vector<Scored> beside;        // what is named; empty: the force is all
    double evidence = 0;               // per row, of names and any force together, structure prior included
    double left = 0;                   // χ² over what noise alone leaves
    double elsewhere = effects::kInf;  // the least that a force on another joint leaves
  };
  // The model, with base parameters as given and free where it has nothing yet. Null: nothing.
  std::vector<Candidate> ModelsWithout(const Candidate* around) const;
  bool StandsOut(const Explanation& e) const;
  // Beside each of them, the best first.
  std::vector<Explanation> Explanations(const std::vector<Candidate>& models);
  // Any force on a joint, alone and with the best names beside it, if any.
  void AddOn(int joint, const Candidate& without, const ScreenResult& screened, size_t windows,
             std::vector<Explanation>* out);
  bool MayBe(const Scored& h, int joint, const TrialSpecs& without) const;
  // Whether it leaves so little that a law's idealisation or the linearisation may be all that it is.
  bool Suffices(const Explanation& e) const;
  Candidate OnThatJoint(const Explanation& e);
  bool Replaces(const Candidate& around, const Candidate& c) const;
  // The force as a grid of weights, a new one or what the model before has on that joint. Nothing where an
  // effect is inadmissible in the fit that leaves least, or absent by its strength.
  std::optional<Candidate> Fitted(const Explanation& e, const Candidate& before);

  SearchState& state_;
  const FitSetting& setting_;
  FitLedger& fits_;
  ForwardStep& step_;
  std::map<std::string, std::vector<ScreenResult>> screens_;  // a joint each; by model and noise scale
  std::string named_in_place_;  // the model with an unnamed force in its place, and effects beside it
};

}  // namespace rg::diagnosis
