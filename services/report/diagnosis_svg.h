// The picture of a diagnosis that stands in a document: missing force over what explains it, joint by joint.
#pragma once

#include <string>

#include "services/diagnosis/diagnosis.h"

namespace rg::report {

// A small SVG (tens of kB): for up to four joints of the findings the force that the model lacks over
// velocity, as estimated and as the findings explain it. A line of text says so where there is nothing to
// draw.
std::string DiagnosisSvg(const diagnosis::DiagnosisResult& result);

}  // namespace rg::report
