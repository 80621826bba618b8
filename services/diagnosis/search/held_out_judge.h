// Recordings kept aside have the last word on an account.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "services/diagnosis/hypotheses/search_result.h"
#include "services/diagnosis/likelihood/held_out.h"
#include "services/diagnosis/search/trace.h"

namespace rg::diagnosis {

// Remembers what it predicted: of the same values at the same noise it is asked several times.
class HeldOutJudge {
 public:
  // `options` may change between questions. Of the noise that they have all scores are.
  // `rod_given`: all models have a mass on a rod, whose swing speaks for none of them.
  HeldOutJudge(const FitData& held_out, const LiftedOptions& options, const Trace& trace,
               bool rod_given = false)
      : data_(held_out), options_(options), trace_(trace), rod_given_(rod_given) {}

  // Whether an account predicts them as well as noise allows (beyond it in 1 % of sets), or to within
  // `needed` nats, or with errors that no motion shows; or a mass on a rod swings on through them.
  bool Holds(const Candidate& account, double needed);
  // Whether it takes off more than half of what `without` is short of noise by; with hidden states, nine
  // tenths.
  bool ExplainsMost(const Candidate& account, const Candidate& without);
  // Of what was tried, beside an account that does not hold, the one that predicts most windows better, or
  // has names and holds, and in all by so much more that it pays for what its own fit is worse and for what
  // an addition needs; a force without a name pays the latter alone.
  // Empty where there is none. The scores of what was asked and predicts worse than it then hold that too.
  std::optional<Candidate> Better(const Candidate& account, std::map<std::string, Candidate>& tried,
                                  const std::function<double(const Candidate&)>& needed);
  // Log evidence of all recordings: of the fitted ones by the fit, of the others by what it predicts.
  double InAll(const Candidate& c) { return FitScore(c) + Of(c).log_density; }
  // The recording, by its place among those kept aside, that `account` is furthest from; −1 where it holds.
  int Refusing(const Candidate& account, double needed);
  // Gives the best model, and what the findings' alternatives are (separating_motion.h), their log densities.
  // An alternative that is likelier in all, by its fit and by what it predicts of most windows, takes the
  // best one's place: the sum is the log evidence of all recordings. A richer form of dry friction must
  // bring what it needs in the best one's place, as in the fit.
  void WeighRivals(SearchResult* search,
                   const std::function<double(const Candidate&, const Candidate&)>& needed);
  // Done since this was asked last.
  double TakeWork() { return std::exchange(work_, 0.0); }

 private:
  // What a prediction depends on.
  struct Question {
    std::string key;
    std::vector<double> values;
    double noise_scale;
    auto operator<=>(const Question&) const = default;
  };
  Question About(const Candidate& c) const;
  const HeldOut& Of(const Candidate& c);

  const FitData& data_;
  const LiftedOptions& options_;
  const Trace& trace_;
  bool rod_given_;
  std::map<Question, HeldOut> known_;
  double work_ = 0;
};

}  // namespace rg::diagnosis
