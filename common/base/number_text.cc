#include "common/base/number_text.h"

#include <charconv>
#include <cmath>

namespace rg {
namespace {

constexpr std::string_view kBlanks = " \t\r\n";

bool IsBlank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; }

std::string_view Trim(std::string_view text) {
  while (!text.empty() && IsBlank(text.front())) text.remove_prefix(1);
  while (!text.empty() && IsBlank(text.back())) text.remove_suffix(1);
  return text;
}

// A number without blanks around it; `word` is not empty.
NumberText ParseWord(std::string_view word, double* value) {
  // from_chars knows no '+', and would take the minus of "+-1".
  if (word.front() == '+') {
    word.remove_prefix(1);
    if (!word.empty() && word.front() == '-') return NumberText::kNotANumber;
  }
  double read = 0.0;
  const char* const end = word.data() + word.size();
  const auto [next, error] = std::from_chars(word.data(), end, read);
  if (next != end || error == std::errc::invalid_argument) return NumberText::kNotANumber;
  if (error == std::errc::result_out_of_range) return NumberText::kOutOfRange;
  *value = read;
  return std::isfinite(read) ? NumberText::kOk : NumberText::kNotFinite;
}

}  // namespace

std::string_view NumberTextMessage(NumberText outcome) {
  switch (outcome) {
    case NumberText::kOk:
      return "is a number";
    case NumberText::kEmpty:
      return "is empty";
    case NumberText::kNotANumber:
      return "is not a number";
    case NumberText::kOutOfRange:
      return "is out of a double's range";
    case NumberText::kNotFinite:
      return "is not finite";
    case NumberText::kWrongCount:
      return "has more or fewer numbers than it should";
  }
  return "is unknown";
}

NumberText ParseNumber(std::string_view text, double* value) {
  text = Trim(text);
  return text.empty() ? NumberText::kEmpty : ParseWord(text, value);
}

NumberText ParseNumbers(std::string_view text, std::span<double> values) {
  text = Trim(text);
  if (text.empty()) return NumberText::kEmpty;
  size_t count = 0;
  while (!text.empty()) {
    const std::string_view word = text.substr(0, text.find_first_of(kBlanks));
    double value = 0.0;
    if (const NumberText outcome = ParseWord(word, &value); outcome != NumberText::kOk) return outcome;
    if (count < values.size()) values[count] = value;
    ++count;
    text = Trim(text.substr(word.size()));
  }
  return count == values.size() ? NumberText::kOk : NumberText::kWrongCount;
}

std::string NumberToText(double value) {
  char buffer[32];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr};
}

}  // namespace rg
