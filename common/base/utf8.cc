#include "common/base/utf8.h"

#include <cstdint>
#include <cstdio>

namespace rg {
namespace {

// Length of the valid character at the start of `text`; 0: there is none. `text` is not empty.
size_t CharacterLength(std::string_view text, uint32_t* character = nullptr) {
  const auto byte = [&](size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned char lead = byte(0);
  if (character != nullptr) *character = lead;
  if (lead < 0x80) return 1;
  const size_t length = lead >= 0xC2 && lead <= 0xDF   ? 2
                        : (lead & 0xF0) == 0xE0        ? 3
                        : lead >= 0xF0 && lead <= 0xF4 ? 4
                                                       : 0;
  if (length == 0 || text.size() < length) return 0;
  uint32_t code = lead & (0x7Fu >> length);
  for (size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xC0) != 0x80) return 0;
    code = (code << 6) | (byte(i) & 0x3Fu);
  }
  const bool overlong = (length == 3 && code < 0x800) || (length == 4 && code < 0x10000);
  const bool surrogate = code >= 0xD800 && code <= 0xDFFF;
  if (character != nullptr) *character = code;
  return overlong || surrogate || code > 0x10FFFF ? 0 : length;
}

// C0, C1 and DEL; separators of lines and paragraphs; what changes the direction of writing.
bool IsObeyed(uint32_t code) {
  return code < 0x20 || (code >= 0x7F && code <= 0x9F) || code == 0x2028 || code == 0x2029 ||
         (code >= 0x202A && code <= 0x202E) || (code >= 0x2066 && code <= 0x2069) || code == 0x200E ||
         code == 0x200F;
}

}  // namespace

bool IsUtf8(std::string_view text) {
  while (!text.empty()) {
    const size_t length = CharacterLength(text);
    if (length == 0) return false;
    text.remove_prefix(length);
  }
  return true;
}

std::string CleanUtf8(std::string_view text, size_t max_bytes) {
  std::string clean;
  while (!text.empty()) {
    const size_t length = CharacterLength(text);
    const size_t step = length == 0 ? 1 : length;
    if (clean.size() + step > max_bytes) break;
    length == 0 ? clean.push_back('?') : void(clean.append(text.substr(0, length)));
    text.remove_prefix(step);
  }
  return clean;
}

bool IsPlainText(std::string_view text) {
  while (!text.empty()) {
    uint32_t code = 0;
    const size_t length = CharacterLength(text, &code);
    if (length == 0 || IsObeyed(code)) return false;
    text.remove_prefix(length);
  }
  return true;
}

std::string VisibleText(std::string_view text, bool keep_lines) {
  std::string visible;
  while (!text.empty()) {
    uint32_t code = 0;
    const size_t length = CharacterLength(text, &code);
    const bool is_layout = keep_lines && (code == '\n' || code == '\t');
    if (length > 0 && (!IsObeyed(code) || is_layout)) {
      visible.append(text.substr(0, length));
    } else {
      char escape[16];
      const uint32_t shown = length == 0 ? static_cast<unsigned char>(text[0]) : code;
      std::snprintf(escape, sizeof escape, shown <= 0xFF ? "\\x%02x" : "\\u%04x", shown);
      visible += escape;
    }
    text.remove_prefix(length == 0 ? 1 : length);
  }
  return visible;
}

}  // namespace rg
