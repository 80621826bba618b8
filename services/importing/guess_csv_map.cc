#include <algorithm>
#include <cctype>
#include <cmath>
#include <map>
#include <optional>

#include "services/importing/guess_map.h"
#include "services/importing/name_words.h"

namespace rg::importing {
namespace {

// What a column's name says beside the joint's.
std::string KindOfName(const std::string& name) {
  const std::vector<std::string> words = Words(name);
  const bool command = IsCommand(name);
  const auto is = [&](std::initializer_list<const char*> some) { return HasWord(words, some); };
  if (is({"effort", "efforts", "torque", "torques", "tau", "trq"}))
    return command || is({"commanded"}) ? "effort_command" : "effort_measured";
  if (command || is({"error", "acceleration", "acc", "ddq", "stamp", "time"})) return "";
  if (is({"velocity", "velocities", "vel", "dq", "qd", "qdot", "speed", "omega"})) return "velocity";
  if (is({"position", "positions", "pos", "q", "angle", "angles", "theta"})) return "position";
  return "";
}

// The name without the joint's, if the joint's is in it between other signs than letters and digits.
std::optional<std::string> Without(const std::string& name, const std::string& joint) {
  const auto letter = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0; };
  for (size_t at = name.find(joint); at != std::string::npos; at = name.find(joint, at + 1)) {
    const size_t end = at + joint.size();
    if ((at > 0 && letter(name[at - 1])) || (end < name.size() && letter(name[end]))) continue;
    return name.substr(0, at) + " " + name.substr(end);
  }
  return std::nullopt;
}

// "q_3", "tau4", "position[2]": a name that ends in a number.
std::optional<std::pair<std::string, int>> Numbered(const std::string& name) {
  size_t end = name.size();
  while (end > 0 && (name[end - 1] == ']' || name[end - 1] == ')')) --end;
  size_t start = end;
  while (start > 0 && std::isdigit(static_cast<unsigned char>(name[start - 1])) != 0) --start;
  if (start == end || end - start > 3) return std::nullopt;
  return std::pair{name.substr(0, start), std::stoi(name.substr(start, end - start))};
}

class CsvGuesser {
 public:
  CsvGuesser(const std::vector<std::string>& header, const std::string& csv_name,
             const std::vector<RobotJoint>& robot)
      : header_(header), csv_name_(csv_name), robot_(robot) {}

  Result<GuessedMap> Guess(const std::vector<double>& first_times) {
    RG_RETURN_IF_ERROR(TakeTime(first_times));
    TakeNamed();
    if (!by_kind_.contains("position")) TakeNumbered();
    RG_RETURN_IF_ERROR(Check());
    for (auto& [kind, columns] : by_kind_) AddEntry(kind, columns);
    return std::move(out_);
  }

 private:
  void Say(const std::string& reason) { out_.reasons.push_back(reason); }
  void Ask(const std::string& question) { out_.questions.push_back(question); }

  Status TakeTime(const std::vector<double>& first_times) {
    const size_t column = FindTimeColumn(header_);
    if (column == header_.size())
      return InvalidError(csv_name_ +
                          ": header (line 1): no column is a time by its name (time, __time, t, timestamp, "
                          "stamp): say \"time\": {\"column\": …} in a mapping");
    out_.map.time = TimeColumn{header_[column], TimeUnitOf(header_[column], first_times)};
    if (out_.map.time->unit.empty()) out_.map.time->unit = "s";
    Say(header_[column] + ": the time, in " + out_.map.time->unit);
    if (out_.map.time->unit != "s")
      Ask("column " + header_[column] + " looks like " + out_.map.time->unit + ", not seconds");
    return Status::Ok();
  }

  void TakeNamed() {
    for (const std::string& name : header_) {
      if (name == out_.map.time->column) continue;
      const RobotJoint* best = nullptr;
      std::string rest;
      for (const RobotJoint& joint : robot_) {
        const auto without = Without(name, joint.name);
        if (!without || (best != nullptr && best->name.size() >= joint.name.size())) continue;
        best = &joint;
        rest = *without;
      }
      if (best == nullptr) continue;
      const std::string kind = KindOfName(rest);
      if (kind.empty() && IsCommand(rest) && Contains(rest, {"pos", "angle"})) position_commands_ = name;
      if (!kind.empty()) Take(kind, best->name, name);
    }
  }

  void Take(const std::string& kind, const std::string& joint, const std::string& name) {
    const auto [at, is_new] = by_kind_[kind].emplace(joint, name);
    if (!is_new) Ask("columns " + at->second + " and " + name + " both look like " + kind + " of " + joint);
    if (Contains(name, {"deg"})) Ask("column " + name + " looks like degrees");
  }

  // Names that end in numbers, as many as the robot has joints: its order is assumed.
  void TakeNumbered() {
    std::map<std::string, std::map<int, std::string>> groups;
    for (const std::string& name : header_) {
      const auto numbered = Numbered(name);
      if (numbered && !KindOfName(numbered->first).empty()) groups[numbered->first][numbered->second] = name;
    }
    for (const auto& [stem, columns] : groups) {
      const int first = columns.begin()->first, last = columns.rbegin()->first;
      if (columns.size() != robot_.size() || first > 1 ||
          last - first + 1 != static_cast<int>(columns.size()))
        continue;
      const std::string kind = KindOfName(stem);
      if (by_kind_.contains(kind)) {
        Ask("columns " + columns.begin()->second + " … look like " + kind + " too");
        continue;
      }
      size_t joint = 0;
      for (const auto& [number, name] : columns) Take(kind, robot_[joint++].name, name);
      Ask("columns " + columns.begin()->second + " … are numbered: the URDF's order of joints is assumed");
    }
  }

  Status Check() const {
    if (!by_kind_.contains("position")) {
      return InvalidError(csv_name_ +
                          ": header (line 1): no column holds a joint's name and position (the robot has " +
                          Joints() + "): write a mapping");
    }
    if (by_kind_.contains("effort_command") || by_kind_.contains("effort_measured")) return Status::Ok();
    if (!position_commands_.empty()) {
      return InvalidError(csv_name_ + ": holds position commands (" + position_commands_ +
                          ") and no effort: position-commanded drives are not modelled yet");
    }
    return InvalidError(csv_name_ +
                        ": no column holds a joint's name and effort (or torque): write a mapping");
  }

  std::string Joints() const {
    std::vector<std::string> names;
    for (const RobotJoint& joint : robot_) names.push_back(joint.name);
    return Joined(names);
  }

  void AddEntry(const std::string& kind, const std::map<std::string, std::string>& columns) {
    MapEntry entry;
    entry.column = kind;
    for (const RobotJoint& joint : robot_) {
      const auto column = columns.find(joint.name);
      if (column == columns.end()) continue;
      entry.fields.push_back(column->second);
      entry.joints.push_back(joint.name);
      if (!Contains(column->second, {"deg"}) || kind.rfind("effort", 0) == 0) continue;
      const auto unit = ParseUnit(kind == "position" ? "deg" : "deg/s");
      if (unit.ok()) entry.unit = *unit;
    }
    Say(Joined(entry.fields) + ": " + kind + " by their names");
    out_.map.entries.push_back(std::move(entry));
  }

  const std::vector<std::string>& header_;
  const std::string& csv_name_;
  const std::vector<RobotJoint>& robot_;
  GuessedMap out_;
  std::map<std::string, std::map<std::string, std::string>> by_kind_;  // kind -> joint -> column
  std::string position_commands_;
};

}  // namespace

Result<GuessedMap> GuessCsvMap(const std::vector<std::string>& header, const std::vector<double>& first_times,
                               const std::string& csv_name, const std::vector<RobotJoint>& robot) {
  return CsvGuesser(header, csv_name, robot).Guess(first_times);
}

size_t FindTimeColumn(const std::vector<std::string>& header) {
  for (const char* name : {"__time", "time", "t", "timestamp", "stamp", "time_s", "time [s]", "seconds",
                           "secs", "time_ns", "timestamp_ns", "time_us", "time_ms", "rosbagtimestamp"}) {
    for (size_t i = 0; i < header.size(); ++i) {
      if (Lower(header[i]) == name) return i;
    }
  }
  return header.size();
}

std::string TimeUnitOf(const std::string& column, const std::vector<double>& times) {
  const std::vector<std::string> words = Words(column);
  for (const char* unit : {"ns", "us", "ms"}) {
    if (HasWord(words, {unit})) return unit;
  }
  if (times.empty() || !std::isfinite(times[0])) return "s";
  // Seconds since 1970, or those in smaller units: between 2001 and 2286.
  for (const auto& [unit, per_second] : {std::pair{"s", 1.0}, {"ms", 1e3}, {"us", 1e6}, {"ns", 1e9}}) {
    if (times[0] >= 1e9 * per_second && times[0] < 1e10 * per_second) return unit;
  }
  std::vector<double> steps;
  for (size_t i = 1; i < times.size(); ++i) steps.push_back(times[i] - times[i - 1]);
  if (steps.empty()) return "s";
  std::nth_element(steps.begin(), steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2), steps.end());
  const double step = steps[steps.size() / 2];
  // Robots are recorded at between 5 Hz and 20 kHz.
  if (!(step > 0.0) || step < 0.5) return "s";
  if (step < 200.0) return "ms";
  return step < 200e3 ? "us" : "ns";
}

}  // namespace rg::importing
