// What every command says, and where: data on stdout (a table, or exactly one JSON value), all else
// on stderr. Exit codes are part of the interface (README.md).
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"

namespace rg::cli {

enum ExitCode : int {
  kExitOk = 0,
  kExitError = 1,
  kExitUsage = 2,
  kExitJobFailed = 3,
  kExitCancelled = 4,
  kExitTimeout = 5,
  kExitUnreachable = 6,
  kExitCannotPlace = 7,
};

// The code a command ends with after `status`.
ExitCode ExitCodeOf(const Status& status);

enum class OutputFormat { kTable, kJson, kQuiet };

// "table", "json", "quiet"; anything else is invalid.
Result<OutputFormat> ParseOutputFormat(std::string_view text);

// Of a JSON list; NaN where an element is no number.
std::vector<double> Numbers(const nlohmann::json& list);

// Columns aligned by what a terminal shows (UTF-8 aware), header in upper case.
class TextTable {
 public:
  // A name that starts with '>' is right-aligned: ">SECONDS".
  explicit TextTable(std::vector<std::string> columns);
  void AddRow(std::vector<std::string> cells);
  std::string ToString() const;
  bool empty() const { return rows_.empty(); }

 private:
  std::vector<std::string> columns_;
  std::vector<bool> right_;
  std::vector<std::vector<std::string>> rows_;
};

// One JSON value with its schema version first: {"format": "realitygrad.jobs/1", …}.
void PrintJson(std::string_view format, nlohmann::json value);
// stdout (stderr), newline added. Names, logs and reasons came from anybody: what a terminal would obey is
// shown instead (VisibleText), line ends and tabs stay.
void Print(std::string_view text);
void PrintNote(std::string_view text);
// Whether anything went to stdout.
bool AnythingPrinted();
// A word of a command line as a shell takes it: quoted where it has to be.
std::string ShellWord(const std::string& text);
// The error as one JSON value, for who reads stdout.
void PrintJsonError(const Status& status);
// "realitygrad: invalid: …" on stderr; returns the exit code to end with.
int Fail(const Status& status);

// Cells a terminal needs for UTF-8 `text` (code points; no wide characters are used).
int DisplayWidth(std::string_view text);
std::string FormatSeconds(double seconds);  // "0.8 s", "12 s", "3 min 05 s", "2 h 10 min"

}  // namespace rg::cli
