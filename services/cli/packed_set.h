// Recording sets on this machine as what a task takes.
#pragma once

#include <string>

#include "common/base/status.h"
#include "services/cli/set_arguments.h"

namespace rg::cli {

// The bytes of one artefact; several sets of one robot become one, its splits as they are. A bad set is
// refused here, by the line that its reader has for it. One folder is packed as it is, all else is written
// anew.
Result<std::string> PackedSet(const SetArguments& arguments);

}  // namespace rg::cli
