#include "services/importing/name_words.h"

#include <algorithm>

namespace rg::importing {

std::string Lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  return text;
}

std::vector<std::string> Words(const std::string& text) {
  std::vector<std::string> words(1);
  for (const char c : Lower(text)) {
    if ((c >= 'a' && c <= 'z') || (c >= '0' && c <= '9')) {
      words.back() += c;
    } else if (!words.back().empty()) {
      words.emplace_back();
    }
  }
  if (words.back().empty()) words.pop_back();
  return words;
}

bool HasWord(const std::vector<std::string>& words, std::initializer_list<const char*> some) {
  return std::any_of(words.begin(), words.end(), [&](const std::string& word) {
    return std::any_of(some.begin(), some.end(), [&](const char* w) { return word == w; });
  });
}

bool Contains(const std::string& text, std::initializer_list<const char*> some) {
  const std::string lower = Lower(text);
  return std::any_of(some.begin(), some.end(),
                     [&](const char* w) { return lower.find(w) != std::string::npos; });
}

bool IsCommand(const std::string& name) {
  return Contains(name, {"command", "desired", "setpoint", "target", "reference", "goal"}) ||
         HasWord(Words(name), {"cmd", "cmds", "ref", "des", "in"});
}

bool IsEffort(const std::string& name) {
  return Contains(name, {"effort", "torque"}) || HasWord(Words(name), {"tau"});
}

}  // namespace rg::importing
