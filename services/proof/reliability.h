// How sure findings were said to be and how often they held, over several examinations (or batteries), in a
// mixture of which ordinary robots and their controls are half; and whether what is said would be better
// taken from how the findings of the *other* examinations fared (leave one out).
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "services/proof/examination.h"

namespace rg::proof {

struct Examined {
  std::string name;
  std::vector<CaseMarks> cases;
};

// Findings of one kind ("name", "unnamed", "parameters") that were said at one confidence, to a hundredth.
struct ReliabilityLevel {
  std::string kind;
  double said = 0;
  Share right;           // of all of them, each as one
  double mixed = 0;      // share right in the mixture
  int examinations = 0;  // that have any
};

struct ReliabilityBin {
  double low = 0, high = 1, mean_said = 0;  // mean: in the mixture
  Share right;
  double mixed = 0;
};

// Of one way to say a confidence, in the mixture: Σ w·|said − right| over bins, and Σ w·(said − right)² over
// findings.
struct ReliabilityScore {
  double calibration_error = 0, brier = 0;
};

struct Reliability {
  int findings = 0;
  std::vector<ReliabilityLevel> levels;  // by kind, surest first
  std::vector<ReliabilityBin> bins;      // fifths
  ReliabilityScore as_said;
  // Each finding at what its level had been right in the other examinations, drawn to what was said by as
  // much as two findings weigh.
  ReliabilityScore left_out;
};

Reliability ReliabilityOf(const std::vector<Examined>& examinations);

nlohmann::json ToJson(const Reliability& reliability);
// The reliability diagram: share right with its 95 % interval over what was said, a point per level of five
// findings or more.
std::string ReliabilitySvg(const Reliability& reliability);

}  // namespace rg::proof
