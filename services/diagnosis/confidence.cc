#include "services/diagnosis/confidence.h"

#include <algorithm>

namespace rg::diagnosis {
namespace {

// Shares that were right on the sets of seeds 59004 to 59008, each by the diagnosis of its day, or of a later
// seed where it says so (docs/proof.md).
constexpr double kAlone = 0.96;    // one name, nothing left: 324 of 332, rounded down
constexpr double kTwo = 0.80;      // two names, nothing left: 92 of 115
constexpr double kMany = 0.42;     // three or more, one thing taken for several: 10 of 24
constexpr double kMeasured = 0.9;  // several names on a robot whose effort is measured
// A rival that the data cannot tell from it: one of two, though 27 of 35 were right, for labels call some of
// them equivalent.
constexpr double kRival = 0.5;
constexpr double kBeside = 0.17;           // a name beside what has none: 1 of 6
constexpr double kUnknown = 0.8;           // something without a name: 49 of 61, seeds 59009 to 59011
constexpr double kParameters = 0.95;       // parameters alone: 88 of 92
constexpr double kParametersBeside = 0.9;  // beside a name: 87 of 97

bool IsName(const Finding& f) { return f.effect != "parameters_only" && f.effect != "unknown_field"; }

double HitRate(const Finding& f, const std::string& verdict, bool measured, int names, bool alone) {
  if (f.effect == "parameters_only") return alone ? kParameters : kParametersBeside;
  if (f.effect == "unknown_field") return kUnknown;
  if (verdict == "unexplained" && !measured) return kBeside;
  const double rate = names <= 1 ? kAlone : measured ? kMeasured : names == 2 ? kTwo : kMany;
  const bool rival = std::any_of(f.alternatives.begin(), f.alternatives.end(),
                                 [](const Alternative& a) { return !a.separable; });
  return rival ? std::min(rate, kRival) : rate;
}

}  // namespace

void Calibrate(const std::string& verdict, bool measured, std::vector<Finding>* findings) {
  const auto names = static_cast<int>(std::count_if(findings->begin(), findings->end(), IsName));
  const bool alone = findings->size() == 1;
  for (Finding& f : *findings)
    f.confidence = std::min(f.confidence, HitRate(f, verdict, measured, names, alone));
  const auto side = [&](const Finding& f) { return f.effect == "parameters_only" && findings->size() > 1; };
  std::stable_sort(findings->begin(), findings->end(), [&](const Finding& a, const Finding& b) {
    return side(a) != side(b) ? side(b) : a.confidence > b.confidence;
  });
  for (size_t i = 1; i < findings->size(); ++i) {
    if (side((*findings)[i]))
      (*findings)[i].confidence = std::min((*findings)[i].confidence, (*findings)[i - 1].confidence);
  }
}

}  // namespace rg::diagnosis
