// Acceptance rule: the log evidence that an addition to a model must bring.
//
//   needed = ½ (√(2·chance) + √(2·rule))²
//
// chance: the larger of the null quantile (screening.h) and what a law's idealisation may leave: ε = 1 % of
// what the effects in the model explain. An addition that explains half of the misfit that is left need not
// exceed the latter, but always 10⁻⁴ of what is explained, the error of 1 % in an amplitude. The same holds
// for free base parameters added to effects.
//
// rule: what the same effect on the same joints, or free base parameters, would gain if another step rule had
// made the recordings (StepRuleResiduals). Amplitudes add, so the nats combine as above. Half of the misfit
// that is left suffices for step rule and idealisation together, and, where the model is far from the
// recordings, for the step rule alone.
#pragma once

#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/screening/screening.h"

namespace rg::diagnosis {

// Of a model in the place of another one that says as much: an exchange of one effect for another, the same
// effects fitted better, one law for free base parameters. A better score is enough.
inline constexpr double kExchange = 1.0;  // nats

// Half of χ² that a model leaves above noise, in units of the noise that it is weighed by.
struct Misfit {
  double at_stake = 0;  // above that noise
  double beyond_sensors =
      0;  // above the sensors' own, which may be less: what is left may be taken for noise
};

class Acceptance {
 public:
  // Takes the null quantile and the step-rule gains of a screen; of these the largest so far is kept.
  void Note(const ScreenResult& screened, const std::vector<std::string>& joint_names);

  // The step-rule gains alone, of a screen around another model.
  void NoteStepRules(const ScreenResult& screened, const std::vector<std::string>& joint_names);

  // Takes the step-rule gain of free base parameters.
  void NoteBase(const FitData& data, const Candidate& calibrated, const LiftedOptions& options);
  // The same at another noise scale.
  void RescaleBase(double before, double scale) { base_rule_ *= std::sqrt(before / scale); }

  double null_gain() const { return null_gain_; }

  // Nats needed by any addition to `best`, whose effects explain `explained` nats and which leaves `misfit`.
  double Needed(const Candidate& best, double explained, Misfit misfit) const;
  // Nats needed by `c` in the place of `best`. Effects on fixed base parameters in the place of free ones
  // without effects need the prior odds only, less the step-rule gain of the base parameters. So do, without
  // that, effects that `best` has, and its kinds of losses and timings on further joints; where it leaves
  // nothing, its kinds of any effects on whichever joints.
  double Needed(const Candidate& best, double explained, Misfit misfit, const Candidate& c) const;

 private:
  // rule: step-rule gain of the addition, as an amplitude √(2 nats).
  double NeededWithRule(const Candidate& best, double explained, Misfit misfit, double rule) const;
  double StepRule(const std::string& id, const std::string& joints) const;

  double null_gain_ = 3;
  double base_rule_ = 0;                     // √(2 nats), of free base parameters
  std::map<std::string, double> step_rule_;  // √(2 nats), of each screened hypothesis, by effect and joints
};

}  // namespace rg::diagnosis
