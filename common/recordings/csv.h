// Recordings as CSV: a header and SI units,
//   time, position.<joint>…, velocity.<joint>…, effort_command.<joint>…, effort_measured.<joint>…
// velocity is optional, at least one kind of effort is there (unless the caller waives it), other
// columns are kept in Recording::other. A kind that is there is there for every joint, but for prescribed
// ones: those named by the caller, or, where it names none, those without any effort where others have one.
//
// Every refusal is one line that names file, row (of data, and line of the file), column and value:
// an empty file, a column twice or missing, a joint that the robot lacks, a field that is no number,
// NaN or infinity, time that repeats or goes back, a truncated last row, units that are visibly
// degrees or millimetres. CRLF and a UTF-8 byte order mark are accepted.
#pragma once

#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording.h"

namespace rg::recordings {

// What the reader wants to know of a joint of the robot, to tell names and units.
struct JointInfo {
  enum class Type { kRevolute, kContinuous, kPrismatic };
  std::string name;
  Type type = Type::kRevolute;
  double lower = -std::numeric_limits<double>::infinity();  // rad or m
  double upper = std::numeric_limits<double>::infinity();
  double velocity = std::numeric_limits<double>::infinity();  // rad/s or m/s
};

struct CsvOptions {
  // The joints wanted, in the order wanted; empty: those with a position column, in file order.
  std::vector<std::string> joints;
  // All joints of the robot. Empty: joint names and units are not checked.
  std::vector<JointInfo> robot;
  bool require_effort = true;
  // Of `joints`, those that move as measured; nothing: those without an effort column.
  std::optional<std::vector<std::string>> prescribed;
};

// `source_name` stands for the file in errors and becomes Recording::name. Recording::drive is the
// command where it is there.
Result<Recording> ParseCsv(std::string_view text, const std::string& source_name, const CsvOptions& options);
Result<Recording> LoadCsv(const std::string& path, const CsvOptions& options);

// Doubles are written with `digits` significant digits, or, with 0, with as few as read back exactly.
std::string FormatCsv(const Recording& recording, int digits = 0);
Status WriteCsv(const std::string& path, const Recording& recording, int digits = 0);

// Refuses angles that are visibly degrees and lengths that are visibly millimetres: far outside the
// joint's limits (or speeds far above its speed limit, or above 60 rad/s where none is declared) where
// a conversion would put them inside, or measured velocity 57.3 times the rate of the measured position
// (or the inverse). Many turns of a continuous joint are not refused, nor is a joint that is thrown beyond
// its limits and comes back, nor values that would hardly be a motion in the other unit, unless the joint
// lives there. Joints without an entry in `robot` are not checked.
Status CheckUnits(const Recording& recording, const std::vector<JointInfo>& robot);

}  // namespace rg::recordings
