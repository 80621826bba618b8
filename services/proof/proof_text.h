// The examination as text: for docs/proof.md and as a page.
#pragma once

#include <string>
#include <vector>

#include "services/proof/examination.h"

namespace rg::proof {

struct ProofRecord {
  std::string command;
  std::string seal;  // SHA-256 over all labels, printed before the first diagnosis
  std::vector<CaseMarks> cases;
};

std::string Markdown(const ProofRecord& record);
std::string ProofPage(const ProofRecord& record);

}  // namespace rg::proof
