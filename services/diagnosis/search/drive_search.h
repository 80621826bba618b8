// The first step of a search on a robot that neither world comes near to: what all of its drives lack, at
// once. Viscous and dry friction and a rotor on every joint, drives that are late by a lag or a delay or not
// at all, another law of dry friction on all of them, and free base parameters where these do not come near.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "services/diagnosis/search/fit_ledger.h"

namespace rg::diagnosis {

class DriveSearch {
 public:
  // given: effects that the model has from its user. needed(a, b): log evidence that b must bring in the
  // place of a. beside(c, best): takes what a screen around c promises beside it where that is better than
  // `best`. transmission: the same of a spring or play.
  DriveSearch(const FitSetting& setting, FitLedger& fits, const std::vector<effects::EffectSpec>& given,
              std::function<double(const Candidate&, const Candidate&)> needed,
              std::function<void(const Candidate&, Candidate*)> beside,
              std::function<void(const Candidate&, Candidate*)> transmission)
      : setting_(setting),
        fits_(fits),
        given_(given),
        needed_(std::move(needed)),
        beside_(std::move(beside)),
        transmission_(std::move(transmission)) {}

  // The best of them, where it brings the model within reach of the recordings, or most of the way, and is of
  // all drives; else none, and no fit of it is kept, for no such model is a rival of what is found one by
  // one. plain, freed: the given effects alone, on the parameters as given and on free ones.
  std::optional<Candidate> Run(const Candidate& plain, const Candidate& freed);

  // All drives late by a lag or by a delay, in the place of what else is late, where that leaves half of what
  // `best` does at most; by both where more is left and both are worth it.
  void Late(Candidate* best);

 private:
  bool LossesShow() const;
  Candidate Losses();
  Candidate Seen(const Candidate& c, bool base);
  void Couple(Candidate* best);
  void OtherDryLaw(Candidate* best);
  bool TakeNearest(const std::map<std::string, Candidate>& before, Candidate* best) const;
  void Freed(Candidate* best);
  Candidate WithFreeBase(const Candidate& c);
  Candidate WithZeros(const Candidate& c, const Candidate& either_way);
  bool IsGiven(const effects::EffectSpec& s) const;
  std::vector<effects::EffectSpec> OnAll(const std::string& id, double late) const;
  bool OfAllDrives(const Candidate& c) const;
  // χ² beyond noise, of the sensors' own noise: what the search takes for noise so far may be what is
  // missing. Infinite of a fit that failed.
  static double Left(const Candidate& c);
  static bool LeavesSomething(const Candidate& c);
  // Of what is left on some windows, that what is to halve it on all leaves at most.
  static constexpr double kMayBeUseful = 0.8;

  const FitSetting& setting_;
  FitLedger& fits_;
  const std::vector<effects::EffectSpec>& given_;
  std::function<double(const Candidate&, const Candidate&)> needed_;
  std::function<void(const Candidate&, Candidate*)> beside_, transmission_;
};

}  // namespace rg::diagnosis
