#include "services/diagnosis/search/simplifier.h"

#include <algorithm>
#include <cmath>

#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

using effects::EffectSpec, effects::LawOf, effects::Regressor;

namespace {

constexpr double kPruned = 2.0;       // of the work limit, after which nothing is removed
constexpr double kSmallShare = 0.01;  // of what all effects explain
constexpr size_t kManyGains = 3;      // joints, from which on gains are rather errors of masses
constexpr double kSmallGain = 0.01;   // of one: no URDF knows a mass better

// Whether it scales efforts by no more than the error of any URDF's masses.
bool IsSmallGain(const EffectSpec& s) {
  if (!effects::ScalesEffort(s.id)) return false;
  return std::ranges::all_of(s.joints, [&](const std::string& joint) {
    return std::abs(s.values.at(joint).at("gain") - 1) < kSmallGain;
  });
}

}  // namespace

void Simplifier::Run(Candidate* best) {
  GainsYieldToInertials(best);
  Prune(best);
  UsePlainLaws(best);
  FirstRotorAsInertia(best);
}

void Simplifier::DropAbsent(Candidate* best) {
  const std::vector<EffectSpec> strong = StrongEffects(*best);
  if (strong.empty() || strong.size() == best->specs.size() || fits_.Late(kPruned)) return;
  const Candidate c = fits_.Evaluate(strong, best->base, best);
  if (best->score < c.score + state_.Threshold(c, *best)) *best = c;
}

void Simplifier::Prune(Candidate* best) {
  DropAbsent(best);
  bool changed = true;
  while (changed && best->specs.size() > 1 && !fits_.Late(kPruned)) {
    changed = false;
    for (size_t i = 0; i < best->specs.size() && !changed; ++i) {
      // An unnamed force follows whatever was missing when it was found, and so does what free base
      // parameters imitate: these are always tested.
      const std::string& id = best->specs[i].id;
      const bool imitated = best->base && effects::InferenceOf(id).for_many_bodies && !OfAllJoints(*best, i);
      const bool sure = !IsUnnamed(id) && !imitated && ClearlyNonzero(*best, i, state_.Threshold(*best));
      std::vector<EffectSpec> specs = Refreshed(*best);
      specs.erase(specs.begin() + static_cast<long>(i));
      if (!sure) {
        const Candidate c = fits_.Evaluate(specs, best->base, best, 4, best);
        const double worth = OfAllJoints(*best, i) ? 0.0 : state_.Threshold(c, *best);
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
      (!small_gain && 0.5 * strength * strength > kSmallShare * state_.Explained(*best)))
    return false;
  if (fits_.Late(kPruned)) return false;
  const Candidate freed = fits_.Evaluate(without, true, best, 6, best);
  const bool rival =
      (small_gain || !effects::InferenceOf(effect.id).for_many_bodies) && freed.fit.chi2 <= best->fit.chi2;
  if (!freed.fit.ok || (!rival && freed.score < best->score + state_.Threshold(*best, freed))) return false;
  const Candidate both = fits_.Evaluate(Refreshed(*best), true, &freed, 6, best);
  if (both.score > freed.score + state_.Threshold(freed, both)) return false;
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
  if (!IsRicherFriction(id) && HasKind(state_.given, id)) return specs;
  if (id == effects::Spring().id) return WithoutSprings(specs);
  if (id != effects::Play().id) {
    const auto others = Exchanges(specs, id, state_.given, setting_.nominal, setting_.scales);
    return others.empty() ? specs : others.front();
  }
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
  for (const std::string& id : richer) {
    if (HasKind(best->specs, id)) UsePlainLaw(id, PlainForm(*best, id), best);
  }
  const std::string& spring = LawOf(Regressor::kPosition).id;
  for (const std::string& joint : setting_.nominal.joint_names()) {
    if (!Contains(best->specs, spring, joint) || Contains(state_.given, spring, joint)) continue;
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
  // A spring is another effect than a rotor, not a richer form.
  const double needed = richer == effects::Spring().id ? kExchange : state_.Threshold(plain, *best);
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

}  // namespace rg::diagnosis
