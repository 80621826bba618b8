// A CSV of any make as columns of numbers: wide tables, and PlotJuggler's export, whose cells are empty
// where a series has no value at a time.
//
// Text as common/recordings/csv_text.h has it; a decimal comma where the separator is another. What is no
// number is NaN.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"

namespace rg::importing {

struct CsvHeader {
  std::vector<std::string> columns;
  char separator = ',';
};

// Error: no header, a column without a name or twice, more than 10,000 columns.
Result<CsvHeader> ReadCsvHeader(std::string_view text, const std::string& source_name);

struct CsvTable {
  std::vector<int64_t> time_ns;              // K
  std::vector<double> time;                  // K, as in the file, in its unit
  std::vector<std::vector<double>> columns;  // one per column asked for, K each
  std::vector<bool> is_text;  // one per column asked for: a field of it is neither number nor empty
  bool last_row_cut = false;  // the last row had too few fields and was left out
};

// `time_unit_ns`: nanoseconds of one unit of the time column. At most `most_rows` are read. Errors name row,
// line, column and value: a row with other than the header's number of fields, a time that is no number.
Result<CsvTable> ReadCsvTable(std::string_view text, const CsvHeader& header, const std::string& source_name,
                              size_t time_column, double time_unit_ns, const std::vector<size_t>& wanted,
                              size_t most_rows = SIZE_MAX);

}  // namespace rg::importing
