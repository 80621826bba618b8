// Accounts that rest on one force without a name, beside what the model is given.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/missing_force.h"
#include "services/diagnosis/search/fit_ledger.h"

namespace rg::diagnosis {

class UnnamedForces {
 public:
  // force: what a candidate leaves. needed(a, b): log evidence that b must bring in the place of a.
  // look_beside(c, &best): trials of what may be added to c; the best of them and of `best`.
  UnnamedForces(const FitSetting& setting, FitLedger& fits, const std::vector<effects::EffectSpec>& given,
                std::function<MissingForce(const Candidate&)> force,
                std::function<double(const Candidate&, const Candidate&)> needed,
                std::function<void(const Candidate&, Candidate*)> look_beside)
      : setting_(setting),
        fits_(fits),
        given_(given),
        force_(std::move(force)),
        needed_(std::move(needed)),
        look_beside_(std::move(look_beside)) {}

  // One over each of the variables, of two joints' positions or of what one joint has, with base parameters
  // as given and, where `freed`, with free ones, until one is enough.
  void Try(bool freed, const std::vector<std::string>& variables,
           const std::function<bool(const Candidate&)>& enough);

  // Of those that were tried the best without names; null: none.
  const Candidate* Best() const;

  // `unnamed` with the effects by name that take off nine tenths of what it leaves, or these alone where they
  // do as well without it; itself where there are none.
  Candidate WithNames(const Candidate& unnamed);

  // An account with a force without a name has effects by name beside it that halve what would be left
  // without them: its surface is coarse, and what else takes some of that is no effect.
  Candidate WithoutCoarse(Candidate account);

 private:
  const FitSetting& setting_;
  FitLedger& fits_;
  const std::vector<effects::EffectSpec>& given_;
  std::function<MissingForce(const Candidate&)> force_;
  std::function<double(const Candidate&, const Candidate&)> needed_;
  std::function<void(const Candidate&, Candidate*)> look_beside_;
};

}  // namespace rg::diagnosis
