// A forward step of the search: a screen around a model, and fits of what the screen promises and of what no
// linear screen can see.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "services/diagnosis/hypotheses/rod_screen.h"
#include "services/diagnosis/likelihood/features.h"
#include "services/diagnosis/screening/screening.h"
#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

class ForwardStep {
 public:
  explicit ForwardStep(SearchState& state) : state_(state), setting_(state.setting), fits_(state.fits) {}

  // Before the first screen: regressors along the recorded motion.
  void MakeFeatures() {
    recorded_ = diagnosis::MakeFeatures(setting_.data, setting_.nominal, setting_.scales);
  }
  // Screens are kept within a round, and until the noise scale changes.
  void SetRound(int round);
  void ForgetScreens() { screens_.clear(); }
  // What another step rule makes is taken around the first model that is screened from here on.
  void ForgetStepRule() { step_rules_.clear(); }

  // Around the model's fit, or along the recorded motion where the model is far from it.
  ScreenResult Screen(const Candidate& current);
  // The same, whose null distribution counts for what is accepted from here on.
  ScreenResult NotedScreen(const Candidate& current);
  // Along the recorded motion of the windows at `places`, which `some` has alone: one for each joint of
  // `force`, with the force there integrated out.
  std::vector<ScreenResult> ScreensBesideForce(const Candidate& current, const FreeForce& force,
                                               const FitData& some, const std::vector<uint32_t>& places);

  // Each adds to `from`, of which the search need not think best; `winner` becomes the best fit where that
  // has more log evidence.
  //
  // All that a screen gives and all that it cannot see; beside hidden states, which make every fit dear, what
  // it promises alone.
  void Add(const Candidate& from, Candidate* winner);
  // What a screen promises alone, named effects first.
  void AddPromised(const Candidate& from, Candidate* winner);
  // A spring or play, on whichever joint where force is missing it is nearest to the recordings.
  void AddTransmission(const Candidate& from, Candidate* winner);
  // A mass on a rod that the recorded motion tells of, with the law that it does beside it.
  void AddRods(const Candidate& from, Candidate* winner);
  // A soft mount.
  void AddMount(const Candidate& from, Candidate* winner);
  // What acts on one joint alone, each with `beside`.
  void AddOnJoint(const Candidate& from, int joint, const TrialSpecs& beside, Candidate* winner);
  // Of a screen around `from` all that it gives `least` nats at least; where that is 1 or less, also what it
  // cannot see, after what it promises. `needed`: log evidence that an addition must bring;
  // `count`: fits on all windows, at most.
  void AddFrom(const Candidate& from, const ScreenResult& screened, double least, double needed, size_t count,
               Candidate* winner);
  // Laws of what is recorded alone. False where the screen does not promise most of what is left by them.
  bool AddLaws(const Candidate& from, double needed, Candidate* winner);
  // Whether laws of what is recorded, found beside `from`, leave nothing: hidden states, which cost far more
  // and fit nearly anything, need not be looked for then.
  bool ExplainedByLaws(const Candidate& from, const Candidate& found, double needed) const;

  // The largest gain of log evidence that a screen promises of one effect that `from` does not have, on all
  // of its joints at least. MostPromised: of what has a name and is no spring, and of sets and pairs, nothing
  // of which `from` has.
  double BestGain(const Candidate& from, const ScreenResult& screened) const;
  double MostPromised(const Candidate& from, const ScreenResult& screened) const;

 private:
  TrialSpecs WithLaw(const RodStart& start, const ScreenResult& screened) const;
  // Regressors for a screen around that model, which fits the recordings if `near`.
  FeatureSet FeaturesFor(const Candidate& current, bool near) const;
  void Try(const Candidate& from, const ScreenResult& screened, double least, double needed, size_t count,
           Candidate* winner);
  bool TakesMost(const Candidate& from, const Candidate& found) const;

  SearchState& state_;
  const FitSetting& setting_;
  FitLedger& fits_;
  FeatureSet recorded_;                                        // along the recorded motion
  std::map<double, std::vector<Eigen::VectorXd>> step_rules_;  // of a model's own step [s]
  std::map<std::string, ScreenResult> screens_;                // of this round, by model and fit
  int round_ = 0;
};

}  // namespace rg::diagnosis
