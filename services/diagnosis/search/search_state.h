// What the parts of one search share: the recordings and the model that it starts from, its fits, how far it
// has come, and what an addition to a model must bring.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "services/diagnosis/likelihood/missing_force.h"
#include "services/diagnosis/screening/acceptance.h"
#include "services/diagnosis/search/fit_ledger.h"
#include "services/diagnosis/search/trace.h"

namespace rg::diagnosis {

// Of one fit of a model at one noise scale: its effects with its score and χ².
std::string KeyOfFit(const Candidate& c);

struct SearchState {
  SearchState(const FitSetting& setting, const DiagnosisOptions& options, int threads, const Clock& clock,
              const ProgressFn& progress, const CancelToken* cancel)
      : setting(setting),
        options(options),
        progress(progress),
        trace(clock),
        fits(this->setting, options, threads, trace, cancel) {}

  // Log evidence that any addition to `best` must bring; that `c` must in its place.
  double Threshold(const Candidate& best) const;
  double Threshold(const Candidate& best, const Candidate& c) const;
  // Log evidence of the effects of a candidate.
  double Explained(const Candidate& c) const;
  bool FoundNothing(const Candidate& c) const;
  // Whether the model that the search starts from has that effect.
  bool IsGiven(const effects::EffectSpec& s) const { return IsPart({s}, given); }
  // An unnamed force that the search did not start with; whether a model has one, and on the joint on which
  // any force explains the recordings.
  bool IsNewForce(const effects::EffectSpec& s) const;
  bool HasNewForce(const Candidate& c) const;
  bool HasForceInPlace(const Candidate& c) const;
  // That a fit leaves unexplained. Kept as long as the search: each is estimated once.
  const MissingForce& Force(const Candidate& c);
  // The same of values that no fit ended at.
  MissingForce EstimatedForce(const Candidate& c) const;
  // Where the search is: progress, and a line of the trace.
  void Tell(const std::string& stage, double done, const std::string& note) const;
  void TellOfRound(const std::string& stage, const std::string& note) const;

  const FitSetting setting;
  const DiagnosisOptions& options;
  const ProgressFn& progress;
  const Trace trace;
  FitLedger fits;
  Acceptance acceptance;
  std::vector<effects::EffectSpec> given;  // that the model has which the search starts from
  int round = 0;
  bool ordinary = false;  // the losses of all drives were found together
  int place = -1;         // joint of an unnamed force where any force explains the recordings; -1: none

 private:
  std::map<std::string, MissingForce> forces_;  // by fit and noise scale
};

}  // namespace rg::diagnosis
