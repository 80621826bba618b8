#include "services/diagnosis/search/simplifier.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <set>

#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

using effects::EffectSpec, effects::LawOf, effects::Regressor;

namespace {

constexpr double kPruned = 2.0;       // of all work, to take out what is not needed
constexpr double kSmallShare = 0.01;  // of what all effects explain
constexpr int kMergeIterations = 12;
constexpr size_t kManyGains = 3;      // joints, from which gains are rather what the bodies have
constexpr double kSmallGain = 0.01;   // of one: no URDF knows a mass better

// Whether it scales efforts by no more than a mass of any URDF is off.
bool IsSmallGain(const EffectSpec& s) {
  if (!effects::ScalesEffort(s.id)) return false;
  return std::all_of(s.joints.begin(), s.joints.end(), [&](const std::string& joint) {
    return std::abs(s.values.at(joint).at("gain") - 1) < kSmallGain;
  });
}

}  // namespace

void Simplifier::Run(Candidate* best) {
  GainsGiveWay(best);
  Prune(best);
  Plainer(best);
  OwnLaws(best);
  ByDirection(best);
  OffsetsOfSome(best);
  FirstRotor(best);
}

void Simplifier::DropNothing(Candidate* best) {
  const std::vector<EffectSpec> strong = StrongEffects(*best);
  if (strong.empty() || strong.size() == best->specs.size() || fits_.Late(kPruned)) return;
  const Candidate c = fits_.Evaluate(strong, best->base, best);
  if (best->score < c.score + needed_(c, *best)) *best = c;
}

void Simplifier::Prune(Candidate* best) {
  DropNothing(best);
  bool changed = true;
  while (changed && best->specs.size() > 1 && !fits_.Late(kPruned)) {
    changed = false;
    for (size_t i = 0; i < best->specs.size() && !changed; ++i) {
      // A force without a name follows what was missing when it was found: it is not sure beside names.
      const bool sure = !IsUnnamed(best->specs[i].id) && SurelyThere(*best, i, beside_(*best));
      std::vector<EffectSpec> specs = Refreshed(*best);
      specs.erase(specs.begin() + static_cast<long>(i));
      if (!sure) {
        const Candidate c = fits_.Evaluate(specs, best->base, best, 4, best);
        const double worth = OfAllJoints(*best, i) ? 0.0 : needed_(c, *best);
        if (best->score < c.score + worth) *best = c, changed = true;
      }
      if (!changed) changed = GivesWayToBodies(specs, i, best);
    }
  }
}

// What is small may stand for what the bodies differ by, as those of every URDF do: it gives way to them
// where they are the better account, or leave no more while it is not worth its name beside them. Free base
// parameters pay for differences of any size, which is why the better score is not asked of them; but what
// says in one number what takes bodies many is no such rival of theirs, unless it is a gain so near one that
// a mass is off by as much. Worth its name beside them it stays.
bool Simplifier::GivesWayToBodies(const std::vector<EffectSpec>& without, size_t i, Candidate* best) {
  const double strength = Strength(*best, i);
  const EffectSpec effect = Refreshed(*best)[i];
  const bool small_gain = IsSmallGain(effect);
  if (best->base || OfAllJoints(*best, i) ||
      (!small_gain && 0.5 * strength * strength > kSmallShare * explained_(*best)))
    return false;
  if (fits_.Late(kPruned)) return false;
  const Candidate freed = fits_.Evaluate(without, true, best, 6, best);
  const bool rival = (small_gain || !effects::InferenceOf(effect.id).for_many_bodies) && freed.fit.chi2 <= best->fit.chi2;
  if (!freed.fit.ok || (!rival && freed.score < best->score + needed_(*best, freed))) return false;
  const Candidate both = fits_.Evaluate(Refreshed(*best), true, &freed, 6, best);
  if (both.score > freed.score + needed_(freed, both)) return false;
  Replace(freed, best);
  return true;
}

// Gains of most drives that are all off say what masses say that are all off, but for friction and rotors,
// which are free too. Of the two the masses are the likelier: they take the gains' place where they leave no
// more.
void Simplifier::GainsGiveWay(Candidate* best) {
  const std::string& gain = LawOf(Regressor::kEffort).id;
  const TrialSpecs specs = WithoutKind(Refreshed(*best), gain);
  const size_t gains = best->specs.size() - specs.size();
  const bool of_most = gains >= kManyGains && 2 * gains > static_cast<size_t>(best->plant->num_joints());
  if (!of_most || best->base || fits_.Late(kPruned) || HasKind(setting_.nominal.effects(), gain))
    return;
  const Candidate* known = fits_.Known(specs, true);
  const Candidate bodies = known != nullptr ? *known : fits_.Evaluate(specs, true, best, 12);
  const double more = 0.5 * (bodies.fit.chi2 - best->fit.chi2) / fits_.noise_scale();
  if (bodies.fit.ok && more < 1) Replace(bodies, best);
}

// By what is the likelier account though its score may be less: nor is the old one found again.
void Simplifier::Replace(const Candidate& by, Candidate* best) {
  double& known = fits_.tried()[KeyOf(best->specs, best->base)].score;
  known = std::min(known, by.score);
  *best = by;
}

// Of a richer form the plain one that it holds: of dry friction that of one level, of play the spring that
// its faces are, of a spring the rotor behind it.
TrialSpecs Simplifier::PlainForm(const Candidate& c, const std::string& id) const {
  TrialSpecs specs = Refreshed(c);
  if (id == effects::Spring().id) return WithoutSprings(specs);
  if (id != effects::Play().id) return Exchanges(specs, id, setting_.nominal, setting_.scales).front();
  for (EffectSpec& s : specs) {
    if (s.id == id) s = OtherTransmission(s, setting_.nominal, setting_.scales).front().front();
  }
  return specs;
}

// A richer form that is not worth more than the plain one gives way to it.
void Simplifier::Plainer(Candidate* best) {
  std::vector<std::string> richer = RicherFrictions();
  richer.insert(richer.end(), {effects::Play().id, effects::Spring().id});
  for (const std::string& id : richer) {
    const TrialSpecs specs = PlainForm(*best, id);
    if (KeyOf(specs) == KeyOf(best->specs) || fits_.Late(kPruned)) continue;
    const Candidate* known = fits_.Known(specs, best->base);
    // What it holds as a special case cannot be better: the plain one's fit had not found its way.
    const bool done = known != nullptr && known->score >= best->score;
    Candidate plain = done ? *known : fits_.Evaluate(specs, best->base, best, 6, best);
    if (!done && known != nullptr) {
      // The plain one's first fit may have ended before it was done, and the richer one begun from there.
      const Candidate before = *known;
      const Candidate longer = fits_.Evaluate(Refreshed(before), before.base, &before, 12, best);
      for (const Candidate& c : {before, longer}) {
        if (c.score > plain.score) plain = c;
      }
    }
    // A spring is no matter of its rotor's form: it need only be the better account.
    const double needed = id == effects::Spring().id ? 1.0 : needed_(plain, *best);
    if (best->score >= plain.score + needed) continue;
    // What the form may pretend is not held for it when rivals are weighed.
    Candidate& form = fits_.tried()[KeyOf(best->specs, best->base)];
    form.score -= needed, form.form += needed;
    *best = plain;
  }
}

// A rotor on the first joint alone is the first body's inertia about its axis: beside another effect the
// body is the likelier of the two, and is named where it leaves no more.
void Simplifier::FirstRotor(Candidate* best) {
  TrialSpecs specs = Refreshed(*best);
  const auto rotor = [](const EffectSpec& s) { return s.id == LawOf(Regressor::kAcceleration).id; };
  const bool alone = std::count_if(specs.begin(), specs.end(), rotor) == 1;
  std::erase_if(specs, [&](const EffectSpec& s) {
    return rotor(s) && s.joints == std::vector<std::string>{setting_.nominal.joint_names()[0]};
  });
  if (!alone || specs.empty() || specs.size() == best->specs.size() || best->base || fits_.Late(kPruned) ||
      !setting_.nominal.model().joint(0).is_revolute())
    return;
  const Candidate body = fits_.Evaluate(specs, true, best, 6, best);
  const double more = 0.5 * (body.fit.chi2 - best->fit.chi2) / fits_.noise_scale();
  if (body.fit.ok && more < 1) Replace(body, best);
}

// Coulomb friction and a constant force, on each joint that has either, are one law: friction that depends on
// the direction. So are they where the force is gravity's, of a base that is tilted, on a rail that no pose
// turns against it; on other joints the score tells the two apart.
void Simplifier::ByDirection(Candidate* best) {
  const std::string &dry = LawOf(Regressor::kDirection).id, &zero = LawOf(Regressor::kConstant).id,
                    &tilt = effects::EffectOf(effects::Role::kGravity).id,
                    &either = LawOf(Regressor::kForwards).id;
  if (!best->fit.ok || !HasKind(best->specs, dry) || fits_.Late(kPruned)) return;
  const TrialSpecs specs = Refreshed(*best);
  std::map<std::string, double> level, offset;  // by joint
  for (const EffectSpec& s : specs) {
    if (s.id == dry) level[s.joints[0]] = s.values.at(s.joints[0]).at("coulomb");
    if (s.id == zero) offset[s.joints[0]] = s.values.at(s.joints[0]).at("offset");
  }
  const bool everywhere = std::all_of(offset.begin(), offset.end(),
                                      [&](const auto& o) { return level.count(o.first) > 0; }) &&
                          offset.size() == level.size();
  const bool tilted = offset.empty() && HasKind(best->specs, tilt);
  if (!everywhere && !tilted) return;
  TrialSpecs merged;
  for (const EffectSpec& s : specs) {
    if (s.id == zero || (tilted && s.id == tilt)) continue;
    if (s.id != dry) {
      merged.push_back(s);
      continue;
    }
    const double friction = level[s.joints[0]], constant = offset[s.joints[0]];
    merged.push_back(effects::MakeSpec(either, s.joints,
                                       {{"coulomb_positive", std::max(0.0, friction - constant)},
                                        {"coulomb_negative", std::max(0.0, friction + constant)}}));
  }
  // What a tilt pulls with is not known here: that fit begins at the recorded motion.
  const Candidate c = fits_.Evaluate(merged, best->base, tilted ? nullptr : best, kMergeIterations, best);
  if (c.fit.ok && c.score > best->score) *best = c;
}

// The other way round: friction of several joints that depends on the direction on some of them is Coulomb
// friction of all and a constant force on those. It is the same law in fewer numbers, so that names do not count.
void Simplifier::OffsetsOfSome(Candidate* best) {
  const std::string &dry = LawOf(Regressor::kDirection).id, &zero = LawOf(Regressor::kConstant).id,
                    &either = LawOf(Regressor::kForwards).id;
  TrialSpecs specs = Refreshed(*best), offsets;
  for (EffectSpec& s : specs) {
    if (s.id != either) continue;
    const std::map<std::string, double>& levels = s.values.at(s.joints[0]);
    const double forwards = levels.at("coulomb_positive"), backwards = levels.at("coulomb_negative");
    offsets.push_back(effects::MakeSpec(zero, s.joints, {{"offset", 0.5 * (backwards - forwards)}}));
    s = effects::MakeSpec(dry, s.joints, {{"coulomb", 0.5 * (backwards + forwards)}});
  }
  const size_t several = offsets.size();
  if (several < 2 || HasKind(specs, zero) || !best->fit.ok || fits_.Late(kPruned)) return;
  specs.insert(specs.end(), offsets.begin(), offsets.end());
  Candidate c = fits_.Evaluate(specs, best->base, best, kMergeIterations, best);
  if (!c.fit.ok) return;
  Prune(&c);
  const auto kept = std::count_if(c.specs.begin(), c.specs.end(), [&](const EffectSpec& s) { return s.id == zero; });
  const auto evidence = [](const Candidate& of) { return of.score + StructurePrior(of.specs, of.base); };
  if (static_cast<size_t>(kept) < several && evidence(c) > evidence(*best)) Replace(c, best);
}

// A richer form on several joints may bend into what is plain on one of them, and one kind of effect costs
// less than two: each joint has a try with a plain law of its own, which must bring what any further name
// must.
void Simplifier::OwnLaws(Candidate* best) {
  for (bool changed = true; changed && !fits_.Late();) {
    Candidate own = *best;
    std::vector<TrialSpecs> others = PlainOnOneJoint(Refreshed(*best), setting_.nominal, setting_.scales);
    std::erase_if(others, [&](const TrialSpecs& o) { return fits_.Known(o, best->base) != nullptr; });
    fits_.TryInPlace(others, &own);
    changed = own.score > best->score + needed_(*best, own);
    if (changed) *best = own;
  }
}

}  // namespace rg::diagnosis
