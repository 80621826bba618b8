// Which hypotheses get a trial fit after a screen: the best single ones, sets of joints and pairs of effects,
// and what no linear screen can see.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/missing_force.h"
#include "services/diagnosis/screening/screening.h"

namespace rg::diagnosis {

// The so many of some starts that are nearest to the recordings.
using Nearest = std::function<std::vector<TrialSpecs>(const std::vector<TrialSpecs>&, size_t)>;

// `least_gain`: hypotheses with less in the screen are left out; above 1 so is what it cannot see.
// `force`: the missing force of `from`, asked for only where it is needed.
std::vector<TrialSpecs> Trials(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                               const Candidate& from, const ScreenResult& screened, double least_gain,
                               const std::function<const MissingForce*()>& force, const Nearest& nearest);

// Springs and play beside what `from` has, those nearest to the recordings, on joints where much force is
// missing.
std::vector<TrialSpecs> TransmissionTrials(const FitData& data, const sim::Plant& nominal,
                                           const MotionScales& scales, const Candidate& from,
                                           const ScreenResult& screened,
                                           const std::function<const MissingForce*()>& force,
                                           const Nearest& nearest);

// What acts on that joint alone, whether the screen sees it or not, and what touches the robot.
std::vector<TrialSpecs> TrialsOnJoint(int joint, const FitData& data, const sim::Plant& nominal,
                                      const MotionScales& scales, const Candidate& from,
                                      const ScreenResult& screened,
                                      const std::function<const MissingForce*()>& force,
                                      const Nearest& nearest);

// Around a consistent model, the hypotheses with more than `needed` nats beyond their structure prior in the
// screen, best first and `count` at most: there the screen is exact to first order and of all windows, which
// shows small effects better than trials on some. Around another one only kinds that the model has already,
// on further joints.
std::vector<TrialSpecs> Promised(const Candidate& from, const ScreenResult& screened,
                                 const sim::Plant& nominal, const MotionScales& scales, bool consistent,
                                 double needed, size_t count);

// A trial fit that scores better than the model that it adds to.
struct RankedTrial {
  double left;    // share of that model's misfit that it leaves, on the same windows or pieces
  double excess;  // χ² beyond noise
  std::shared_ptr<const Candidate> fitted;
};

// The best of them, `count` at most, none twice, and without those of which a part leaves nearly as little: a
// trial's few iterations do not tell differences under a tenth. `apart`: those with another reference (hidden
// states on whole windows, others on pieces): the two lists take turns.
std::vector<std::shared_ptr<const Candidate>> BestOf(std::vector<RankedTrial> trials,
                                                     std::vector<RankedTrial> apart, size_t count);

// `specs` with effect `id`, but where it is `held`, exchanged for each that it resembles, on the same joints;
// Coulomb friction first. None where all of them are held.
std::vector<TrialSpecs> Exchanges(const TrialSpecs& specs, const std::string& id, const TrialSpecs& held,
                                  const sim::Plant& nominal, const MotionScales& scales);

// Springs and play behind the strongest rotors that `model` adds to `before`: below its resonance a motor
// behind a spring looks like a rotor, and no screen sees the difference.
std::vector<TrialSpecs> SpringsBehind(const Candidate& before, const Candidate& model,
                                      const sim::Plant& nominal, const MotionScales& scales);

}  // namespace rg::diagnosis
