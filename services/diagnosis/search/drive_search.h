// The first step of a search if neither the given model nor free base parameters are consistent: effects of
// all drives as one group. These are viscous and dry friction and a rotor on every joint, lag or delay. Then
// another law of dry friction, a further law on all joints, free base parameters.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

class DriveSearch {
 public:
  DriveSearch(SearchState& state, ForwardStep& step)
      : state_(state), setting_(state.setting), fits_(state.fits), step_(step) {}

  // The best group if less than a fifth of the excess χ² remains and it is of all drives. Else
  // none, and its fits are forgotten, so that they do not compete with effects found one by one. `plain`,
  // `freed`: the given effects alone, with fixed and with free base parameters.
  std::optional<Candidate> Run(const Candidate& plain, const Candidate& freed);

  // Lag or delay of all drives, in the place of other timing effects, where that leaves half of the excess at
  // most; both where more is left and the acceptance rule allows both.
  void Late(Candidate* best);
  // Chooses law of dry friction, delay and lag again: in `before` they were chosen while other effects of
  // `best` were missing.
  void Reconsider(const Candidate& before, Candidate* best);

 private:
  bool LossesShow() const;
  Candidate Losses();
  Candidate Seen(const Candidate& c, bool base);
  void Couple(Candidate* best);
  void OtherDryLaw(Candidate* best);
  Candidate InPlace(const std::vector<TrialSpecs>& others, const Candidate& c);
  bool TakeOneLaw(const Candidate& directed, Candidate* best);
  void LawOnEachJoint(Candidate* best);
  bool TakeNearest(const std::map<std::string, Candidate>& before, Candidate* best) const;
  void Freed(Candidate* best);
  Candidate WithFreeBase(const Candidate& c);
  Candidate WithZeros(const Candidate& c, const Candidate& either_way);
  std::vector<effects::EffectSpec> OnAll(const std::string& id, double late) const;
  bool OfAllDrives(const Candidate& c) const;
  // Excess χ² over the sensors' own noise (the search's noise scale may contain what is missing); infinite of
  // a failed fit.
  static double Left(const Candidate& c);
  static bool LeavesSomething(const Candidate& c);
  // Share of the excess that a trial fit leaves at most, for a fit on all windows.
  static constexpr double kMayBeUseful = 0.8;

  SearchState& state_;
  const FitSetting& setting_;
  FitLedger& fits_;
  ForwardStep& step_;
};

}  // namespace rg::diagnosis
