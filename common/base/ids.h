// Unguessable short identifiers for jobs, tasks, attempts and processes.
#pragma once

#include <string>

namespace rg {

// `bytes` random bytes from the operating system as lower-case hexadecimal.
std::string RandomHex(int bytes);

}  // namespace rg
