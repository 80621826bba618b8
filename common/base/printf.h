// Numbers in text where a stream's state would be in the way.
#pragma once

#include <cstdio>
#include <string>

namespace rg {

// As std::snprintf; cut off after 255 characters.
std::string Printf(const char* format, auto... args) {
  char line[256];
  std::snprintf(line, sizeof line, format, args...);
  return line;
}

}  // namespace rg
