// report.html: the diagnosis for a roboticist who has five minutes.
#pragma once

#include <string>

#include "services/diagnosis/diagnosis.h"

namespace rg::diagnosis {

std::string DiagnosisPage(const DiagnosisResult& result);

}  // namespace rg::diagnosis
