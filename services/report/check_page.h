// The page of `realitygrad check`: what a recording set holds, what it could show, and every measured signal
// per joint, with gaps shaded and limits drawn.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/reporting/set_check.h"

namespace rg::report {

std::string CheckPage(const recordings::RecordingSet& set, const sim::Plant& plant,
                      const diagnosis::SetCheck& check, const std::vector<diagnosis::EffectShows>& effects);

}  // namespace rg::report
