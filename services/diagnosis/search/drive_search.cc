#include "services/diagnosis/search/drive_search.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/group_start.h"
#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

using effects::EffectSpec, effects::LawOf, effects::Regressor;

namespace {

constexpr int kIterations = 12;        // of fits from far off
constexpr double kNear = 0.2;          // of the excess χ²: most that the group leaves
constexpr double kCloser = 0.1;        // above which free base parameters or one addition are tried
constexpr double kUseful = 0.5;        // most that a useful step leaves
constexpr double kShown = 0.85;        // of the regression's residual scale: most that true losses leave
constexpr double kWorthwhile = 0.8;    // of the excess: most that another law leaves, to be asked on
constexpr int kThingsBeside = 4;       // additions to the group, at most
constexpr double kClearly = 10.0;      // standard deviations from zero, of a significant loss
constexpr double kLateBy = 0.01;       // s, where a fit of lags or delays begins
constexpr double kLittleLate = 0.004;  // s, the same of one beside the other
const std::string kDry = LawOf(Regressor::kDirection).id;
const std::string kDropping = LawOf(Regressor::kSlowly).id;
const std::string kEitherWay = LawOf(Regressor::kForwards).id;
const std::string kZero = LawOf(Regressor::kConstant).id;
const std::vector<std::string> kLosses = {LawOf(Regressor::kVelocity).id, kDry,
                                          LawOf(Regressor::kAcceleration).id};
constexpr const char* kTiming = "timing";  // the family of
const std::string kTimings[] = {LawOf(Regressor::kLagging).id, LawOf(Regressor::kDelayed).id};

bool IsLoss(const std::string& id) {
  const effects::EffectInfo* info = effects::FindEffect(id);
  return std::ranges::count(kLosses, id) > 0 || (info != nullptr && info->family == "friction");
}

long CountOf(const std::vector<EffectSpec>& specs, const std::string& id) {
  return std::ranges::count_if(specs, [&](const EffectSpec& s) { return s.id == id; });
}

// As a start of other fits, inadmissible or not.
Candidate AsStart(Candidate c) {
  c.fit.ok = c.fit.values.allFinite() && c.fit.values.size() > 0;
  return c;
}

}  // namespace

std::optional<Candidate> DriveSearch::Run(const Candidate& plain, const Candidate& freed) {
  if (!LossesShow()) return std::nullopt;
  const std::map<std::string, Candidate> kept = fits_.tried();
  const Candidate& without = freed.score > plain.score ? freed : plain;
  Candidate best = Losses();
  const bool useful = best.plant != nullptr && Left(best) < kUseful * Left(plain);
  const auto leaves = [&](double share) { return Left(best) > share * Left(without); };
  // A missing effect hides what the drives have: after each addition that takes half of the excess, or
  // another law that takes a fifth, they are reconsidered.
  std::set<std::string> looked_at;  // with their scores
  for (int more = 0; useful && more < kThingsBeside; ++more) {
    const double before = Left(best);
    Late(&best);
    if (looked_at.insert(KeyOf(best.specs, best.base) + std::to_string(best.score)).second) {
      Couple(&best);
      OtherDryLaw(&best);
      LawOnEachJoint(&best);
    }
    const Candidate drives = best;
    Freed(&best);
    if (!drives.fit.ok || fits_.Late()) break;
    // Losses of which free base parameters make no use stand for something else.
    if (best.base && freed.fit.ok && Left(best) > Left(freed)) {
      fits_.tried() = kept;
      return std::nullopt;
    }
    // Two missing effects may each take less than half while the other is missing.
    if (LeavesSomething(best) && (Left(best) < kWorthwhile * before || TakeNearest(kept, &best))) continue;
    if (!leaves(kCloser)) break;
    Candidate with = drives;
    step_.AddPromised(drives, &with);
    if (!(Left(with) < kUseful * Left(best)) && !fits_.Late()) step_.AddTransmission(drives, &with);
    if (!(Left(with) < kUseful * Left(best))) break;
    best = with;
  }
  if (useful && !leaves(kNear) && best.fit.ok && OfAllDrives(best) &&
      best.score > without.score + state_.Threshold(without, best))
    return best;
  fits_.tried() = kept;
  return std::nullopt;
}

// Whether the regression of the inverse dynamics gains by losses on at least half of the joints. (In the
// simulator they would absorb part of anything.)
bool DriveSearch::LossesShow() const {
  const Eigen::VectorXd left = LeftByGroup(setting_, kLosses);
  int joints = 0;
  for (int j = 0; j < setting_.data.n; ++j) {
    if (setting_.data.Judged(j) && left[j] < kShown) ++joints;
  }
  return 2 * joints >= setting_.data.judged();
}

// The best model fitted here, where it takes a fifth of the excess of `best`.
bool DriveSearch::TakeNearest(const std::map<std::string, Candidate>& before, Candidate* best) const {
  const Candidate* nearest = best;
  for (const auto& [key, c] : fits_.tried()) {
    if (before.count(key) == 0 && c.fit.ok && Left(c) < Left(*nearest)) nearest = &c;
  }
  if (!(Left(*nearest) < kWorthwhile * Left(*best)) || nearest->score < best->score) return false;
  *best = Candidate(*nearest);
  return true;
}

// Losses on all joints, started from the regression of the inverse dynamics.
Candidate DriveSearch::Losses() {
  const Candidate start = RegressedGroup(setting_, kLosses, false);
  if (!start.fit.ok || start.specs.size() == state_.given.size() || fits_.Late()) return {};
  return Seen(fits_.Evaluate(start.specs, false, nullptr, kIterations), false);
}

// The same without what makes a model inadmissible: losses that the data do not inform, ripples that are not
// periodic, and Stribeck friction where it would rise with speed, which becomes plain.
Candidate DriveSearch::Seen(const Candidate& c, bool base) {
  const Candidate all = AsStart(c);
  if (c.fit.ok || !all.fit.ok || fits_.Late()) return c;
  // The noise is known badly while losses are missing: what is left above the sensors' own may bend a period.
  std::set<size_t> aperiodic;
  if (fits_.PerRow(all) < kConsistent) aperiodic = Aperiodic(all, setting_.scales, 1.0, true);
  const std::set<size_t> rising = Rising(all);
  const std::vector<EffectSpec> specs = Refreshed(all);
  std::vector<EffectSpec> seen;
  for (size_t i = 0; i < specs.size(); ++i) {
    const bool weak = Uninformed(all, i) || Strength(all, i) < kAbsent;
    const bool none = aperiodic.count(i) > 0 || (weak && !LikeOtherJoints(all, i));
    if (state_.IsGiven(specs[i]) || !(none || rising.count(i) > 0)) {
      seen.push_back(specs[i]);
    } else if (!none) {
      seen.push_back(Exchanged(specs[i], kDry, setting_.nominal, setting_.scales));
    }
  }
  if (seen.empty() || KeyOf(seen) == KeyOf(c.specs)) return c;
  return fits_.Evaluate(seen, base, &all, kIterations);
}

// A lag or delay that takes little stands for something else, and would hide it.
void DriveSearch::Late(Candidate* best) {
  if (!LeavesSomething(*best) || (HasKind(best->specs, kTimings[0]) && HasKind(best->specs, kTimings[1])))
    return;
  const Candidate now = *best, start = AsStart(*best);
  std::vector<EffectSpec> punctual = Refreshed(start);
  std::erase_if(punctual, [&](const EffectSpec& s) {
    return effects::FindEffect(s.id)->family == kTiming && !state_.IsGiven(s);
  });
  std::vector<std::pair<std::string, std::vector<EffectSpec>>> late;
  for (const std::string& id : kTimings) {
    const std::vector<EffectSpec> all = OnAll(id, kLateBy), specs = Joined(punctual, all);
    if (all.empty()) continue;
    late.push_back({id, specs});
    late.push_back({id, RipplesAcrossLags(specs)});
  }
  std::string taken;
  for (const auto& [id, specs] : late) {
    if (specs.empty() || KeyOf(specs) == KeyOf(now.specs) || fits_.Late()) continue;
    if (fits_.Known(specs, now.base) == nullptr && !fits_.MayLeaveLess(start, specs, now.base, kMayBeUseful))
      continue;
    const Candidate whole = fits_.KnownOrFitted(specs, now.base, &start, kIterations);
    // Without a ripple that stood for late drives more may be left: it is found again, as it is.
    const Candidate c = Seen(whole, now.base);
    const bool useful = Left(whole) < kUseful * Left(now) && Left(c) < Left(now);
    if (useful && c.score > best->score) *best = c, taken = id;
    if (taken == id && !LeavesSomething(*best)) break;
  }
  if (taken.empty() || !LeavesSomething(*best) || fits_.Late()) return;
  // Both: a lag, and a small delay before it.
  const Candidate one = *best;
  const std::vector<EffectSpec> other = OnAll(taken == kTimings[0] ? kTimings[1] : kTimings[0], kLittleLate);
  const Candidate both =
      Seen(fits_.Evaluate(Joined(Refreshed(one), other), one.base, &one, kIterations), one.base);
  if (both.score > one.score + state_.Threshold(one, both)) *best = both;
}

std::vector<EffectSpec> DriveSearch::OnAll(const std::string& id, double late) const {
  std::vector<EffectSpec> out;
  for (int j = 0; j < setting_.data.n; ++j) {
    const std::string& joint = setting_.nominal.joint_names()[j];
    if (setting_.nominal.Takes(id, j) && !Contains(state_.given, id, joint))
      out.push_back(effects::MakeSpec(id, {joint}, {{effects::FindEffect(id)->parameters[0].name, late}}));
  }
  return out;
}

// Another law of dry friction on all joints: Stribeck friction, or friction by direction. The latter contains
// a constant force and may stand for wrong masses: free base parameters replace it where they leave about as
// little, and where it explains all, if with late drives, if they score better. So do torque offsets, where
// at most half of the joints need one; friction by direction is a property of gears, and then of most joints.
void DriveSearch::OtherDryLaw(Candidate* best) {
  if (!best->fit.ok || !LeavesSomething(*best) || fits_.Late()) return;
  const std::vector<TrialSpecs> laws =
      Exchanges(Refreshed(*best), kDry, state_.given, setting_.nominal, setting_.scales);
  const auto exchanged = std::ranges::count_if(
      best->specs, [&](const EffectSpec& s) { return s.id == kDry && !state_.IsGiven(s); });
  const auto with = [&](const std::string& id) {
    std::vector<TrialSpecs> others = laws;
    std::erase_if(
        others, [&](const TrialSpecs& o) { return CountOf(o, id) != CountOf(best->specs, id) + exchanged; });
    return InPlace(others, *best);
  };
  const Candidate drops = with(kDropping);
  const Candidate either_way = with(kEitherWay);
  if (Left(either_way) < kUseful * Left(drops)) {
    const Candidate zeros = WithZeros(*best, either_way);
    const Candidate directed = zeros.fit.ok && Left(zeros) < Left(either_way) / kUseful ? zeros : either_way;
    if (TakeOneLaw(directed, best)) return;
    // What late drives leave is left by either: where these explain the rest, masses have to score better.
    Candidate with_timing = directed, bodies = WithFreeBase(*best);
    Late(&with_timing);
    if (with_timing.fit.ok && fits_.LeavesNothing(with_timing)) {
      if (bodies.fit.ok) Late(&bodies);
      *best = Better(with_timing, bodies);
      return;
    }
    if (!(Left(bodies) < Left(either_way) / kUseful)) {
      *best = directed;
      return;
    }
    if (Left(bodies) < kUseful * Left(*best) &&
        bodies.score > best->score + state_.Threshold(*best, bodies)) {
      *best = bodies;
      Late(best);
      return;
    }
  }
  if (Left(drops) < kWorthwhile * Left(*best)) *best = drops;
}

// The best of these in the place of `c`. One joint on which a law does not hold is no reason against all
// others.
Candidate DriveSearch::InPlace(const std::vector<TrialSpecs>& others, const Candidate& c) {
  Candidate best = c;
  fits_.TryInPlace(others, &best);
  for (const TrialSpecs& other : others) {
    const Candidate* refused = fits_.Known(other, c.base);
    if (refused == nullptr || refused->fit.ok) continue;
    const Candidate seen = Seen(*refused, c.base);
    if (seen.score > best.score) best = seen;
  }
  return best;
}

void DriveSearch::Reconsider(const Candidate& before, Candidate* best) {
  if (!best->fit.ok || !LeavesSomething(*best) || fits_.Late()) return;
  std::vector<TrialSpecs> laws;
  for (const std::string& law : {kDry, kDropping, kEitherWay}) {
    TrialSpecs all = Refreshed(*best);
    for (EffectSpec& s : all) {
      const bool of_drive = effects::IsIn(effects::Slot::kDryFriction, s.id) && !state_.IsGiven(s) &&
                            Contains(before.specs, s.id, s.joints[0]);
      if (of_drive && s.id != law &&
          setting_.nominal.Takes(law, setting_.nominal.model().FindJoint(s.joints[0])))
        s = Exchanged(s, law, setting_.nominal, setting_.scales);
    }
    if (KeyOf(all) != KeyOf(best->specs)) laws.push_back(std::move(all));
  }
  const Candidate other = InPlace(laws, *best);
  if (other.score > best->score + kExchange) *best = other;
  Late(best);
}

// One law, as a sensor that reads off or a tilted base, may pull on several joints as constant forces do:
// with no more parameters a better score is enough. What masses may do as well is left to free base
// parameters.
bool DriveSearch::TakeOneLaw(const Candidate& directed, Candidate* best) {
  if (fits_.Late()) return false;
  Candidate one = *best;
  step_.AddPromised(*best, &one);
  const std::set<std::string> kinds = FreshKinds(*best, one);
  const bool bodily = std::ranges::any_of(kinds, [](const std::string& id) {
    return effects::ScalesEffort(id) || id == effects::EffectOf(effects::Role::kBodyInertia).id;
  });
  if (HasUnnamed(one) || bodily || one.parameters.size() > directed.parameters.size() ||
      !(one.score > directed.score))
    return false;
  *best = one;
  return true;
}

// A further law on all joints, as the springs of cables: one joint at a time none brings the model near, and
// coefficients of a screen far from the recordings are no start.
void DriveSearch::LawOnEachJoint(Candidate* best) {
  if (!best->fit.ok || !LeavesSomething(*best) || fits_.Late()) return;
  const Candidate now = *best;
  for (const LawOnAll& law : LawsOnAll(setting_, kLosses, best->base, kShown)) {
    if (fits_.Late()) return;
    const Candidate c =
        Seen(fits_.Evaluate(Joined(Refreshed(now), law.specs), now.base, &now, kIterations), now.base);
    if (c.score > best->score + state_.Threshold(now, c) && Left(c) < kUseful * Left(now)) *best = c;
  }
}

// Friction by direction as Coulomb friction and constant forces, where at most half of the joints need these;
// else none.
Candidate DriveSearch::WithZeros(const Candidate& c, const Candidate& either_way) {
  Candidate start = AsStart(c);
  start.specs = Refreshed(start);
  for (const EffectSpec& s : Refreshed(AsStart(either_way))) {
    if (s.id != kEitherWay || Contains(start.specs, kZero, s.joints[0])) continue;
    const std::map<std::string, double>& level = s.values.at(s.joints[0]);
    const double offset = 0.5 * (level.at("coulomb_negative") - level.at("coulomb_positive"));
    start.specs.push_back(effects::MakeSpec(kZero, s.joints, {{"offset", offset}}));
  }
  if (fits_.Late()) return {};
  Candidate zeros = fits_.Evaluate(start.specs, c.base, &c, kIterations);
  const std::vector<EffectSpec> strong = StrongEffects(AsStart(zeros));
  const auto count = std::ranges::count_if(strong, [](const EffectSpec& s) { return s.id == kZero; });
  if (count == 0 || 2 * count > setting_.data.judged() || fits_.Late()) return {};
  return strong.size() == zeros.specs.size() ? zeros : fits_.Evaluate(strong, c.base, &zeros, kIterations);
}

Candidate DriveSearch::WithFreeBase(const Candidate& c) {
  return fits_.KnownOrFitted(Refreshed(c), true, &c, kIterations);
}

// Free base parameters, and then timing again, where they take half of the excess.
void DriveSearch::Freed(Candidate* best) {
  if (!best->fit.ok || !LeavesSomething(*best) || fits_.Late()) return;
  const std::vector<EffectSpec> specs = Refreshed(*best);
  if (fits_.Known(specs, true) == nullptr && !fits_.MayLeaveLess(*best, specs, true, kMayBeUseful)) return;
  Candidate c = WithFreeBase(*best);
  if (!c.fit.ok) return;
  Late(&c);
  if (c.score > best->score + state_.Threshold(*best, c) && Left(c) < kUseful * Left(*best)) *best = c;
}

double DriveSearch::Left(const Candidate& c) {
  const bool fitted = c.fit.rows > 0 && c.fit.chi2 > 0;
  return fitted ? std::max(0.0, c.fit.chi2 - c.fit.rows) : effects::kInf;
}

bool DriveSearch::LeavesSomething(const Candidate& c) { return !(c.fit.chi2 < kExplained * c.fit.rows); }

// Whether at least two kinds of loss are significant on at least half of the joints. One effect on one joint,
// or late drives alone, are found by the search itself.
bool DriveSearch::OfAllDrives(const Candidate& c) const {
  // What is left inflates the errors.
  const double clearly = kClearly * std::sqrt(std::max(1.0, fits_.PerRow(c)));
  std::map<std::string, int> joints;
  for (size_t i = 0; i < c.specs.size(); ++i) {
    if (IsLoss(c.specs[i].id) && Strength(c, i, true) > clearly) ++joints[c.specs[i].id];
  }
  return std::ranges::count_if(
             joints, [&](const auto& kind) { return 2 * kind.second >= setting_.data.judged(); }) >= 2;
}

}  // namespace rg::diagnosis
