// report.html of a diagnosis, for a roboticist who has five minutes: the sentence; where it is (missing force
// over time and over the variable that explains it, what is explained through it); before and after on
// held-out recordings; what else was considered and why not; which parameters had absorbed it; what to record
// next.
#pragma once

#include <string>

#include "services/diagnosis/diagnosis.h"

namespace rg::report {

std::string DiagnosisPage(const diagnosis::DiagnosisResult& result);

}  // namespace rg::report
