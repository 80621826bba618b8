// When an addition to a model is worth a name: the log evidence that it must bring.
//
//   needed = ½ (√(2·chance) + √(2·rule))²
//
// chance: what the best of all hypotheses gains from noise alone in 2 % of recordings (screening.h draws
// them), or what the idealised form of the effects found so far may leave: 1 % of what they explain, but an
// addition that takes half of all that is left above the noise is no matter of form, unless it is worth less
// than 1e-4 of it, which is what an error of 1 % in an amplitude makes. Free base parameters beside effects
// are such an addition too.
//
// rule: what the same effect on the same joints, or free base parameters, would gain from another step rule
// alone (StepRuleResiduals). Amplitudes add, so their squares, the nats, add like this. What takes half of
// all that is left is no matter of the step rule and the form together either, nor, around a model that has
// little to do with the record, of the step rule alone.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/screening/screening.h"

namespace rg::diagnosis {

class Acceptance {
 public:
  // Takes in a screen; the largest step-rule gain of each hypothesis so far is kept.
  void Note(const ScreenResult& screened, const std::vector<std::string>& joint_names);

  // The step-rule gains alone, of a screen that is not of the account at hand.
  void NoteStepRules(const ScreenResult& screened, const std::vector<std::string>& joint_names);

  // Takes in what free base parameters would gain from another step rule alone.
  void NoteBase(const FitData& data, const Candidate& calibrated, const LiftedOptions& options);

  double null_gain() const { return null_gain_; }

  // Of any addition to `best`, whose effects explain `explained` nats and which leaves `at_stake` nats.
  double Needed(const Candidate& best, double explained, double at_stake) const;
  // Of `c` in place of `best`. A model with less in it that explains as much needs no more than the odds, and
  // may be short of what free base parameters gain from another step rule alone.
  double Needed(const Candidate& best, double explained, double at_stake, const Candidate& c) const;

 private:
  // rule: of the addition, √(2 nats).
  double NeededBeside(const Candidate& best, double explained, double at_stake, double rule) const;
  double StepRule(const std::string& id, const std::string& joints) const;

  double null_gain_ = 3;
  double base_rule_ = 0;                     // √(2 nats)
  std::map<std::string, double> step_rule_;  // √(2 nats) of every hypothesis screened, by effect and joints
};

// Of all that were tried the best with fewer names than `winner` (free base parameters are one) that is a
// better account than `before` and which `winner` does not beat by what its further names need; null: none.
// It need not be a part of the winner, for two laws together may bend into the shape of a third, but another
// must then be worth more than a part is by what it needs: a poor law's shape takes in some of what the
// winner's further names explain, and would win by that alone. needed(a, b): log evidence that b must bring
// in place of a.
const Candidate* FewerNames(const std::map<std::string, Candidate>& tried, const Candidate& before,
                            const Candidate& winner,
                            const std::function<double(const Candidate&, const Candidate&)>& needed);

// Of what was tried on the parameters as given the `most` best that are named, add to `before` no more kinds
// than `account` does, have no states that commands do not settle, and leave at most twice as much as it does
// there.
std::vector<Candidate> PlainRivals(const std::map<std::string, Candidate>& tried, const Candidate& before,
                                   const Candidate& account, size_t most);

// Of what was tried with free base parameters the best by name that has all that `before` has and a kind
// more; null: none.
const Candidate* BestFreed(const std::map<std::string, Candidate>& tried, const Candidate& before);

// Of what was tried on the parameters as given the best that has other effects than `freed`, whose parameters
// are free, and is as good an account; null: none, or these are not free.
// needed(a, b): log evidence that b must bring in place of a.
const Candidate* AsGoodAsFreed(const std::map<std::string, Candidate>& tried, const Candidate& freed,
                               const std::function<double(const Candidate&, const Candidate&)>& needed);

}  // namespace rg::diagnosis
