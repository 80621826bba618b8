#include "services/importing/csv_table.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <set>

#include "common/base/number_text.h"
#include "common/recordings/csv_text.h"
#include "services/importing/log.h"

namespace rg::importing {
namespace {

constexpr size_t kMaxColumns = 10000;
constexpr double kEmptyCell = std::numeric_limits<double>::quiet_NaN();
constexpr long double kLastTimeNs = 4.5e18L;  // the year 2112; differences of two such times do not overflow

// As text with a decimal point; `buffer` holds it where a comma had to go.
std::string_view WithPoint(std::string_view field, char separator, char (&buffer)[64]) {
  if (separator == ',' || field.size() >= sizeof buffer || field.find('.') != std::string_view::npos)
    return field;
  const size_t comma = field.find(',');
  if (comma == std::string_view::npos) return field;
  std::copy(field.begin(), field.end(), buffer);
  buffer[comma] = '.';
  return {buffer, field.size()};
}

// False: text. Empty and NaN are numbers that are not there.
bool ReadNumber(std::string_view field, char separator, double* value) {
  char buffer[64];
  *value = kEmptyCell;
  const NumberText outcome = ParseNumber(WithPoint(field, separator, buffer), value);
  return outcome != NumberText::kNotANumber;
}

// Nanoseconds exactly, where a double has not enough digits.
bool ReadTime(std::string_view field, char separator, double unit_ns, int64_t* time_ns) {
  char buffer[64];
  field = WithPoint(field, separator, buffer);
  if (!field.empty() && field.front() == '+') field.remove_prefix(1);
  long double time = 0.0L;
  const auto end = std::from_chars(field.data(), field.data() + field.size(), time);
  const long double ns = time * static_cast<long double>(unit_ns);
  if (field.empty() || end.ec != std::errc() || end.ptr != field.data() + field.size() ||
      !(std::abs(ns) < kLastTimeNs)) {
    return false;
  }
  *time_ns = std::llroundl(ns);
  return true;
}

}  // namespace

Result<CsvHeader> ReadCsvHeader(std::string_view text, const std::string& source) {
  if (const std::string other = recordings::OtherFormatOf(text); !other.empty())
    return InvalidError(source + ": " + other);
  CsvHeader header;
  header.separator = recordings::GuessSeparator(text);
  recordings::CsvText rows(text, header.separator);
  std::vector<std::string_view> fields;
  const std::string line = source + ": header (line 1)";
  if (!rows.Next(&fields))
    return InvalidError(source + ": " + (rows.status().ok() ? "is empty" : rows.status().message()));
  while (!fields.empty() && fields.back().empty()) fields.pop_back();
  if (fields.empty()) return InvalidError(line + ": is empty");
  if (fields.size() > kMaxColumns)
    return InvalidError(line + ": more than " + std::to_string(kMaxColumns) + " columns");
  std::set<std::string_view> seen;
  double number = 0.0;
  for (size_t i = 0; i < fields.size(); ++i) {
    const std::string place = line + ": column " + std::to_string(i + 1);
    if (fields[i].empty()) return InvalidError(place + " has no name");
    if (ParseNumber(fields[i], &number) == NumberText::kOk)
      return InvalidError(place + ": " + Shown(fields[i]) + " is a number: the file has no header");
    if (!seen.insert(fields[i]).second)
      return InvalidError(place + ": " + Shown(fields[i]) + " is there twice");
    header.columns.emplace_back(fields[i]);
  }
  return header;
}

Result<CsvTable> ReadCsvTable(std::string_view text, const CsvHeader& header, const std::string& source,
                              size_t time_column, double time_unit_ns, const std::vector<size_t>& wanted,
                              size_t most_rows) {
  CsvTable table;
  table.columns.resize(wanted.size());
  table.is_text.assign(wanted.size(), false);
  const size_t count = header.columns.size();
  recordings::CsvText rows(text, header.separator);
  std::vector<std::string_view> fields;
  rows.Next(&fields);  // the header
  for (size_t row = 1; row <= most_rows && rows.Next(&fields); ++row) {
    while (fields.size() > count && fields.back().empty()) fields.pop_back();
    if (fields.empty()) {  // an empty line
      --row;
      continue;
    }
    const std::string place =
        source + ": row " + std::to_string(row) + " (line " + std::to_string(rows.line()) + ")";
    if (fields.size() < count && rows.AtEnd() && row > 1) {
      table.last_row_cut = true;
      break;
    }
    if (fields.size() != count)
      return InvalidError(place + ": " + std::to_string(fields.size()) + " of " + std::to_string(count) +
                          " fields");
    int64_t time_ns = 0;
    if (!ReadTime(fields[time_column], header.separator, time_unit_ns, &time_ns)) {
      return InvalidError(place + ", column " + header.columns[time_column] + ": " +
                          Shown(fields[time_column]) + " is no time");
    }
    double time = 0.0;
    ReadNumber(fields[time_column], header.separator, &time);
    table.time_ns.push_back(time_ns);
    table.time.push_back(time);
    for (size_t i = 0; i < wanted.size(); ++i) {
      double value = kEmptyCell;
      if (!ReadNumber(fields[wanted[i]], header.separator, &value)) table.is_text[i] = true;
      table.columns[i].push_back(value);
    }
  }
  if (!rows.status().ok()) return rows.status().WithPrefix(source);
  return table;
}

}  // namespace rg::importing
