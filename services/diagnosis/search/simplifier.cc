#include "services/diagnosis/search/simplifier.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/hypotheses/rivals.h"

namespace rg::diagnosis {

using effects::EffectSpec, effects::LawOf, effects::Regressor;

namespace {

constexpr double kPruned = 2.0;       // of the work limit, after which nothing is removed
constexpr double kSmallShare = 0.01;  // of what all effects explain
constexpr int kMergeIterations = 12;
constexpr size_t kManyGains = 3;     // joints, from which on gains are rather errors of masses
constexpr double kSmallGain = 0.01;  // of one: no URDF knows a mass better

// Whether it scales efforts by no more than the error of any URDF's masses.
bool IsSmallGain(const EffectSpec& s) {
  if (!effects::ScalesEffort(s.id)) return false;
  return std::ranges::all_of(s.joints, [&](const std::string& joint) {
    return std::abs(s.values.at(joint).at("gain") - 1) < kSmallGain;
  });
}

// Without the structure's prior.
double EvidenceAlone(const Candidate& c) { return FitScore(c) + StructurePrior(c.specs, c.base); }

}  // namespace

void Simplifier::Run(Candidate* best) {
  GainsYieldToInertials(best);
  Prune(best);
  UsePlainLaws(best);
  UsePlainLawsOnJoints(best);
  UseLawOfMostJoints(best);
  MergeByDirection(best);
  SplitByDirection(best);
  FirstRotorAsInertia(best);
}

void Simplifier::DropAbsent(Candidate* best) {
  const std::vector<EffectSpec> strong = StrongEffects(*best);
  if (strong.empty() || strong.size() == best->specs.size() || fits_.Late(kPruned)) return;
  const Candidate c = fits_.Evaluate(strong, best->base, best);
  if (best->score < c.score + needed_(c, *best)) *best = c;
}

void Simplifier::Prune(Candidate* best) {
  DropAbsent(best);
  bool changed = true;
  while (changed && best->specs.size() > 1 && !fits_.Late(kPruned)) {
    changed = false;
    for (size_t i = 0; i < best->specs.size() && !changed; ++i) {
      // An unnamed force follows whatever was missing when it was found: it is always tested.
      const bool sure = !IsUnnamed(best->specs[i].id) && ClearlyNonzero(*best, i, beside_(*best));
      std::vector<EffectSpec> specs = Refreshed(*best);
      specs.erase(specs.begin() + static_cast<long>(i));
      if (!sure) {
        const Candidate c = fits_.Evaluate(specs, best->base, best, 4, best);
        const double worth = OfAllJoints(*best, i) ? 0.0 : needed_(c, *best);
        if (best->score < c.score + worth) *best = c, changed = true;
      }
      if (!changed) changed = YieldsToInertials(specs, i, best);
    }
  }
}

// A small effect may stand for errors of the URDF's inertials. It yields to free base parameters where these
// score better, or where they leave no more and it is not significant beside them: their Occam factor grows
// with errors of any size, so a better score is not asked of them. Not so an effect that says in one number
// what would take many base parameters, unless it is a gain as near one as masses are to the truth.
bool Simplifier::YieldsToInertials(const std::vector<EffectSpec>& without, size_t i, Candidate* best) {
  const double strength = Strength(*best, i);
  const EffectSpec effect = Refreshed(*best)[i];
  const bool small_gain = IsSmallGain(effect);
  if (best->base || OfAllJoints(*best, i) ||
      (!small_gain && 0.5 * strength * strength > kSmallShare * explained_(*best)))
    return false;
  if (fits_.Late(kPruned)) return false;
  const Candidate freed = fits_.Evaluate(without, true, best, 6, best);
  const bool rival =
      (small_gain || !effects::InferenceOf(effect.id).for_many_bodies) && freed.fit.chi2 <= best->fit.chi2;
  if (!freed.fit.ok || (!rival && freed.score < best->score + needed_(*best, freed))) return false;
  const Candidate both = fits_.Evaluate(Refreshed(*best), true, &freed, 6, best);
  if (both.score > freed.score + needed_(freed, both)) return false;
  Replace(freed, best);
  return true;
}

// Gains that are off on most joints are equivalent to masses that are all off, apart from friction and
// rotors, which are free too. Masses are the likelier: they replace the gains where they leave no more.
void Simplifier::GainsYieldToInertials(Candidate* best) {
  const std::string& gain = LawOf(Regressor::kEffort).id;
  const TrialSpecs specs = WithoutKind(Refreshed(*best), gain);
  const size_t gains = best->specs.size() - specs.size();
  const bool of_most = gains >= kManyGains && 2 * gains > static_cast<size_t>(best->plant->num_joints());
  if (!of_most || best->base || fits_.Late(kPruned) || HasKind(setting_.nominal.effects(), gain)) return;
  const Candidate bodies = fits_.KnownOrFitted(specs, true, best, 12);
  const double more = 0.5 * (bodies.fit.chi2 - best->fit.chi2) / fits_.noise_scale();
  if (bodies.fit.ok && more < 1) Replace(bodies, best);
}

// By a model that is preferred though it may score less; the old one's score is lowered so that it does not
// win again.
void Simplifier::Replace(const Candidate& by, Candidate* best) {
  double& known = fits_.tried()[KeyOf(best->specs, best->base)].score;
  known = std::min(known, by.score);
  *best = by;
}

// The plain law that a richer one contains: Coulomb friction, of play the spring of its faces, of a drive's
// spring the rotor behind it.
TrialSpecs Simplifier::PlainForm(const Candidate& c, const std::string& id) const {
  TrialSpecs specs = Refreshed(c);
  if (id == effects::Spring().id) return WithoutSprings(specs);
  if (id != effects::Play().id) return Exchanges(specs, id, setting_.nominal, setting_.scales).front();
  for (EffectSpec& s : specs) {
    if (s.id == id) s = OtherTransmission(s, setting_.nominal, setting_.scales).front().front();
  }
  return specs;
}

// Richer laws that do not exceed plain ones by the acceptance rule are replaced by these: a kind on all its
// joints, but of a spring on a joint, which a constant force may explain as well, each.
void Simplifier::UsePlainLaws(Candidate* best) {
  std::vector<std::string> richer = RicherFrictions();
  richer.insert(richer.end(), {effects::Play().id, effects::Spring().id});
  for (const std::string& id : richer) UsePlainLaw(id, PlainForm(*best, id), best);
  const std::string& spring = LawOf(Regressor::kPosition).id;
  for (const std::string& joint : setting_.nominal.joint_names()) {
    if (!Contains(best->specs, spring, joint)) continue;
    UsePlainLaw(spring, WithConstantForce(Refreshed(*best), joint, setting_.nominal, setting_.scales), best);
  }
}

void Simplifier::UsePlainLaw(const std::string& richer, const TrialSpecs& specs, Candidate* best) {
  if (KeyOf(specs) == KeyOf(best->specs) || fits_.Late(kPruned)) return;
  const Candidate* known = fits_.Known(specs, best->base);
  // A special case cannot score much better than the richer law: if it does, the richer fit was lost.
  const bool done = known != nullptr && known->score >= best->score;
  Candidate plain = done ? *known : fits_.Evaluate(specs, best->base, best, 6, best);
  if (!done && known != nullptr) {
    // The plain law's first fit may have ended early, and the richer one started there.
    const Candidate before = *known;
    const Candidate longer = fits_.Evaluate(Refreshed(before), before.base, &before, 12, best);
    for (const Candidate& c : {before, longer}) {
      if (c.score > plain.score) plain = c;
    }
  }
  // A spring is another effect than a rotor, not a richer form: a better score is enough.
  const double needed = richer == effects::Spring().id ? 1.0 : needed_(plain, *best);
  if (best->score >= plain.score + needed) return;
  // The richer form is charged with the same when rivals are compared.
  Candidate& form = fits_.tried()[KeyOf(best->specs, best->base)];
  form.score -= needed, form.form += needed;
  *best = plain;
}

// A rotor on the first joint equals the first body's inertia about its axis: beside another effect a wrong
// inertia is likelier, and is reported where it leaves no more.
void Simplifier::FirstRotorAsInertia(Candidate* best) {
  TrialSpecs specs = Refreshed(*best);
  const auto rotor = [](const EffectSpec& s) { return s.id == LawOf(Regressor::kAcceleration).id; };
  const bool alone = std::ranges::count_if(specs, rotor) == 1;
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

// Coulomb friction and a constant force on the same joints are one law, friction by direction. So are Coulomb
// friction and a tilted base on a rail; on other joints the score tells these two apart.
void Simplifier::MergeByDirection(Candidate* best) {
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
  const bool everywhere =
      std::ranges::all_of(offset, [&](const auto& o) { return level.count(o.first) > 0; }) &&
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
  // The tilt's force is not known here: that fit starts at the recorded motion.
  const Candidate c = fits_.Evaluate(merged, best->base, tilted ? nullptr : best, kMergeIterations, best);
  if (c.fit.ok && c.score > best->score) *best = c;
}

// The other way round: friction by direction that differs by direction on some of several joints only is
// Coulomb friction on all and a constant force on these. The law is the same in fewer numbers, so structure
// priors do not count.
void Simplifier::SplitByDirection(Candidate* best) {
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
  const auto kept = std::ranges::count_if(c.specs, [&](const EffectSpec& s) { return s.id == zero; });
  const auto evidence = [](const Candidate& of) { return of.score + StructurePrior(of.specs, of.base); };
  if (static_cast<size_t>(kept) < several && evidence(c) > evidence(*best)) Replace(c, best);
}

// One richer law on several joints costs less prior than two kinds, and may imitate a plain law on some of
// them: each joint is tried with a plain law of its own, and all but each together, of which each alone may
// be worth too little. It needs 7 nats (kEffectPrior + kSeparable) where structure priors are not counted: of
// a joint that tells little the law is taken to be that of the others.
void Simplifier::UsePlainLawsOnJoints(Candidate* best) {
  for (bool changed = true; changed && !fits_.Late();) {
    changed = false;
    const std::vector<TrialSpecs> others =
        PlainOnSomeJoints(Refreshed(*best), setting_.nominal, setting_.scales);
    std::vector<TrialSpecs> fresh = others;
    std::erase_if(fresh, [&](const TrialSpecs& o) { return fits_.Known(o, best->base) != nullptr; });
    Candidate tried = *best, likeliest = *best;
    fits_.TryInPlace(fresh, &tried);
    const auto consider = [&](const Candidate& c) {
      const bool apart = c.fit.ok && KeyOf(c.specs) != KeyOf(best->specs) &&
                         EvidenceAlone(c) > EvidenceAlone(*best) + kEffectPrior + kSeparable;
      if (apart && FitScore(c) > FitScore(likeliest)) likeliest = c, changed = true;
    };
    consider(tried);
    for (const TrialSpecs& o : others) {
      if (const Candidate* known = fits_.Known(o, best->base)) consider(*known);
    }
    *best = likeliest;
  }
}

// The other way round: drives of an arm are alike, and plain friction on few joints beside a richer form on
// most is what the richer form had been refused for while something else was missing. Friction by direction
// has no direction that axes of different joints share.
void Simplifier::UseLawOfMostJoints(Candidate* best) {
  for (const std::string& id : RicherFrictions()) {
    if (!best->fit.ok || fits_.Late() || id == LawOf(Regressor::kForwards).id) continue;
    const TrialSpecs specs = AsOnMostJoints(Refreshed(*best), id, setting_.nominal);
    if (KeyOf(specs) == KeyOf(best->specs)) continue;
    const Candidate alike = fits_.KnownOrFitted(specs, best->base, best, kMergeIterations);
    if (alike.fit.ok && EvidenceAlone(alike) > EvidenceAlone(*best) - kEffectPrior - kSeparable)
      Replace(alike, best);
  }
}

}  // namespace rg::diagnosis
