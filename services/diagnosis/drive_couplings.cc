// Whether a drive among all turns with two joints: a step of DriveSearch.
#include <algorithm>

#include "common/model/robot_model.h"
#include "services/diagnosis/drive_search.h"
#include "services/diagnosis/hypotheses.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr double kHalf = 0.5;  // of what is left, that it leaves at most: what takes little is something else
constexpr size_t kFitted = 2;  // starts that are worth a whole fit
constexpr int kCoupledIterations = 12;
constexpr double kStartRatios[] = {1.0, -1.0, 0.5, -0.5, 2.0, -2.0};  // the fit finds what lies between

double ValueOn(const std::vector<EffectSpec>& specs, const std::string& id, const std::string& joint,
               const std::string& parameter) {
  for (const EffectSpec& s : specs) {
    if (s.id != id || !Contains({s}, id, joint)) continue;
    const auto owner = s.values.find(joint);
    if (owner != s.values.end() && owner->second.count(parameter)) return owner->second.at(parameter);
  }
  return 0;
}

// The plain losses of `joint` as those of a drive that turns with `other` too.
EffectSpec Coupled(const std::vector<EffectSpec>& specs, const std::string& other, const std::string& joint,
                   double ratio) {
  EffectSpec out = effects::MakeSpec("joint_coupling", {other, joint},
                                     {{"coefficient", ratio},
                                      {"viscous", ValueOn(specs, "viscous_friction", joint, "viscous")},
                                      {"coulomb", ValueOn(specs, "coulomb_friction", joint, "coulomb")},
                                      {"armature", ValueOn(specs, "rotor_inertia", joint, "armature")}});
  out.options["form"] = "kinematic";
  return out;
}

}  // namespace

// One drive's losses moved to the motion of its joint and of the one before it, where that leaves half of
// what is left at most.
void DriveSearch::Couple(Candidate* best) {
  if (!best->fit.ok || !LeavesSomething(*best) || HasKind(best->specs, "joint_coupling") || fits_.Late())
    return;
  const Candidate now = *best;
  const std::vector<EffectSpec> specs = Refreshed(now);
  const auto& names = setting_.nominal.joint_names();
  std::vector<TrialSpecs> starts;
  for (int j = 0; j < setting_.data.n; ++j) {
    const int other = setting_.nominal.model().joint(j).parent;
    const bool fits =
        other >= 0 && other < setting_.data.n && Contains(specs, "coulomb_friction", names[j]) &&
        setting_.nominal.Takes("joint_coupling", j) && setting_.nominal.Takes("joint_coupling", other);
    if (!fits || Contains(given_, "coulomb_friction", names[j])) continue;
    for (const double ratio : kStartRatios) starts.push_back({Coupled(specs, names[other], names[j], ratio)});
  }
  for (const TrialSpecs& start : fits_.Nearest(now, now.base, starts, kFitted)) {
    if (fits_.Late()) return;
    const std::vector<EffectSpec> coupled = Joined(specs, start);
    if (!fits_.MayLeaveLess(now, coupled, now.base, kMayBeUseful)) continue;
    const Candidate c =
        Seen(fits_.Evaluate(coupled, now.base, &now, kCoupledIterations), now.base);
    if (c.fit.ok && Left(c) < kHalf * Left(now) && c.score > best->score) *best = c;
  }
}

}  // namespace rg::diagnosis
