// A mass on a rod in the place of one in springs: after trials of a mass in springs, fits from many starts,
// since from far off each leads to a length, a hinge and a phase of its own.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "services/diagnosis/hypotheses/rod_screen.h"
#include "services/diagnosis/search/fit_ledger.h"

namespace rg::diagnosis {

// What trials of additions to a model found.
struct PendulumTrials {
  // A mass in springs on the tool and on the last link, the better first; none: nothing to look for.
  std::vector<std::shared_ptr<const Candidate>> springs;
  std::shared_ptr<const Candidate> surface;  // a force over two positions; null: none
};

struct FollowedStart {
  TrialSpecs specs;  // the rod, and what may act beside it
  RodStart start;
};

class PendulumSearch {
 public:
  // `from`: the model that the trials add to. All of these outlive this.
  PendulumSearch(const FitSetting& setting, FitLedger& fits, const Trace& trace, const Candidate& from,
                 const PendulumTrials& trials)
      : setting_(setting), fits_(fits), trace_(trace), from_(from), trials_(trials) {}

  // From what the recorded motion tells of a rod, one start at least. `found` becomes the best on all windows
  // where that scores better.
  void Follow(const std::vector<FollowedStart>& starts, Candidate* found);
  // Over lengths, hinges and places. `found`, the best of what was fitted, becomes the pendulum where that
  // scores better.
  void Run(Candidate* found);

 private:
  struct Hung {
    TrialSpecs specs;
    TrialSpecs needed;              // without effects that became superfluous with the pendulum
    double left = effects::kInf;    // typically
    double in_all = effects::kInf;  // χ² per row, with windows whose start is lost
  };

  bool MayBeOne(const Candidate& found);
  bool SpringsHold() const;
  TrialSpecs Springs() const;
  void Begin(const effects::EffectSpec& rod, std::vector<uint32_t> places);
  void TryLengths();
  void TryHinges();
  void FitWhole(Candidate* found);
  void Weigh(const TrialSpecs& specs, Candidate* found);
  bool FewWindowsLost() const;

  std::shared_ptr<const Candidate> Along(const RodStart& start) const;
  Hung Hang(const TrialSpecs& specs);
  double Typically(const std::vector<double>& window_chi2) const;

  const FitSetting& setting_;
  FitLedger& fits_;
  const Trace& trace_;
  const Candidate& from_;
  const PendulumTrials& trials_;

  TrialSpecs springs_;
  std::vector<effects::EffectSpec> hinges_;  // with the rod that the springs are, the likeliest first
  FitRequest request_;                       // of all trials here
  double missing_ = 0, enough_ = 0;          // what `from` leaves typically; of work
  double times_ = 1;                         // of the rod's length
  Hung nearest_;
  std::optional<Candidate> best_;  // on all windows
};

}  // namespace rg::diagnosis
