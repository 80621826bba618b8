#include "services/importing/csv_table.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <set>

#include "services/importing/log.h"

namespace rg::importing {
namespace {

constexpr size_t kMaxColumns = 10000;
constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

std::string_view Trimmed(std::string_view text) {
  const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  while (!text.empty() && blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && blank(text.back())) text.remove_suffix(1);
  return text;
}

// Takes one row off `text` into `fields` (views; quotes taken off, doubled quotes stay doubled).
void TakeRow(std::string_view* text, char separator, std::vector<std::string_view>* fields) {
  fields->clear();
  size_t at = 0, start = 0;
  bool quoted = false;
  const auto close = [&](size_t end) {
    std::string_view field = text->substr(start, end - start);
    field = separator == '\t' ? field : Trimmed(field);
    if (!field.empty() && field.back() == '\r') field.remove_suffix(1);
    if (field.size() >= 2 && field.front() == '"' && field.back() == '"')
      field = Trimmed(field.substr(1, field.size() - 2));
    fields->push_back(field);
    start = end + 1;
  };
  for (; at < text->size(); ++at) {
    const char c = (*text)[at];
    if (c == '"') quoted = !quoted;
    if (c == separator && !quoted) close(at);
    if (c == '\n') break;  // also inside quotes: a name with a line break is none
  }
  close(std::min(at, text->size()));
  text->remove_prefix(std::min(at + 1, text->size()));
}

char SeparatorOf(std::string_view line) {
  char best = ',';
  for (const char c : {';', '\t'}) {
    if (std::count(line.begin(), line.end(), c) > std::count(line.begin(), line.end(), best)) best = c;
  }
  return best;
}

// As text with a decimal point; `buffer` holds it where a comma had to go.
std::string_view WithPoint(std::string_view field, char separator, char (&buffer)[64]) {
  if (!field.empty() && field.front() == '+') field.remove_prefix(1);
  if (separator == ',' || field.size() >= sizeof buffer || field.find('.') != std::string_view::npos)
    return field;
  const size_t comma = field.find(',');
  if (comma == std::string_view::npos) return field;
  std::copy(field.begin(), field.end(), buffer);
  buffer[comma] = '.';
  return {buffer, field.size()};
}

template <class T>
bool ParseNumber(std::string_view field, char separator, T* value) {
  char buffer[64];
  field = WithPoint(field, separator, buffer);
  const auto end = std::from_chars(field.data(), field.data() + field.size(), *value);
  return !field.empty() && end.ec == std::errc() && end.ptr == field.data() + field.size();
}

}  // namespace

Result<CsvHeader> ReadCsvHeader(std::string_view text, const std::string& source) {
  CsvHeader header;
  std::string_view rest = text;
  if (rest.substr(0, 3) == "\xEF\xBB\xBF") rest.remove_prefix(3);
  header.separator = SeparatorOf(rest.substr(0, rest.find('\n')));
  std::vector<std::string_view> fields;
  TakeRow(&rest, header.separator, &fields);
  header.header_bytes = text.size() - rest.size();
  while (fields.size() > 1 && fields.back().empty()) fields.pop_back();
  if (fields.size() > kMaxColumns)
    return InvalidError(source + ": header (line 1): more than " + std::to_string(kMaxColumns) + " columns");
  std::set<std::string_view> seen;
  double number = 0.0;
  for (size_t i = 0; i < fields.size(); ++i) {
    const std::string place = source + ": header (line 1): column " + std::to_string(i + 1);
    if (fields[i].empty()) return InvalidError(place + " has no name");
    if (ParseNumber(fields[i], header.separator, &number))
      return InvalidError(place + ": " + Shown(fields[i]) + " is a number: the file has no header");
    if (!seen.insert(fields[i]).second)
      return InvalidError(place + ": " + Shown(fields[i]) + " is there twice");
    header.columns.emplace_back(fields[i]);
  }
  return header;
}

Result<CsvTable> ReadCsvTable(std::string_view text, const CsvHeader& header, const std::string& source,
                              size_t time_column, double time_unit_ns, const std::vector<size_t>& wanted) {
  CsvTable table;
  table.columns.resize(wanted.size());
  const size_t count = header.columns.size();
  text.remove_prefix(std::min(header.header_bytes, text.size()));
  std::vector<std::string_view> fields;
  for (size_t row = 1; !text.empty(); ++row) {
    TakeRow(&text, header.separator, &fields);
    const std::string_view whole = fields.size() == 1 ? fields[0] : "x";
    if (whole.empty()) continue;  // an empty line
    const std::string place =
        source + ": row " + std::to_string(row) + " (line " + std::to_string(row + 1) + ")";
    while (fields.size() > count && fields.back().empty()) fields.pop_back();
    if (fields.size() < count && text.empty()) {
      table.last_row_cut = true;
      break;
    }
    if (fields.size() != count)
      return InvalidError(place + ": " + std::to_string(fields.size()) + " of " + std::to_string(count) +
                          " fields");
    long double time = 0.0;
    if (!ParseNumber(fields[time_column], header.separator, &time) ||
        !(std::abs(time * time_unit_ns) < 9.2e18L)) {
      return InvalidError(place + ", column " + header.columns[time_column] + ": " +
                          Shown(fields[time_column]) + " is no time");
    }
    table.time_ns.push_back(std::llroundl(time * static_cast<long double>(time_unit_ns)));
    for (size_t i = 0; i < wanted.size(); ++i) {
      double value = kNone;
      if (!ParseNumber(fields[wanted[i]], header.separator, &value)) value = kNone;
      table.columns[i].push_back(value);
    }
  }
  return table;
}

}  // namespace rg::importing
