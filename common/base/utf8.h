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

// Valid UTF-8 without control characters and without those that reorder or break lines: nothing that a
// terminal obeys instead of showing it. What names and labels must be.
bool IsPlainText(std::string_view text);
// `text` as a terminal may show it: what IsPlainText forbids becomes visible ("\x1b", "\u202e"). Line ends
// and tabs stay with `keep_lines`.
std::string VisibleText(std::string_view text, bool keep_lines = false);

}  // namespace rg
