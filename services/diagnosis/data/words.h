// Numbers and lists of names as sentences have them.
#pragma once

#include <cstdio>
#include <string>
#include <vector>

namespace rg::diagnosis {

inline std::string Number(double x) {
  char text[40];
  std::snprintf(text, sizeof text, "%.3g", x);
  return text;
}

// "a, b and c".
inline std::string Listed(const std::vector<std::string>& names) {
  std::string out;
  for (size_t i = 0; i < names.size(); ++i)
    out += (i == 0 ? "" : i + 1 == names.size() ? " and " : ", ") + names[i];
  return out;
}

}  // namespace rg::diagnosis
