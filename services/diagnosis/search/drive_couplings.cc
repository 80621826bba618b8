// Whether a drive among all turns with two joints: a step of DriveSearch.

#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/search/drive_search.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using effects::Regressor;

namespace {

constexpr double kHalf = 0.5;  // of what is left, that it leaves at most: what takes little is something else
constexpr size_t kFitted = 2;  // starts that are worth a whole fit
constexpr int kCoupledIterations = 12;
constexpr double kStartRatios[] = {1.0, -1.0, 0.5, -0.5, 2.0, -2.0};  // the fit finds what lies between

// Of the plain law's effect on a joint, its one parameter.
double ValueOn(const std::vector<EffectSpec>& specs, Regressor law, const std::string& joint) {
  const effects::EffectInfo& effect = effects::LawOf(law);
  for (const EffectSpec& s : specs) {
    if (s.id != effect.id || !Contains({s}, effect.id, joint)) continue;
    const auto owner = s.values.find(joint);
    if (owner == s.values.end()) continue;
    const auto value = owner->second.find(effect.parameters[0].name);
    if (value != owner->second.end()) return value->second;
  }
  return 0;
}

}  // namespace

// One drive's losses moved to the motion of its joint and of the one before it, where that leaves half of
// what is left at most.
void DriveSearch::Couple(Candidate* best) {
  const std::string &coupling = effects::LawOf(Regressor::kOtherEffort).id,
                    &dry = effects::LawOf(Regressor::kDirection).id;
  if (!best->fit.ok || !LeavesSomething(*best) || HasKind(best->specs, coupling) || fits_.Late()) return;
  const Candidate now = *best;
  const std::vector<EffectSpec> specs = Refreshed(now);
  const auto& names = setting_.nominal.joint_names();
  std::vector<TrialSpecs> starts;
  for (int j = 0; j < setting_.data.n; ++j) {
    const int other = setting_.nominal.model().joint(j).parent;
    const bool fits = other >= 0 && other < setting_.data.n && Contains(specs, dry, names[j]) &&
                      setting_.nominal.Takes(coupling, j) && setting_.nominal.Takes(coupling, other);
    if (!fits || Contains(state_.given, dry, names[j])) continue;
    const DriveLosses losses = {ValueOn(specs, Regressor::kVelocity, names[j]),
                                ValueOn(specs, Regressor::kDirection, names[j]),
                                ValueOn(specs, Regressor::kAcceleration, names[j])};
    for (const double ratio : kStartRatios)
      starts.push_back({CoupledDrive(names[other], names[j], ratio, losses)});
  }
  for (const TrialSpecs& start : fits_.Nearest(now, starts, kFitted)) {
    if (fits_.Late()) return;
    const std::vector<EffectSpec> coupled = Joined(specs, start);
    if (!fits_.MayLeaveLess(now, coupled, now.base, kMayBeUseful)) continue;
    const Candidate c = Seen(fits_.Evaluate(coupled, now.base, &now, kCoupledIterations), now.base);
    if (c.fit.ok && Left(c) < kHalf * Left(now) && c.score > best->score) *best = c;
  }
}

}  // namespace rg::diagnosis
