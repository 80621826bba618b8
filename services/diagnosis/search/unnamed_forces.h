// Hypotheses with one unnamed force in addition to the given model's effects.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/missing_force.h"
#include "services/diagnosis/search/fit_ledger.h"

namespace rg::diagnosis {

// Variables of an unnamed force. One over speed may follow two friction laws: it comes last.
inline const std::vector<std::string> kOfPlace = {"position", "drag"};
inline const std::vector<std::string> kAny = {"position", "drag", "velocity"};

class UnnamedForces {
 public:
  // force: the missing force of a candidate. needed(a, b): log evidence that b must bring in the place of a.
  // try_additions(c, &best): fits the most promising additions to c, and leaves the best of them and `best`.
  UnnamedForces(const FitSetting& setting, FitLedger& fits, const std::vector<effects::EffectSpec>& given,
                std::function<MissingForce(const Candidate&)> force,
                std::function<double(const Candidate&, const Candidate&)> needed,
                std::function<void(const Candidate&, Candidate*)> try_additions)
      : setting_(setting),
        fits_(fits),
        given_(given),
        force_(std::move(force)),
        needed_(std::move(needed)),
        try_additions_(std::move(try_additions)) {}

  // Fits one of each variable ("position": over two joints' positions where there are two), base parameters
  // fixed and, if `freed`, free, until enough() is true of one.
  void Try(bool freed, const std::vector<std::string>& variables,
           const std::function<bool(const Candidate&)>& enough);

  // The best fitted one without further effects; null: none.
  const Candidate* Best() const;

  // `unnamed` with catalogue effects added if these take nine tenths of its excess χ², or these alone if they
  // are accepted without it; else `unnamed`.
  Candidate WithNames(const Candidate& unnamed);

  // The model without effects that do not halve the excess χ²: the unnamed force's surface is coarse, and
  // other effects may merely correct it.
  Candidate WithoutCoarse(Candidate model);

 private:
  const FitSetting& setting_;
  FitLedger& fits_;
  const std::vector<effects::EffectSpec>& given_;
  std::function<MissingForce(const Candidate&)> force_;
  std::function<double(const Candidate&, const Candidate&)> needed_;
  std::function<void(const Candidate&, Candidate*)> try_additions_;
};

}  // namespace rg::diagnosis
