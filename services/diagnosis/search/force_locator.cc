#include "services/diagnosis/search/force_locator.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "services/diagnosis/hypotheses/field_starts.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/some_windows.h"

namespace rg::diagnosis {

namespace {

constexpr double kMostOfRestNamed = 0.5;  // of what any force leaves beyond noise, that names must take
// Of what fewer coefficients explain, that more must add: a law is an idealisation.
constexpr double kFormOfNames = 0.01;
constexpr double kLittle = 0.1;      // of χ² per row above noise, that a force in its place leaves at most
constexpr double kStandsOut = 0.2;   // of what a force on any other joint leaves
constexpr double kTooFar = 10.0;     // times the noise, above which nothing is told
constexpr double kLeastNoise = 0.2;  // of the rows
constexpr double kFewLost = 0.1;     // rows, as a share, in windows that the model breaks in
constexpr size_t kScreenedWindows = 24;
constexpr int kMostFitted = 2;       // explanations, or joints
constexpr double kForceShare = 0.3;  // of the work limit, whatever was used before

// Effects of one model.
struct Names {
  std::vector<Scored> effects;
  size_t coefficients = 0;
  double gain = 0;  // of log evidence, structure prior included
};

double PriorOf(const Scored& h) {
  return StructurePrior(std::vector<EffectSpec>(std::max<size_t>(1, h.joints.size()), EffectSpec{h.effect}),
                        false);
}

// The best of a screen's hypotheses, sets and pairs: more coefficients must add a share of what fewer
// explain.
std::optional<Names> BestNames(const ScreenResult& screened,
                               const std::function<bool(const Scored&)>& may_be) {
  std::vector<Names> all;
  const auto add = [&](const std::vector<Scored>& effects, double gain) {
    if (!std::ranges::all_of(effects, may_be)) return;
    all.push_back({effects, 0, gain});
    for (const Scored& h : effects) all.back().coefficients += h.coefficients.size();
  };
  for (const Scored& h : screened.hypotheses) add({h}, h.gain - PriorOf(h));
  for (const auto* list : {&screened.sets, &screened.pairs}) {
    for (const Combination& c : *list) add(c.parts, c.gain);
  }
  std::ranges::stable_sort(all, {}, &Names::coefficients);
  std::optional<Names> best;
  for (const Names& n : all) {
    const bool more = best && n.coefficients > best->coefficients;
    const double needed = more ? std::max(screened.null_gain, kFormOfNames * best->gain) : 0.0;
    if (!best || n.gain > best->gain + std::max(0.0, needed)) best = n;
  }
  return best;
}

}  // namespace

bool ForceLocator::NameBeside(Candidate* best) {
  if (!named_in_place_.empty() && named_in_place_ == KeyOf(best->specs, best->base)) return true;
  const bool unnamed = state_.HasNewForce(*best);
  const bool unexplained = unnamed || state_.FoundNothing(*best);
  const double consistent = unnamed ? kExplained : kConsistent;
  if (setting_.data.n < 2 || state_.ordinary || !unexplained || fits_.PerRow(*best) < consistent)
    return false;
  state_.Tell("beside a force", 0.955, KeyOf(best->specs));
  fits_.Grant(kForceShare);
  int fits = 0;
  for (const Explanation& e : Explanations(ModelsWithout(nullptr))) {
    // The force may be all that is missing, or more than it and two names be.
    if (e.beside.empty() || (e.left > kConsistent && !StandsOut(e)) || fits_.Late() || ++fits > kMostFitted)
      return false;
    const auto fitted = Fitted(e, *best);
    if (!fitted) continue;
    *best = *fitted;
    return true;
  }
  return false;
}

bool ForceLocator::Suffices(const Explanation& e) const {
  const double excess = fits_.PerRow(e.without) - 1;
  const double little = std::max(kFormOfNames * excess, std::min(kLittle * excess, kExplained - 1));
  return e.left < std::min(1 + little, kConsistent) || StandsOut(e);
}

// Where much is missing the linearisation is not exact: what it leaves is compared.
bool ForceLocator::StandsOut(const Explanation& e) const {
  return std::isfinite(e.elsewhere) && e.left < kTooFar && e.left - 1 < kStandsOut * (e.elsewhere - 1);
}

std::set<int> ForceLocator::Where(const Candidate& around) {
  std::set<int> out, all, anyhow;  // anyhow: on which a force needs nothing on others
  for (const Explanation& e : Explanations(ModelsWithout(&around))) {
    all.insert(e.joint);
    if (!Suffices(e)) continue;
    out.insert(e.joint);
    if (std::ranges::all_of(e.beside, [](const Scored& h) { return h.joints.empty(); }))
      anyhow.insert(e.joint);
  }
  // Where a force on any joint would do, the recordings do not tell the place.
  return anyhow == all ? std::set<int>{} : out;
}

bool ForceLocator::Explain(const Candidate& around, Candidate* winner) {
  const std::set<int> joints = Where(around);
  std::set<int> asked;
  std::optional<Explanation> first;
  Candidate unnamed = around;
  for (const Explanation& e : Explanations(ModelsWithout(&around))) {
    if (joints.count(e.joint) == 0 || !Suffices(e) || asked.size() == kMostFitted || fits_.Late()) continue;
    if (!asked.insert(e.joint).second) continue;
    const Candidate found = OnThatJoint(e);
    if (Replaces(around, found) && !state_.HasNewForce(found) && fits_.PerRow(found) < kConsistent) {
      *winner = Better(*winner, found);
      return true;
    }
    if (first || state_.ordinary) continue;
    // A law that leaves far more than any force does is another one's likeness.
    first = e;
    if (const auto fitted = Fitted(e, around)) unnamed = *fitted;
    if (state_.HasNewForce(found)) unnamed = Better(unnamed, found);
    if (fits_.PerRow(unnamed) < kExplained) break;
  }
  if (!Replaces(around, unnamed) || unnamed.score < winner->score) return false;
  *winner = unnamed, state_.place = first->joint;
  if (!first->beside.empty()) named_in_place_ = KeyOf(unnamed.specs, unnamed.base);
  return true;
}

bool ForceLocator::ExplainByName(const Candidate& around, Candidate* winner) {
  std::vector<Candidate> models = ModelsWithout(&around);
  if (models.size() > 1) models.resize(1);  // base parameters as given
  const std::vector<Explanation> all = Explanations(models);
  const auto alone = std::ranges::find_if(all, [](const Explanation& e) { return e.beside.empty(); });
  // Where a force elsewhere would do too, the recordings do not tell the joint.
  if (alone == all.end() || !std::isfinite(alone->elsewhere) || alone->elsewhere < kConsistent ||
      !(alone->left - 1 < kPartly * (alone->elsewhere - 1)))
    return false;
  const Candidate found = OnThatJoint(*alone);
  // A law that is nearly its own, as play with faces that a fit is slow to harden, leaves a little.
  const double little = std::max(kFormOfNames * (fits_.PerRow(alone->without) - 1), kExplained - 1);
  if (!Replaces(around, found) || state_.HasNewForce(found) ||
      !(fits_.PerRow(found) < std::min(1 + little, kConsistent)))
    return false;
  *winner = Better(*winner, found);
  return true;
}

// The best of what acts on the joint of the missing force, beside the names; a second effect there where one
// law takes most and leaves more than noise.
Candidate ForceLocator::OnThatJoint(const Explanation& e) {
  Candidate found = e.without;
  step_.AddOnJoint(e.without, e.joint, e.names, &found);
  const auto likeness = [&] {
    return fits_.PerRow(found) > kConsistent && !state_.HasNewForce(found) &&
           KeyOf(found.specs) != KeyOf(e.without.specs) && !fits_.Late();
  };
  if (likeness()) found = Better(found, fits_.Anew(found));  // it may be a local optimum
  if (likeness() && fits_.Excess(found) < kLittle * fits_.Excess(e.without)) {
    const Candidate one = found;
    step_.AddOnJoint(one, e.joint, Refreshed(one), &found);
  }
  return found;
}

bool ForceLocator::Replaces(const Candidate& around, const Candidate& c) const {
  return KeyOf(c.specs) != KeyOf(around.specs) && c.score > around.score + state_.Threshold(around);
}

// Base parameters of an ordinary robot are as its drives left them.
std::vector<Candidate> ForceLocator::ModelsWithout(const Candidate* around) const {
  if (around != nullptr && !state_.FoundNothing(*around)) return {*around};
  std::vector<Candidate> out;
  for (const bool base : {false, true}) {
    const Candidate* known = fits_.Known(state_.given, base);
    if (known != nullptr && known->fit.ok) out.push_back(*known);
  }
  return out;
}

std::vector<ForceLocator::Explanation> ForceLocator::Explanations(const std::vector<Candidate>& models) {
  std::vector<Explanation> out;
  if (models.empty()) return out;
  const auto places = SomeWindows(models.front().fit.window_chi2, setting_.data.windows.size(),
                                  setting_.data.WindowsFor(kScreenedWindows));
  const FitData some = setting_.data.OnWindows(places);
  FreeForce force{{}, setting_.scales.torque};
  for (int joint = 0; joint < setting_.data.n; ++joint) {
    if (!setting_.nominal.IsPrescribed(joint) && !setting_.scales.still[joint]) force.joints.push_back(joint);
  }
  if (force.joints.empty()) return out;
  for (const Candidate& without : models) {
    const std::string key = KeyOfFit(without) + ' ' + std::to_string(fits_.noise_scale());
    auto known = screens_.find(key);
    if (known == screens_.end()) {
      if (fits_.Late()) return {};  // some models alone are no comparison
      known = screens_.emplace(key, step_.ScreensBesideForce(without, force, some, places)).first;
    }
    for (size_t i = 0; i < known->second.size(); ++i) {
      const ScreenResult& screened = known->second[i];
      const bool lost = screened.rows < (1 - kFewLost) * some.Rows();
      if (!lost) AddOn(force.joints[i], without, screened, places.size(), &out);
    }
  }
  std::ranges::stable_sort(out, std::greater{}, &Explanation::evidence);
  for (Explanation& e : out) {
    for (const Explanation& other : out) {
      if (other.joint != e.joint) e.elsewhere = std::min(e.elsewhere, other.left);
    }
  }
  return out;
}

// Of a joint on which any force may act the recordings say nothing else.
bool ForceLocator::MayBe(const Scored& h, int joint, const TrialSpecs& without) const {
  return !IsUnnamed(h.effect) && std::ranges::none_of(h.joints, [&](int j) {
    return j == joint || setting_.scales.still[j] ||
           Contains(without, h.effect, setting_.nominal.joint_names()[j]);
  }) && !(h.joints.empty() && Contains(without, h.effect, ""));
}

void ForceLocator::AddOn(int joint, const Candidate& without, const ScreenResult& screened, size_t windows,
                         std::vector<Explanation>* out) {
  const double rows = screened.rows, share = rows / setting_.data.Rows();
  // What noise alone leaves of χ²: the force and the windows' starts take some of it in.
  const double noise = std::max(kLeastNoise * rows, rows - screened.unknowns - fits_.Starts(windows));
  const double evidence = screened.evidence - StructurePrior({}, without.base);
  out->push_back({joint, without, Refreshed(without), {}, evidence / rows, screened.chi2 / noise});
  const auto tell = [&](const std::string& names) {
    const Explanation& e = out->back();
    state_.trace.Stage("beside any force on joint " + std::to_string(joint + 1),
                       names + std::to_string(e.evidence) + " per row, left " + std::to_string(e.left));
  };
  tell("nothing ");
  const auto names = BestNames(screened, [&](const Scored& h) { return MayBe(h, joint, without.specs); });
  if (!names) return;
  Candidate named = without;
  named.specs = Refreshed(without);
  for (const Scored& h : names->effects) {
    const auto starts = SpecsFor(h, setting_.nominal, setting_.scales);
    if (starts.empty()) return;
    named.specs = Joined(named.specs, starts.front());
  }
  const double needed = std::max({screened.null_gain, share * state_.Threshold(without, named),
                                  kMostOfRestNamed * 0.5 * (screened.chi2 - noise)});
  if (names->gain < needed) return;
  out->push_back({joint, without, named.specs, names->effects, (evidence + names->gain) / rows,
                  (screened.chi2 - 2 * names->gain) / noise});
  tell(KeyOf(named.specs, without.base));
}

std::optional<Candidate> ForceLocator::Fitted(const Explanation& e, const Candidate& before) {
  const auto plant = sim::Plant::Create(setting_.nominal.shared_model(), setting_.nominal.options(), e.names);
  if (!plant.ok()) return std::nullopt;
  Candidate from = e.without;
  from.plant = std::make_shared<const sim::Plant>(*plant);
  from.fit.values = plant->ValuesFrom(e.without.plant->parameters(), e.without.fit.values);
  const MissingForce force = state_.EstimatedForce(from);
  std::optional<Candidate> best;
  double least = effects::kInf, least_admissible = effects::kInf;  // χ²
  const auto offer = [&](const Candidate& c) {
    if (!(c.fit.chi2 > 0)) return;
    least = std::min(least, c.fit.chi2);
    if (!c.fit.ok) return;
    least_admissible = std::min(least_admissible, c.fit.chi2);
    if (!best || c.score > best->score) best = c;
  };
  for (const std::string& variable : kFieldVariables) {
    if (const auto field = UnnamedStart(setting_, force, variable, e.joint))
      offer(fits_.KnownOrFitted(Joined(e.names, {*field}), e.without.base));
  }
  const std::string& joint = setting_.nominal.joint_names()[e.joint];
  const bool there = std::ranges::any_of(
      before.specs, [&](const EffectSpec& s) { return IsUnnamed(s.id) && s.joints.back() == joint; });
  if (there) offer(fits_.KnownOrFitted(Joined(Refreshed(before), e.names), before.base, &before));
  if (!best || least_admissible > least) return std::nullopt;
  for (size_t i = 0; i < best->specs.size(); ++i) {
    const bool given = IsPart({best->specs[i]}, e.without.specs) || IsUnnamed(best->specs[i].id);
    if (!given && Strength(*best, i) < kAbsent) return std::nullopt;
  }
  return best;
}

}  // namespace rg::diagnosis
