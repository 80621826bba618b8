#include "services/diagnosis/drive_search.h"

#include <algorithm>
#include <map>
#include <set>
#include <string>

#include "common/effects/effect_catalog.h"
#include "services/diagnosis/group_start.h"
#include "services/diagnosis/hypotheses.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr int kIterations = 12;      // of fits that begin far off
constexpr double kNear = 0.1;        // of what is amiss, that drives leave where more than they is missing
constexpr double kUseful = 0.5;      // the same, of friction and rotors that have to do with it at all
constexpr double kWorthwhile = 0.8;  // of what is left, that friction which drops with speed leaves
constexpr double kClearly = 10.0;    // stddev from nothing, of a loss that drives have
constexpr double kLateBy = 0.01;     // s, where a fit of lags or delays begins
constexpr const char* kDry = "coulomb_friction";
constexpr const char* kDropping = "stribeck_friction";
const std::vector<std::string> kLosses = {"viscous_friction", kDry, "rotor_inertia"};
constexpr const char* kTimings[] = {"actuator_lag", "actuator_delay"};

bool IsLoss(const std::string& id) {
  const effects::EffectInfo* info = effects::FindEffect(id);
  return std::count(kLosses.begin(), kLosses.end(), id) > 0 ||
         (info != nullptr && info->family == "friction");
}

// As a start for others: its values count though it be refused.
Candidate AsStart(Candidate c) {
  c.fit.ok = c.fit.values.allFinite() && c.fit.values.size() > 0;
  return c;
}

}  // namespace

std::optional<Candidate> DriveSearch::Run(const Candidate& plain, const Candidate& freed) {
  const std::map<std::string, Candidate> before = fits_.tried();
  const Candidate& without = freed.score > plain.score ? freed : plain;
  Candidate best = Losses(false);
  const bool useful = fits_.Excess(best) < kUseful * fits_.Excess(plain);
  if (useful) {
    Late(&best);
    OtherDryLaw(&best);
  }
  const auto near = [&] { return fits_.Excess(best) < kNear * fits_.Excess(without); };
  const Candidate drives = best;
  if (useful && !near()) Freed(&best);
  if (useful && !near() && drives.fit.ok && !fits_.Late()) {
    Candidate with = drives;
    beside_(drives, &with);
    if (fits_.Excess(with) < kUseful * fits_.Excess(best)) best = with;
  }
  if (near() && best.fit.ok && OfAllDrives(best) && best.score > without.score + needed_(without, best))
    return best;
  fits_.tried() = before;
  return std::nullopt;
}

// From the regression of the inverse dynamics.
Candidate DriveSearch::Losses(bool base) {
  const Candidate start = RegressedGroup(setting_.data, setting_.nominal, setting_.scales, kLosses, base);
  if (!start.fit.ok || start.specs.size() == given_.size() || fits_.Late()) return {};
  return Seen(fits_.Evaluate(start.specs, base, base ? &start : nullptr, kIterations), base);
}

// Without the losses that these recordings show nothing of, which would have the whole refused.
Candidate DriveSearch::Seen(const Candidate& c, bool base) {
  const Candidate all = AsStart(c);
  if (c.fit.ok || !all.fit.ok || fits_.Late()) return c;
  std::vector<EffectSpec> seen = Refreshed(all);
  for (size_t i = seen.size(); i-- > 0;) {
    if (i >= given_.size() && (Unseen(all, i) || Strength(all, i) < kNothing))
      seen.erase(seen.begin() + static_cast<long>(i));
  }
  if (seen.empty() || seen.size() == c.specs.size()) return c;
  return fits_.Evaluate(seen, base, &all, kIterations);
}

// All of them late by a lag, by a delay, or not at all. What takes little of what is left stands for
// something else that is missing, and would be in its way.
void DriveSearch::Late(Candidate* best) {
  const Candidate punctual = *best;
  for (const char* id : kTimings) {
    if (!LeavesSomething(punctual) || fits_.Late()) return;
    std::vector<EffectSpec> late;
    for (int j = 0; j < setting_.data.n; ++j) {
      const std::string& joint = setting_.nominal.joint_names()[static_cast<size_t>(j)];
      if (setting_.nominal.Takes(id, j) && !Contains(given_, id, joint))
        late.push_back(
            effects::MakeSpec(id, {joint}, {{effects::FindEffect(id)->parameters[0].name, kLateBy}}));
    }
    if (late.empty()) continue;
    const Candidate start = AsStart(punctual);
    const Candidate c =
        Seen(fits_.Evaluate(Joined(Refreshed(start), late), best->base, &start, kIterations), best->base);
    if (c.score > best->score && fits_.Excess(c) < kUseful * fits_.Excess(punctual)) *best = c;
  }
}

// Friction that drops with speed on all joints, as gears have it. Laws that hold a constant force in them
// would stand for a mass that is missing.
void DriveSearch::OtherDryLaw(Candidate* best) {
  if (!best->fit.ok || !LeavesSomething(*best) || fits_.Late()) return;
  std::vector<TrialSpecs> others = Exchanges(Refreshed(*best), kDry, setting_.nominal, setting_.scales);
  std::erase_if(others, [](const TrialSpecs& o) { return !HasKind(o, kDropping); });
  Candidate other = *best;
  fits_.TryInPlace(others, &other);
  if (fits_.Excess(other) < kWorthwhile * fits_.Excess(*best)) *best = other;
}

// Base parameters, where drives alone do not come near.
void DriveSearch::Freed(Candidate* best) {
  if (!best->fit.ok || !LeavesSomething(*best) || fits_.Late()) return;
  const Candidate c = fits_.Evaluate(Refreshed(*best), true, best, kIterations);
  if (c.score > best->score + needed_(*best, c)) *best = c;
}

bool DriveSearch::LeavesSomething(const Candidate& c) const {
  return !(fits_.noise_scale() * fits_.PerRow(c) < kExplained);
}

// Whether two kinds of loss at least are clearly there on at least half of the joints: one effect on one
// joint, or drives that are late and nothing else, is found as such.
bool DriveSearch::OfAllDrives(const Candidate& c) const {
  std::map<std::string, int> joints;
  for (size_t i = 0; i < c.specs.size(); ++i) {
    if (IsLoss(c.specs[i].id) && Strength(c, i) > kClearly) ++joints[c.specs[i].id];
  }
  return std::count_if(joints.begin(), joints.end(),
                       [&](const auto& kind) { return 2 * kind.second >= setting_.data.judged(); }) >= 2;
}

}  // namespace rg::diagnosis
