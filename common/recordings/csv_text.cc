#include "common/recordings/csv_text.h"

#include <algorithm>
#include <cstring>

#include "common/base/number_text.h"

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

namespace {

bool IsComment(std::string_view line) {
  return StartsWith(line, "#") || StartsWith(line, "%") || StartsWith(line, "//");
}

// "sep=;", as spreadsheets write it before the header.
bool NamesSeparator(std::string_view line) {
  return StartsWith(line, "sep=") && WithoutBlanks(line).size() <= 5;
}

std::string_view LineAt(std::string_view text, size_t at, char end_of_line) {
  const size_t end = text.find(end_of_line, at);
  return text.substr(at, end == std::string_view::npos ? end : end - at);
}

bool BeginsWithNumber(std::string_view line) {
  line = WithoutBlanks(line);
  if (StartsWith(line, "\"")) line.remove_prefix(1);
  if (StartsWith(line, "-") || StartsWith(line, "+")) line.remove_prefix(1);
  return !line.empty() && (line[0] == '.' || (line[0] >= '0' && line[0] <= '9'));
}

long CountOf(std::string_view line, char c) { return std::count(line.begin(), line.end(), c); }

// The first line that is no comment and not blank.
std::string_view FirstRow(std::string_view text, char end_of_line) {
  for (size_t at = 0; at < text.size();) {
    const std::string_view line = LineAt(text, at, end_of_line);
    if (!WithoutBlanks(line).empty() && !IsComment(line) && !NamesSeparator(line)) return line;
    at += line.size() + 1;
  }
  return {};
}

bool HoldsNumber(std::string_view line, char separator) {
  for (size_t at = 0; at <= line.size();) {
    const size_t end = std::min(line.find(separator, at), line.size());
    if (BeginsWithNumber(WithoutBlanks(line.substr(at, end - at)))) return true;
    at = end + 1;
  }
  return false;
}

// Whether a comment before the first row is the header: as many fields as that row, none of them a number, which some
// of the row's are (a name or a mode may stand before them).
bool IsHeaderComment(std::string_view line, std::string_view row, char separator) {
  const long fields = CountOf(line, separator), trailing = !row.empty() && row.back() == separator ? 1 : 0;
  const long more = CountOf(row, separator) - fields;
  const bool begins = BeginsWithNumber(row), holds = HoldsNumber(row, separator) && !HoldsNumber(line, separator);
  return fields > 0 && (begins || holds) && (more == 0 || more == trailing);
}

}  // namespace

char GuessSeparator(std::string_view text) {
  text = WithoutMark(text);
  const char end_of_line = text.find('\n') == std::string_view::npos ? '\r' : '\n';
  const std::string_view first = LineAt(text, 0, end_of_line);
  if (NamesSeparator(first)) return WithoutBlanks(first).size() > 4 ? first[4] : '\t';
  const std::string_view header = FirstRow(text, end_of_line);
  for (size_t at = 0; at < text.size();) {
    const std::string_view line = LineAt(text, at, end_of_line);
    if (!IsComment(line) && !WithoutBlanks(line).empty()) break;
    for (const char separator : {',', ';', '\t'}) {
      if (IsComment(line) && IsHeaderComment(line, header, separator)) return separator;
    }
    at += line.size() + 1;
  }
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
  if (StartsWith(bytes, "\x28\xB5\x2F\xFD"sv)) return "is compressed: unzstd it first";
  if (StartsWith(bytes, "\xFF\xFE"sv) || StartsWith(bytes, "\xFE\xFF"sv))
    return "is UTF-16 text: save it as UTF-8";
  if (StartsWith(bytes, "version https://git-lfs"sv))
    return "is a git-lfs pointer, the file itself was not fetched: run git lfs pull";
  const std::string_view start = bytes.substr(std::min(bytes.find_first_not_of(" \t\r\n"), bytes.size()));
  if (StartsWith(start, "<"sv)) return "is HTML or XML, no CSV: download the file itself";
  if (StartsWith(start, "{"sv) || StartsWith(start, "["sv))
    return "is JSON, no CSV: write a header and a row for each time";
  if (bytes.substr(0, bytes.find_first_of("\r\n")).substr(0, 256).find('\0') != std::string_view::npos)
    return "is no text: it holds zero bytes (UTF-16 without its mark? Save it as UTF-8)";
  return "";
}

std::string ShownField(std::string_view field) {
  std::string shown = "'";
  for (const char c : field.substr(0, 40)) shown += (c >= ' ' && c <= '~') ? c : '?';
  if (field.size() > 40) shown += "...";
  return shown + "'";
}

bool IsNumber(std::string_view field) {
  double value = 0.0;
  return ParseNumber(field, &value) == NumberText::kOk;
}

std::string WithPoint(std::string_view field) {
  std::string decimal(field);
  std::replace(decimal.begin(), decimal.end(), ',', '.');
  return decimal;
}

// Comments before the first row are read here, once: whether one of them is the header depends on that row.
CsvText::CsvText(std::string_view text, char separator) : text_(WithoutMark(text)), separator_(separator) {
  if (text_.find('\n') == std::string_view::npos) end_of_line_ = '\r';
  const std::string_view row = FirstRow(text_, end_of_line_);
  while (at_ < text_.size() && !hash_header_) {
    const std::string_view line = LineAt(text_, at_, end_of_line_);
    const bool comment = IsComment(line);
    if (!comment && !(at_ == 0 && NamesSeparator(line)) && !WithoutBlanks(line).empty()) return;
    hash_header_ = comment && IsHeaderComment(line, row, separator_);
    if (hash_header_) {
      at_ += line[0] == '/' ? 2 : 1;
    } else {
      TakeLine();
    }
  }
}

bool CsvText::AtEnd() const { return text_.find_first_not_of(" \t\r\n", at_) == std::string_view::npos; }

// In a file with LF a CR that nothing like it follows ends a line, too.
std::string_view CsvText::TakeLine() {
  size_t end = text_.find(end_of_line_, at_);
  std::string_view line = text_.substr(at_, end == std::string_view::npos ? end : end - at_);
  const size_t cr = line.find('\r');
  if (cr + 1 < line.size() && line.find_first_not_of('\r', cr) != std::string_view::npos) {
    line = line.substr(0, cr);
    end = at_ + cr;
  }
  terminated_ = end != std::string_view::npos;
  at_ = terminated_ ? end + 1 : text_.size();
  line_ = next_line_++;
  return line;
}

// True if a line was skipped.
bool CsvText::SkipComments() {
  if (at_ >= text_.size() || (first_ && hash_header_) || !IsComment(text_.substr(at_, 2))) return false;
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
