// The mapping of an import: which field of which topic (or which column of a CSV) becomes which column of
// the recording. A JSON file, "realitygrad.import_map/1"; deploy/examples/import_map.schema.json is its
// schema, and deploy/examples holds two examples.
//
//   {"format": "realitygrad.import_map/1",
//    "columns": [{"topic": "/joint_states", "field": "position[*]", "joint": "*", "column": "position"},
//                {"topic": "/driver/in/joint_torque", "field": ["joint1", "joint2"],
//                 "joint": ["joint_1", "joint_2"], "column": "effort_command", "unit": "N*m", "clock":
//                 "log"}],
//    "manifest": {"effort_excludes_gravity": true}}
//
// A column's value is raw · unit · scale + offset, in SI.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "services/importing/units.h"

namespace rg::importing {

inline constexpr char kImportMapFormat[] = "realitygrad.import_map/1";

enum class Hold { kLinear, kZeroOrder };

// One entry of "columns". In a CSV, topics are empty and fields are the header's names.
struct MapEntry {
  std::string topic;
  std::vector<std::string> fields;  // one; or several, of as many joints. "[*]": see joints
  // "*": every joint of the robot that the message names. With one field "x[*]" and several joints, the
  // elements of these names, or, in a message without names, in this order. Empty: a column of no joint.
  std::vector<std::string> joints;
  std::string column;        // "position", "velocity", "effort_command", "effort_measured", or any other kind
  std::optional<Unit> unit;  // none: SI
  double scale = 1.0;
  double offset = 0.0;       // SI
  std::string clock;         // "header", "log", a field that holds a time; empty: header where there is one
  std::optional<Hold> hold;  // none: zero order for effort_command and references, linear for the rest
  std::string note;          // anybody's words
};

struct TimeColumn {
  std::string column;
  std::string unit = "s";  // s, ms, us, ns
};

struct ImportMap {
  std::string note;
  std::optional<TimeColumn> time;  // of a CSV
  std::vector<MapEntry> entries;
  std::string manifest_json = "{}";  // what goes into the set's manifest as it is: gravity, noise, locked, …
};

// Errors name the source and the field: "map.json: columns[2].unit: unit 'grad' is not known (rad, …)".
Result<ImportMap> ParseImportMap(std::string_view text, const std::string& source_name);
std::string FormatImportMap(const ImportMap& map);

// "s", "ms", "us", "ns" in nanoseconds; 0: not known.
double TimeUnitNs(const std::string& unit);

// Zero order for effort_command and for what ends in _reference or _command.
Hold HoldOf(const MapEntry& entry);

// Keys of an entry and of the file, for the test that compares them with the schema.
std::vector<std::string> MapKeys();
std::vector<std::string> MapEntryKeys();

}  // namespace rg::importing
