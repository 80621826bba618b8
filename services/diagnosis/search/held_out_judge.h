// Decides between fitted models by their hold-out predictive density.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "services/diagnosis/hypotheses/search_result.h"
#include "services/diagnosis/likelihood/held_out.h"
#include "services/diagnosis/search/trace.h"

namespace rg::diagnosis {

// Predictions are cached by model, values and noise scale.
class HeldOutJudge {
 public:
  // `options` may change between calls; all scores are at its noise scale.
  // `rod_given`: the given model has a pendulum payload, so that a continuous swing is no evidence for
  // others.
  HeldOutJudge(const FitData& held_out, const LiftedOptions& options, const Trace& trace,
               bool rod_given = false)
      : data_(held_out), options_(options), trace_(trace), rod_given_(rod_given) {}

  // Whether a model's deficit is consistent with noise (one-sided test at 1 %), or below `needed` nats, or
  // below that of errors a twentieth larger than the noise; or its pendulum payload swings continuously
  // (held_out.h).
  bool Holds(const Candidate& model, double needed);
  // Whether it has a pendulum payload that swings continuously over held-out recordings.
  bool SwingContinues(const Candidate& model) { return Of(model).swing_continues && !rod_given_; }
  // Whether its deficit is less than half of that of `without`; with hidden states, a tenth.
  bool ExplainsMost(const Candidate& model, const Candidate& without);
  // Log evidence of the fitted recordings plus log predictive density of the held-out ones.
  double TotalEvidence(const Candidate& c) { return c.score + Of(c).log_density; }
  // Index of the held-out recording that the model predicts worst; −1 if the model Holds.
  int WorstRecording(const Candidate& model, double needed);
  // Computes the predictive densities of the best model and of its rivals (rivals.h). A rival that has more
  // log evidence of all recordings by kSeparable nats and predicts most windows better replaces it; a richer
  // form of dry friction needs what it needs in the fit.
  void CompareRivals(SearchResult* search,
                     const std::function<double(const Candidate&, const Candidate&)>& needed);
  // Work (lifted_fit.h) since the last call.
  double TakeWork() { return std::exchange(work_, 0.0); }

 private:
  struct Question {
    std::string key;
    std::vector<double> values;
    double noise_scale, step_s;
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
