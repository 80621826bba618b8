#include "services/diagnosis/hypotheses/rivals.h"

#include <algorithm>
#include <iterator>
#include <map>
#include <set>

namespace rg::diagnosis {
namespace {

std::set<std::string> Ids(const std::vector<EffectSpec>& specs) {
  std::set<std::string> out;
  for (const EffectSpec& e : specs) out.insert(e.id);
  return out;
}

}  // namespace

std::vector<Rival> RivalsOf(const SearchResult& search, const std::string& id) {
  const std::set<std::string> mine = Ids(search.best.specs);
  std::map<std::string, const Candidate*> best;
  for (const Candidate& c : search.tried) {
    const std::set<std::string> theirs = Ids(c.specs);
    // One law may replace two if it is as likely: Coulomb friction with a torque offset is friction that
    // depends on the direction.
    const bool alike = theirs.size() == mine.size() ||
                       (theirs.size() < mine.size() && c.score > search.best.score - kSeparable);
    if (theirs.count(id) || !alike) continue;
    std::vector<std::string> extra;
    std::set_difference(theirs.begin(), theirs.end(), mine.begin(), mine.end(), std::back_inserter(extra));
    if (extra.size() != 1) continue;
    auto [it, fresh] = best.try_emplace(extra[0], &c);
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
