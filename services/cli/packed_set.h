// Recording sets on this machine as what a task takes.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::cli {

// The bytes of one artefact; several sets of one robot become one, its splits as they are. A bad set is
// refused here, by the line that its reader has for it.
Result<std::string> PackedSet(const std::vector<std::string>& folders);

}  // namespace rg::cli
