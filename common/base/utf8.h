// Text that came from anywhere (a program's output, an error of a library) made fit for messages and
// databases, which carry UTF-8 only.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace rg {

// RFC 3629: no overlong forms, no surrogates, nothing above U+10FFFF.
bool IsUtf8(std::string_view text);
// `text` with every byte that belongs to no valid character replaced by '?', cut to at most
// `max_bytes` between characters.
std::string CleanUtf8(std::string_view text, size_t max_bytes = std::string::npos);

}  // namespace rg
