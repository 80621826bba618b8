// Figures of a diagnosis as text, for terminal and page.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/api/result.h"

namespace rg::diagnosis {

// "explains 99.9 % of the error; 1.1 × the noise floor remains", of held-out recordings. Empty where
// nothing is to be explained.
std::string GapInWords(const DiagnosisResult& result);

// The findings' parameters of joints: a row per joint, a column per parameter with its unit, cells "0.84 ±
// 0.02", "–" where the joint has none. No column: no finding has a parameter of a joint.
struct JointTable {
  std::vector<std::string> columns;  // "coulomb [N·m]"
  std::vector<std::string> joints;
  std::vector<std::vector<std::string>> cells;  // joint × column
};
JointTable ParametersOfJoints(const DiagnosisResult& result);

}  // namespace rg::diagnosis
