// The text of a CSV file as rows of fields: separators, quotes, line ends, byte order mark.
//
// Fields are separated by commas unless a dialect says otherwise. A field in double quotes may hold
// separators, line ends and doubled quotes ("" for one). Rows end with LF, CRLF or, in files without any LF,
// CR. Lines that begin with '#' are comments, but for one before the first row: a header as numpy.savetxt
// writes it.
#pragma once

#include <deque>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"

namespace rg::recordings {

struct CsvDialect {
  char separator = ',';
  bool decimal_comma = false;  // "0,25" is a quarter; only where the separator is no comma
};

// The names of --csv-dialect: comma, semicolon, tab (numbers with a decimal point or, but for comma, a
// decimal comma).
Result<CsvDialect> ParseCsvDialect(const std::string& name);

// What a text's first line is separated by: commas if there are any, else semicolons or tabs if there are.
char GuessSeparator(std::string_view text);

// Why these bytes are no CSV at all ("is a ROS 1 bag: `realitygrad import` reads it"); empty where they may
// be.
std::string OtherFormatOf(std::string_view bytes);

// A piece of an untrusted file for a message: short and printable.
std::string ShownField(std::string_view field);
bool IsNumber(std::string_view field);
// A field with decimal points for its commas.
std::string WithPoint(std::string_view field);

class CsvText {
 public:
  // `text` outlives this; a byte order mark is skipped.
  CsvText(std::string_view text, char separator);

  // The next row's fields, blanks around them taken off, quotes too; false at the end. Empty lines are rows
  // of no fields. The views live until the next call. Error: a quote that is never closed.
  bool Next(std::vector<std::string_view>* fields);
  const Status& status() const { return status_; }

  int line() const { return line_; }                        // of the row given last, from 1
  bool terminated() const { return terminated_; }           // whether that row had a line end
  std::string_view raw() const { return raw_; }             // that row's text
  bool AtEnd() const;                                       // nothing but blanks follows
  bool header_was_comment() const { return hash_header_; }  // the first row began with '#'

 private:
  bool SkipComments();
  void SplitPlain(std::vector<std::string_view>* fields) const;
  bool SplitQuoted(std::vector<std::string_view>* fields);
  std::string_view TakeLine();

  std::string_view text_;
  char separator_, end_of_line_ = '\n';
  size_t at_ = 0;
  int line_ = 0, next_line_ = 1;
  bool terminated_ = true, first_ = true, hash_header_ = false;
  std::string_view raw_;
  std::deque<std::string> unquoted_;
  Status status_;
};

}  // namespace rg::recordings
