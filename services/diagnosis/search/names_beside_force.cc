#include "services/diagnosis/search/names_beside_force.h"

#include <algorithm>
#include <functional>
#include <vector>

#include "services/diagnosis/hypotheses/field_starts.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/some_windows.h"
#include "services/diagnosis/search/unnamed_forces.h"

namespace rg::diagnosis {

namespace {

constexpr double kMostOfRestNamed = 0.5;  // of what any force leaves beyond noise, that names must take
// Of what fewer coefficients explain, that more must add: a law is an idealisation.
constexpr double kFormOfNames = 0.01;
constexpr double kFewLost = 0.1;         // rows, as a share, in windows that the model breaks in
constexpr size_t kScreenedWindows = 96;  // of all joints together, base parameters fixed or free
constexpr size_t kLeastWindows = 16;     // of each
constexpr int kMostFitted = 2;           // explanations
constexpr double kForceShare = 0.3;      // of the work limit, whatever was used before

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

bool NamesBesideForce::Run(Candidate* best) {
  const bool unnamed = std::ranges::any_of(Beyond(setting_.nominal, best->specs),
                                           [](const EffectSpec& e) { return IsUnnamed(e.id); });
  const bool unexplained = unnamed || state_.FoundNothing(*best);
  const double consistent = unnamed ? kExplained : kConsistent;
  if (setting_.data.n < 2 || state_.ordinary || !unexplained || fits_.PerRow(*best) < consistent)
    return false;
  state_.Tell("beside a force", 0.955, KeyOf(best->specs));
  fits_.Grant(kForceShare);
  int fits = 0;
  for (const Explanation& e : Explanations()) {
    // The force may be all that is missing, or more than it and two names be.
    if (e.names.empty() || e.left > kConsistent || fits_.Late() || ++fits > kMostFitted) return false;
    const auto fitted = Fitted(e, *best);
    if (!fitted) continue;
    *best = *fitted;
    return true;
  }
  return false;
}

std::vector<NamesBesideForce::Explanation> NamesBesideForce::Explanations() {
  std::vector<Explanation> out;
  const auto n = static_cast<size_t>(setting_.data.n);
  const size_t count = setting_.data.WindowsFor(std::max(kLeastWindows, kScreenedWindows / n));
  std::vector<Candidate> models;
  for (const bool base : {false, true}) {
    const Candidate* known = fits_.Known(state_.given, base);
    if (known != nullptr && known->fit.ok) models.push_back(*known);
  }
  if (models.empty()) return out;
  const auto places = SomeWindows(models.back().fit.window_chi2, setting_.data.windows.size(), count);
  const FitData some = setting_.data.OnWindows(places);
  for (const Candidate& without : models) {
    for (int joint = 0; joint < setting_.data.n && !fits_.Late(); ++joint) {
      if (!setting_.nominal.IsPrescribed(joint) && !setting_.scales.still[joint])
        AddOn(joint, without, some, places, &out);
    }
  }
  std::ranges::stable_sort(out, std::greater{}, &Explanation::evidence);
  return out;
}

// Of a joint on which any force may act the recordings say nothing else.
bool NamesBesideForce::MayBe(const Scored& h, int joint) const {
  return !IsUnnamed(h.effect) && std::ranges::none_of(h.joints, [&](int j) {
    return j == joint || setting_.scales.still[j] ||
           Contains(state_.given, h.effect, setting_.nominal.joint_names()[j]);
  }) && !(h.joints.empty() && Contains(state_.given, h.effect, ""));
}

void NamesBesideForce::AddOn(int joint, const Candidate& without, const FitData& some,
                             const std::vector<uint32_t>& places, std::vector<Explanation>* out) {
  const FreeForce force{{joint}, setting_.scales.torque};
  const ScreenResult screened = step_.ScreenBesideForce(without, force, some, places);
  const double rows = screened.rows;
  if (rows < (1 - kFewLost) * some.Rows()) return;
  const double evidence = screened.evidence - StructurePrior({}, without.base);
  out->push_back({joint, without, {}, evidence / rows, screened.chi2 / rows});
  state_.trace.Stage("beside any force on joint " + std::to_string(joint + 1),
                     "nothing " + std::to_string(out->back().evidence) + " per row, left " +
                         std::to_string(out->back().left));
  const auto names = BestNames(screened, [&](const Scored& h) { return MayBe(h, joint); });
  if (!names) return;
  Candidate named = without;
  for (const Scored& h : names->effects) {
    const auto starts = SpecsFor(h, setting_.nominal, setting_.scales);
    if (starts.empty()) return;
    named.specs = Joined(named.specs, starts.front());
  }
  const double needed = std::max({screened.null_gain, state_.Threshold(without, named),
                                  kMostOfRestNamed * 0.5 * (screened.chi2 - rows)});
  if (names->gain < needed) return;
  out->push_back({joint, without, named.specs, (evidence + names->gain) / rows,
                  (screened.chi2 - 2 * names->gain) / rows});
  state_.trace.Stage("beside any force on joint " + std::to_string(joint + 1),
                     KeyOf(named.specs, without.base) + std::to_string(out->back().evidence) +
                         " per row, left " + std::to_string(out->back().left));
}

std::optional<Candidate> NamesBesideForce::Fitted(const Explanation& e, const Candidate& before) {
  const auto plant = sim::Plant::Create(setting_.nominal.shared_model(), setting_.nominal.options(), e.names);
  if (!plant.ok()) return std::nullopt;
  Candidate from = e.without;
  from.plant = std::make_shared<const sim::Plant>(*plant);
  from.fit.values = plant->ValuesFrom(e.without.plant->parameters(), e.without.fit.values);
  const MissingForce force = state_.Force(from);
  std::optional<Candidate> best;
  double least = effects::kInf, least_admissible = effects::kInf;  // χ²
  const auto offer = [&](const Candidate& c) {
    if (!(c.fit.chi2 > 0)) return;
    least = std::min(least, c.fit.chi2);
    if (!c.fit.ok) return;
    least_admissible = std::min(least_admissible, c.fit.chi2);
    if (!best || c.score > best->score) best = c;
  };
  for (const std::string& variable : kAny) {
    if (const auto field = UnnamedStart(setting_, force, variable, e.joint))
      offer(fits_.KnownOrFitted(Joined(e.names, {*field}), e.without.base));
  }
  const std::string& joint = setting_.nominal.joint_names()[e.joint];
  const bool there = std::ranges::any_of(
      before.specs, [&](const EffectSpec& s) { return IsUnnamed(s.id) && s.joints.back() == joint; });
  if (there) offer(fits_.KnownOrFitted(Joined(Refreshed(before), e.names), before.base, &before));
  if (!best || least_admissible > least) return std::nullopt;
  for (size_t i = 0; i < best->specs.size(); ++i) {
    const bool given = IsPart({best->specs[i]}, state_.given) || IsUnnamed(best->specs[i].id);
    if (!given && Strength(*best, i) < kAbsent) return std::nullopt;
  }
  return best;
}

}  // namespace rg::diagnosis
