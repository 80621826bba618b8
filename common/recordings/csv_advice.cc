#include "common/recordings/csv_advice.h"

#include <algorithm>
#include <cctype>

#include "common/base/number_text.h"

namespace rg::recordings {
namespace {

constexpr const char* kOrImport = ", or `realitygrad import` with a mapping";

std::string Lower(std::string_view text) {
  std::string out(text);
  std::transform(out.begin(), out.end(), out.begin(), [](unsigned char c) { return std::tolower(c); });
  return out;
}

std::string Quoted(std::string_view text) {
  std::string shown = "'";
  for (const char c : text.substr(0, 40)) shown += (c >= ' ' && c <= '~') ? c : '?';
  return shown + (text.size() > 40 ? "...'" : "'");
}

bool LooksLikeTime(const std::string& name) {
  const std::string lower = Lower(name);
  for (const char* like : {"time", "stamp", "__time", "header.stamp"}) {
    if (lower.starts_with(like)) return true;
  }
  for (const char* like :
       {"t", "t_s", "t_ms", "t_us", "t_ns", "sec", "secs", "seconds", "t [s]", "t[s]", "t(s)"}) {
    if (lower == like) return true;
  }
  return lower.ends_with("timestamp") || lower.ends_with("/time");
}

}  // namespace

bool MeansMissing(std::string_view field) {
  if (field.empty() || field.size() > 5) return false;
  const std::string lower = Lower(field);
  for (const char* word : {"none", "null", "nil", "na", "n/a", "#n/a", "<na>", "-", "--", "---", "."}) {
    if (lower == word) return true;
  }
  return false;
}

std::string WhyNoNumber(std::string_view field) {
  const auto has = [&](char c) { return field.find(c) != std::string_view::npos; };
  if (std::any_of(field.begin(), field.end(), [](unsigned char c) { return c >= 0x80; }))
    return "; it holds characters other than ASCII (a printed minus or blank?)";
  if (has('\0')) return "; the file is damaged here: it holds zero bytes";
  if (has(',') || has('\'') || has(' ')) {
    std::string plain(field);
    std::erase_if(plain, [](char c) { return c == ',' || c == '\'' || c == ' '; });
    double value = 0.0;
    if (ParseNumber(plain, &value) == NumberText::kOk)
      return "; numbers have a decimal point and nothing between thousands";
  }
  if (field.size() > 5 && has(':')) return "; dates and clocks are not read, time is in s";
  return "; SI units without their names, decimal points";
}

std::string NoTimeAdvice(const std::vector<std::string>& names) {
  for (const std::string& name : names) {
    if (names.size() > 1 && LooksLikeTime(name))
      return "; " + Quoted(name) + " looks like it: name it time" + kOrImport;
  }
  if (names.size() != 1) return "";
  if (names[0].find('|') != std::string::npos)
    return "; fields look separated by '|': convert it: tr '|' ',' < FILE > NEW";
  if (names[0].find(' ') != std::string::npos)
    return "; fields look separated by blanks: convert it: sed 's/^ *//; s/ \\+/,/g' FILE > NEW";
  if (names[0].starts_with("'")) return "; quotes are double ones (\")";
  return "";
}

std::string MissingColumnAdvice(const std::vector<std::string>& names, const std::string& joint,
                                const std::vector<std::string>& words, const std::string& should_be,
                                const std::string& instead) {
  const std::string wanted = Lower(joint);
  for (const std::string& name : names) {
    std::string rest = Lower(name);
    const size_t at = rest.rfind(wanted), behind = at + wanted.size();
    if (at == std::string::npos ||
        (behind < rest.size() && std::isalnum(static_cast<unsigned char>(rest[behind]))))
      continue;
    rest.erase(at, wanted.size());
    const bool says = std::any_of(words.begin(), words.end(), [&](const std::string& word) {
      const size_t found = rest.find(word);
      if (found == std::string::npos) return false;
      // One or two letters are a word of their own.
      const auto letter = [&](size_t k) {
        return k < rest.size() && std::isalpha(static_cast<unsigned char>(rest[k]));
      };
      return word.size() > 2 || !((found > 0 && letter(found - 1)) || letter(found + word.size()));
    });
    if (says) return "; " + Quoted(name) + " looks like it: name it " + should_be + kOrImport;
  }
  return instead;
}

namespace {

// Marks that some systems write behind the letter that others write as one: "e\u0301" for "\u00e9".
bool HasCombiningMark(const std::string& text) {
  for (size_t i = 0; i + 1 < text.size(); ++i) {
    const auto lead = static_cast<unsigned char>(text[i]), next = static_cast<unsigned char>(text[i + 1]);
    if (lead == 0xCC || (lead == 0xCD && next < 0xB0)) return true;  // U+0300 to U+036F
  }
  return false;
}

// The plain letters of a name.
std::string Ascii(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (static_cast<unsigned char>(c) < 0x80) out += c;
  }
  return out;
}

// They look the same: one of them has its accents as marks of their own, which a base letter stands before.
bool DifferInMarksOnly(const std::string& a, const std::string& b) {
  if (HasCombiningMark(a) == HasCombiningMark(b)) return false;
  const std::string &marked = HasCombiningMark(a) ? a : b, plain = Ascii(HasCombiningMark(a) ? b : a);
  const std::string letters = Ascii(marked);  // the base letters among them
  size_t at = 0;
  for (const char c : letters) at += at < plain.size() && plain[at] == c;
  return at == plain.size() && letters.size() > plain.size();
}

}  // namespace

std::string UnknownJointAdvice(const std::string& joint, const std::vector<std::string>& known) {
  const std::string lower = Lower(joint);
  for (const std::string& name : known) {
    if (DifferInMarksOnly(joint, name))
      return "; it looks like its '" + name + "', but accents are written otherwise (one is in Unicode's NFD, as macOS " +
             "writes): copy the URDF's name";
  }
  for (const std::string& name : known) {
    const std::string other = Lower(name);
    if (name.empty() || joint.empty() || joint == name) continue;
    const bool ends = lower.ends_with(other), is_end = other.ends_with(lower),
               begins = lower.starts_with(other) && lower.size() > other.size() &&
                        !std::isalnum(static_cast<unsigned char>(lower[other.size()])) &&
                        lower[other.size()] != '_';
    if (ends || begins || is_end) {
      const bool unit = begins && !ends;
      return "; is it '" + name + "'? " +
             (unit ? "Names carry no units"
                   : "Joints have the URDF's names, upper and lower case and prefixes included") +
             kOrImport;
    }
  }
  std::string names;
  for (size_t i = 0; i < known.size() && i < 16; ++i) names += (i == 0 ? "" : ", ") + known[i];
  return "; it has " + names;
}

}  // namespace rg::recordings
