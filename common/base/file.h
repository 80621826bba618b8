// Files whole: read, and written so that a reader sees the old bytes or the new ones, never a part.
#pragma once

#include <string>
#include <string_view>

#include "common/base/status.h"

namespace rg {

Result<std::string> ReadFile(const std::string& path);
// Temp file beside `path`, fsync, rename, fsync of the folder. Parent folders are made.
Status WriteFileAtomically(const std::string& path, std::string_view bytes);

}  // namespace rg
