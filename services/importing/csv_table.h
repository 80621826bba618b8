// A CSV of any make as columns of numbers: wide tables, and PlotJuggler's export, whose cells are empty
// where a series has no value at a time.
//
// Comma, semicolon or tab between fields (the header tells), quotes, a byte order mark, CRLF, a trailing
// separator; a decimal comma where the separator is another. What is no number is NaN.
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
  size_t header_bytes = 0;  // where the first row begins
};

// Error: no header, a column twice, more than 10,000 columns.
Result<CsvHeader> ReadCsvHeader(std::string_view text, const std::string& source_name);

struct CsvTable {
  std::vector<int64_t> time_ns;              // K
  std::vector<std::vector<double>> columns;  // one per column asked for, K each
  bool last_row_cut = false;                 // the last row had too few fields and was left out
};

// `time_unit_ns`: nanoseconds of one unit of the time column. Errors name row, line, column and value: a row
// with other than the header's number of fields, a time that is no number.
Result<CsvTable> ReadCsvTable(std::string_view text, const CsvHeader& header, const std::string& source_name,
                              size_t time_column, double time_unit_ns, const std::vector<size_t>& wanted);

}  // namespace rg::importing
