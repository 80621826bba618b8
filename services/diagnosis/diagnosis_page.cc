#include "services/diagnosis/diagnosis_page.h"

#include "services/report/page.h"

namespace rg::diagnosis {

std::string DiagnosisPage(const DiagnosisResult& r) {
  report::Page page("Diagnosis of " + r.robot, r.verdict);
  for (const Finding& f : r.findings) page.Lead(f.statement);
  return page.Html();
}

}  // namespace rg::diagnosis
