#include "services/diagnosis/search/unnamed_forces.h"

#include <algorithm>
#include <optional>
#include <set>

#include "services/diagnosis/hypotheses/field_starts.h"
#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr double kRest = 0.1;  // of what a force without a name leaves, that names beside it may leave
constexpr double kHalf = 0.5;  // of what is left without a name, that may be left with it
constexpr int kMostNames = 2;  // looked for one after another

}  // namespace

void UnnamedForces::Try(bool freed, const std::vector<std::string>& variables,
                        const std::function<bool(const Candidate&)>& enough) {
  const FitData& data = setting_.data;
  for (const bool base : {false, true}) {
    const Candidate* from = fits_.Known(given_, base);
    if ((base && !freed) || from == nullptr || !from->fit.ok) continue;
    const MissingForce force = force_(*from);
    for (const std::string& variable : variables) {
      const auto spec = variable == "position" && data.n > 1
                            ? FieldPairStart(data, setting_.nominal, setting_.scales, force)
                            : FieldStart(data, setting_.nominal, setting_.scales, force, variable);
      if (!spec) continue;
      const std::vector<EffectSpec> specs = Joined(given_, {*spec});
      const Candidate* done = fits_.Known(specs, base);
      if (enough(done != nullptr ? *done : fits_.Evaluate(specs, base))) return;
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
    look_beside_(named, &next);
    if (next.score <= named.score + needed_(named, next)) break;
    named = next;
  }
  if (!(fits_.Excess(named) < kRest * fits_.Excess(unnamed))) return unnamed;
  named = WithoutCoarse(std::move(named));
  // Found before the names it followed what they explain, and may be needed no more.
  std::vector<EffectSpec> names = Refreshed(named);
  std::erase_if(names, [&](const EffectSpec& e) {
    return IsUnnamed(e.id) && !Contains(given_, e.id, e.joints.empty() ? "" : e.joints[0]);
  });
  if (names.size() == named.specs.size() || names.size() <= given_.size()) return named;
  const Candidate alone = fits_.Evaluate(names, named.base, &named);
  return alone.fit.ok && named.score <= alone.score + needed_(alone, named) ? alone : named;
}

Candidate UnnamedForces::WithoutCoarse(Candidate account) {
  Candidate bare;
  bare.specs = given_;
  for (const std::string& kind : FreshKinds(bare, account)) {
    if (IsUnnamed(kind)) continue;
    const std::vector<EffectSpec> specs = WithoutKind(Refreshed(account), kind);
    const Candidate* known = fits_.Known(specs, account.base);
    const Candidate without = known != nullptr ? *known : fits_.Evaluate(specs, account.base, &account);
    if (without.fit.ok && fits_.Excess(account) >= kHalf * fits_.Excess(without)) account = without;
  }
  return account;
}

}  // namespace rg::diagnosis
