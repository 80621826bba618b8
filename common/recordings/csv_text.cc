#include "common/recordings/csv_text.h"

#include <algorithm>
#include <cstring>

namespace rg::recordings {
namespace {

constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";

std::string_view WithoutMark(std::string_view text) {
  return text.substr(0, 3) == kByteOrderMark ? text.substr(3) : text;
}

bool IsBlank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

std::string_view WithoutBlanks(std::string_view field) {
  while (!field.empty() && IsBlank(field.front())) field.remove_prefix(1);
  while (!field.empty() && IsBlank(field.back())) field.remove_suffix(1);
  return field;
}

bool StartsWith(std::string_view text, std::string_view start) {
  return text.substr(0, start.size()) == start;
}

}  // namespace

Result<CsvDialect> ParseCsvDialect(const std::string& name) {
  if (name == "comma") return CsvDialect{};
  if (name == "semicolon") return CsvDialect{';', true};
  if (name == "tab") return CsvDialect{'\t', true};
  return InvalidError("--csv-dialect: '" + name + "', must be comma, semicolon or tab");
}

char GuessSeparator(std::string_view text) {
  text = WithoutMark(text);
  const std::string_view header = text.substr(0, text.find_first_of("\r\n"));
  for (const char separator : {',', ';', '\t'}) {
    if (header.find(separator) != std::string_view::npos) return separator;
  }
  return ',';
}

std::string OtherFormatOf(std::string_view bytes) {
  using namespace std::string_view_literals;
  if (StartsWith(bytes, "#ROSBAG"sv)) return "is a ROS 1 bag: `realitygrad import` reads it";
  if (StartsWith(bytes, "\x89MCAP"sv)) return "is an MCAP file: `realitygrad import` reads it";
  if (StartsWith(bytes, "SQLite format 3"sv))
    return "is an SQLite database: `realitygrad import` reads it if it is a ROS 2 bag";
  if (StartsWith(bytes, "PK\x03\x04"sv)) return "is a ZIP archive or a spreadsheet: save it as CSV (UTF-8)";
  if (StartsWith(bytes, "\x1F\x8B"sv)) return "is compressed: gunzip it first";
  if (StartsWith(bytes, "\xFF\xFE"sv) || StartsWith(bytes, "\xFE\xFF"sv))
    return "is UTF-16 text: save it as UTF-8";
  if (bytes.substr(0, bytes.find_first_of("\r\n")).substr(0, 256).find('\0') != std::string_view::npos)
    return "is no text: it holds zero bytes";
  return "";
}

CsvText::CsvText(std::string_view text, char separator) : text_(WithoutMark(text)), separator_(separator) {
  if (text_.find('\n') == std::string_view::npos) end_of_line_ = '\r';
}

bool CsvText::AtEnd() const { return text_.find_first_not_of(" \t\r\n", at_) == std::string_view::npos; }

std::string_view CsvText::TakeLine() {
  const size_t end = text_.find(end_of_line_, at_);
  terminated_ = end != std::string_view::npos;
  const std::string_view line = text_.substr(at_, terminated_ ? end - at_ : std::string_view::npos);
  at_ = terminated_ ? end + 1 : text_.size();
  line_ = next_line_++;
  return line;
}

// True if a line was skipped. A '#' before the first row makes a header, where that row has more than one
// field.
bool CsvText::SkipComments() {
  if (at_ >= text_.size() || text_[at_] != '#') return false;
  const std::string_view line = text_.substr(at_, text_.find(end_of_line_, at_) - at_);
  if (first_ && line.find(separator_) != std::string_view::npos) {
    hash_header_ = true;
    ++at_;
    return false;
  }
  TakeLine();
  return true;
}

bool CsvText::Next(std::vector<std::string_view>* fields) {
  fields->clear();
  unquoted_.clear();
  while (SkipComments()) {
  }
  if (at_ >= text_.size() || !status_.ok()) return false;
  first_ = false;
  const size_t begin = at_;
  raw_ = TakeLine();
  if (raw_.find('"') != std::string_view::npos) {
    const int line = line_;
    at_ = begin;
    next_line_ = line_;
    const bool ok = SplitQuoted(fields);
    line_ = line;
    raw_ = text_.substr(begin, at_ - begin);
    return ok;
  }
  if (!WithoutBlanks(raw_).empty()) SplitPlain(fields);
  return true;
}

void CsvText::SplitPlain(std::vector<std::string_view>* fields) const {
  const char* at = raw_.data();
  const char* const end = at + raw_.size();
  while (true) {
    const auto* next = static_cast<const char*>(std::memchr(at, separator_, static_cast<size_t>(end - at)));
    const char* const stop = next ? next : end;
    fields->push_back(WithoutBlanks({at, static_cast<size_t>(stop - at)}));
    if (!next) return;
    at = next + 1;
  }
}

// A field whose first character is a quote ends with the next one that is not doubled; quotes elsewhere are
// letters.
bool CsvText::SplitQuoted(std::vector<std::string_view>* fields) {
  const int first_line = next_line_++;
  while (true) {
    while (at_ < text_.size() && IsBlank(text_[at_]) && text_[at_] != separator_ &&
           text_[at_] != end_of_line_)
      ++at_;
    if (at_ < text_.size() && text_[at_] == '"') {
      std::string& field = unquoted_.emplace_back();
      size_t k = at_ + 1;
      for (;; ++k) {
        if (k >= text_.size()) {
          status_ = InvalidError("line " + std::to_string(first_line) + ": a quote (\") is never closed");
          return false;
        }
        if (text_[k] == end_of_line_) ++next_line_;
        if (text_[k] != '"') {
          field += text_[k];
        } else if (k + 1 < text_.size() && text_[k + 1] == '"') {
          field += text_[k++];
        } else {
          break;
        }
      }
      at_ = k + 1;
      const size_t rest =
          std::min(text_.find_first_of(std::string{separator_, end_of_line_}, at_), text_.size());
      field += text_.substr(at_, rest - at_);
      fields->push_back(WithoutBlanks(field));
      at_ = rest;
    } else {
      const size_t rest =
          std::min(text_.find_first_of(std::string{separator_, end_of_line_}, at_), text_.size());
      fields->push_back(WithoutBlanks(text_.substr(at_, rest - at_)));
      at_ = rest;
    }
    terminated_ = at_ < text_.size() && text_[at_] == end_of_line_;
    if (at_ >= text_.size()) return true;
    ++at_;
    if (terminated_) return true;
    if (at_ >= text_.size()) {  // the text ends behind a separator
      fields->push_back({});
      return true;
    }
  }
}

}  // namespace rg::recordings
