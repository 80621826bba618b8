#include "services/diagnosis/search/unnamed_forces.h"

#include <algorithm>
#include <set>

#include "services/diagnosis/hypotheses/field_starts.h"
#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr double kRest = 0.1;  // share of the unnamed force's excess χ² that added effects may leave
constexpr double kHalf = 0.5;  // share of the excess χ² without an effect that may be left with it
constexpr int kMostNames = 2;  // effects added, one after another

}  // namespace

void UnnamedForces::Try(bool freed, const std::vector<std::string>& variables,
                        const std::function<bool(const Candidate&)>& enough) {
  for (const bool base : {false, true}) {
    const Candidate* from = fits_.Known(given_, base);
    if ((base && !freed) || from == nullptr || !from->fit.ok) continue;
    const MissingForce force = force_(*from);
    for (const std::string& variable : variables) {
      const auto spec = UnnamedStart(setting_, force, variable);
      if (!spec) continue;
      if (enough(fits_.KnownOrFitted(Joined(given_, {*spec}), base))) return;
    }
  }
}

const Candidate* UnnamedForces::Best() const {
  const Candidate* best = nullptr;
  Candidate bare;
  bare.specs = given_;
  for (const auto& [key, c] : fits_.tried()) {
    const std::set<std::string> fresh = FreshKinds(bare, c);
    if (!c.fit.ok || fresh.size() != 1 || !IsUnnamed(*fresh.begin())) continue;
    if (best == nullptr || c.score > best->score) best = &c;
  }
  return best;
}

Candidate UnnamedForces::WithNames(const Candidate& unnamed) {
  Candidate named = unnamed;
  for (int more = 0; more < kMostNames && fits_.PerRow(named) > kExplained && !fits_.Late(); ++more) {
    Candidate next = named;
    try_additions_(named, &next);
    if (next.score <= named.score + needed_(named, next)) break;
    named = next;
  }
  if (!(fits_.Excess(named) < kRest * fits_.Excess(unnamed))) return unnamed;
  named = WithoutCoarse(std::move(named));
  // The unnamed force had followed what the added effects explain, and may not be needed now.
  std::vector<EffectSpec> names = Refreshed(named);
  std::erase_if(names, [&](const EffectSpec& e) {
    return IsUnnamed(e.id) && !Contains(given_, e.id, e.joints.empty() ? "" : e.joints[0]);
  });
  if (names.size() == named.specs.size() || names.size() <= given_.size()) return named;
  const Candidate alone = fits_.Evaluate(names, named.base, &named);
  return alone.fit.ok && named.score <= alone.score + needed_(alone, named) ? alone : named;
}

Candidate UnnamedForces::WithoutCoarse(Candidate model) {
  Candidate bare;
  bare.specs = given_;
  for (const std::string& kind : FreshKinds(bare, model)) {
    if (IsUnnamed(kind)) continue;
    const std::vector<EffectSpec> specs = WithoutKind(Refreshed(model), kind);
    const Candidate without = fits_.KnownOrFitted(specs, model.base, &model);
    if (without.fit.ok && fits_.Excess(model) >= kHalf * fits_.Excess(without)) model = without;
  }
  return model;
}

}  // namespace rg::diagnosis
