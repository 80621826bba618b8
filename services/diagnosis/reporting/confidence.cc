#include "services/diagnosis/reporting/confidence.h"

#include <algorithm>

#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {
namespace {

// Shares that were right on the sets of seeds 59004 to 59008, each by the diagnosis of its day, or of a later
// seed where it says so (docs/proof.md).
constexpr double kAlone = 0.96;  // one name, nothing left: 324 of 332, rounded down
constexpr double kTwo = 0.80;    // two names, nothing left: 92 of 115
constexpr double kMany = 0.42;   // three or more, one thing taken for several: 10 of 24
// Three or more on an ordinary robot: what its drives share (23 of 23 on seed 61001, 61 of 63 on 62001) and
// what is beside that (3 of 5 and 8 of 8), both rounded down, the latter for being few.
constexpr double kOfDrives = 0.95, kBesideDrives = 0.75;
// Several names on a robot whose effort is measured: chosen, not counted.
constexpr double kMeasured = 0.9, kRareMeasured = 0.6;
// A rival that the data cannot tell from it: one of two, though 27 of 35 were right, for labels call some of
// them equivalent.
constexpr double kRival = 0.5;
constexpr double kBeside = 0.17;           // a name beside what has none: 1 of 6
constexpr double kUnknown = 0.8;           // something without a name: 49 of 61, seeds 59009 to 59011
constexpr double kParameters = 0.95;       // parameters alone: 88 of 92
constexpr double kParametersBeside = 0.9;  // beside a name: 87 of 97

bool IsName(const Finding& f) { return f.effect != "parameters_only" && !IsUnnamed(f.effect); }

bool IsOfDrive(const Finding& f) { return IsLossOfDrives(f.effect) || IsTiming(f.effect); }

// A law that drives share, on most joints.
bool OfDrives(const Finding& f, int joints) {
  return IsOfDrive(f) && 2 * static_cast<int>(f.joints.size()) > joints;
}

// Of one of three names and more, none of them beside what has none.
double RateOfMany(const Finding& f, const std::vector<Finding>& findings, int joints) {
  const auto losses = std::count_if(findings.begin(), findings.end(), [&](const Finding& g) {
    return IsLossOfDrives(g.effect) && OfDrives(g, joints);
  });
  if (losses < 2) return kMany;
  return OfDrives(f, joints) ? kOfDrives : kBesideDrives;
}

double HitRate(const Finding& f, const std::string& verdict, bool measured, int names, bool alone,
               double many) {
  if (f.effect == "parameters_only") return alone ? kParameters : kParametersBeside;
  if (IsUnnamed(f.effect)) return kUnknown;
  if (verdict == "unexplained" && !measured) return kBeside;
  // Losses and late drives every arm has; what few have is no surer than beside other losses.
  const double of_measured = IsOfDrive(f) ? kMeasured : kRareMeasured;
  const double rate = names <= 1 ? kAlone : measured ? of_measured : names == 2 ? kTwo : many;
  const bool rival = std::any_of(f.alternatives.begin(), f.alternatives.end(),
                                 [](const Alternative& a) { return !a.separable; });
  return rival ? std::min(rate, kRival) : rate;
}

}  // namespace

void Calibrate(const std::string& verdict, bool measured, int joints, std::vector<Finding>* findings) {
  const auto names = static_cast<int>(std::count_if(findings->begin(), findings->end(), IsName));
  const bool alone = findings->size() == 1;
  for (Finding& f : *findings)
    f.confidence =
        std::min(f.confidence, HitRate(f, verdict, measured, names, alone, RateOfMany(f, *findings, joints)));
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
