#include "services/diagnosis/confidence.h"

#include <algorithm>

namespace rg::diagnosis {
namespace {

constexpr double kAlone = 0.95;       // one name, nothing left
constexpr double kTwo = 0.9;          // two names, nothing left
constexpr double kMany = 0.5;         // three or more: one thing taken for several
constexpr double kRival = 0.6;        // a rival that the data cannot tell from it
constexpr double kBeside = 0.2;       // a name beside what has none
constexpr double kUnknown = 0.8;      // that there is something without a name
constexpr double kParameters = 0.95;  // parameters alone

bool IsName(const Finding& f) { return f.effect != "parameters_only" && f.effect != "unknown_field"; }

double HitRate(const Finding& f, const std::string& verdict, bool measured, int names) {
  if (f.effect == "parameters_only") return kParameters;
  if (f.effect == "unknown_field") return kUnknown;
  if (verdict == "unexplained" && !measured) return kBeside;
  const double rate = names <= 1 ? kAlone : names == 2 ? kTwo : measured ? kTwo : kMany;
  const bool rival = std::any_of(f.alternatives.begin(), f.alternatives.end(),
                                 [](const Alternative& a) { return !a.separable; });
  return rival ? std::min(rate, kRival) : rate;
}

}  // namespace

void Calibrate(const std::string& verdict, bool measured, std::vector<Finding>* findings) {
  const auto names = static_cast<int>(std::count_if(findings->begin(), findings->end(), IsName));
  for (Finding& f : *findings) f.confidence = std::min(f.confidence, HitRate(f, verdict, measured, names));
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
