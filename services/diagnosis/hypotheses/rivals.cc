#include "services/diagnosis/hypotheses/rivals.h"

#include <algorithm>
#include <map>
#include <set>

namespace rg::diagnosis {

std::vector<Rival> RivalsOf(const SearchResult& search, const std::string& id) {
  const size_t kinds = FreshKinds({}, search.best).size();
  std::map<std::string, const Candidate*> best;
  for (const Candidate& c : search.tried) {
    const std::set<std::string> theirs = FreshKinds({}, c), extra = FreshKinds(search.best, c);
    // One law may replace two if it is as likely: Coulomb friction with a torque offset is friction that
    // depends on the direction.
    const bool alike =
        theirs.size() == kinds || (theirs.size() < kinds && c.score > search.best.score - kSeparable);
    if (theirs.count(id) || !alike) continue;
    if (extra.size() != 1) continue;
    auto [it, fresh] = best.try_emplace(*extra.begin(), &c);
    if (!fresh && c.score > it->second->score) it->second = &c;
  }
  std::vector<Rival> out;
  for (const auto& [effect, c] : best) out.push_back({effect, c});
  std::ranges::stable_sort(
      out, [](const Rival& a, const Rival& b) { return a.candidate->score > b.candidate->score; });
  if (out.size() > kMostRivals) out.resize(kMostRivals);
  return out;
}

}  // namespace rg::diagnosis
