#include "common/recordings/csv_header.h"

#include <algorithm>

#include "common/base/number_text.h"
#include "common/recordings/csv_advice.h"

namespace rg::recordings {
namespace {

constexpr const char* kHowToPrescribe = " (\"prescribed\" in the manifest: it moves as measured)";
constexpr const char* kKindNames[] = {"time", "position", "velocity", "effort_command", "effort_measured"};

const std::set<std::string, std::less<>>& KindsOfJoints() {
  static const std::set<std::string, std::less<>> kinds = {
      "position",      "velocity",      "effort_command",     "effort_measured",
      "motor_current", "torque_sensor", "position_reference", "temperature"};
  return kinds;
}

CsvKind KindOf(std::string_view prefix) {
  for (int i = 1; i <= 4; ++i) {
    if (prefix == kKindNames[i]) return static_cast<CsvKind>(i);
  }
  return CsvKind::kOther;
}

// Each step returns the first thing wrong.
class HeaderReader {
 public:
  HeaderReader(std::string_view text, const std::string& source, const CsvOptions& options,
               const std::set<std::string>& ignored, std::optional<CsvText>* lines)
      : text_(text), source_(source), options_(options), ignored_(ignored), lines_(lines) {}

  Result<CsvHeader> Read() {
    RG_RETURN_IF_ERROR(ChooseDialect());
    RG_RETURN_IF_ERROR(ReadHeader());
    RG_RETURN_IF_ERROR(ChooseJoints());
    RG_RETURN_IF_ERROR(ChooseKinds());
    return std::move(out_);
  }

 private:
  Status Error(const std::string& what) const { return InvalidError(source_ + ": " + what); }
  void Note(const std::string& what) { out_.notes.push_back(what); }
  CsvText& Lines() const { return **lines_; }

  Status ChooseDialect() {
    const std::string other = OtherFormatOf(text_);
    if (!other.empty()) return Error(other);
    out_.dialect = options_.dialect.value_or(CsvDialect{GuessSeparator(text_), false});
    lines_->emplace(text_, out_.dialect.separator);
    return Status::Ok();
  }

  Status ReadHeader() {
    if (Lines().AtEnd()) return Error("the file is empty");
    std::vector<std::string_view> names;
    do {
      if (!Lines().Next(&names))
        return Lines().status().ok() ? Error("the file is empty") : Error(Lines().status().message());
    } while (names.empty());
    header_line_ = Lines().line();
    if (Lines().header_was_comment()) Note("the header begins as a comment, whose mark was taken off");
    while (names.size() > 1 && names.back().empty()) names.pop_back();  // separators at the line's end
    if (std::all_of(names.begin(), names.end(), IsNumber))
      return Error("row 0 (line " + std::to_string(header_line_) +
                   "): the first line holds numbers, the header is missing");
    std::set<std::string> seen;
    for (const std::string_view name : names) RG_RETURN_IF_ERROR(AddColumn(name, &seen));
    if (!seen.count("time")) return NoTime();
    return CheckDecimals();
  }

  std::string HeaderName() const { return "header (line " + std::to_string(header_line_) + ")"; }

  Status NoTime() const {
    return Error("row 0 (line " + std::to_string(header_line_) + "): the header has no column time" +
                 NoTimeAdvice(Names()));
  }

  std::vector<std::string> Names() const {
    std::vector<std::string> names;
    for (const CsvColumn& column : out_.columns) names.push_back(column.name);
    return names;
  }

  // Fields by semicolons or tabs with decimal commas are read only where somebody says so.
  Status CheckDecimals() {
    if (options_.dialect || out_.dialect.separator == ',') return Status::Ok();
    CsvText ahead = **lines_;
    std::vector<std::string_view> fields;
    double value = 0.0;
    for (int row = 0; row < 20 && ahead.Next(&fields); ++row) {
      for (const std::string_view field : fields) {
        if (std::count(field.begin(), field.end(), ',') != 1) continue;
        if (ParseNumber(field, &value) == NumberText::kOk ||
            ParseNumber(WithPoint(field), &value) != NumberText::kOk)
          continue;
        const std::string name = out_.dialect.separator == ';' ? "semicolon" : "tab";
        return Error("line " + std::to_string(ahead.line()) + ": " + ShownField(field) +
                     ": fields are separated by " + name +
                     "s and numbers have decimal commas: read it with --csv-dialect " + name +
                     ", or convert it: tr ',' '.' < FILE | tr '" +
                     (out_.dialect.separator == ';' ? ";" : "\\t") + "' ',' > NEW");
      }
    }
    Note(std::string("fields are separated by ") + (out_.dialect.separator == ';' ? "semicolons" : "tabs"));
    return Status::Ok();
  }

  Status AddColumn(std::string_view name, std::set<std::string>* seen) {
    const std::string place = HeaderName() + ", column " + std::to_string(out_.columns.size() + 1);
    if (name.empty()) {  // as the index that pandas writes
      out_.columns.emplace_back().is_nameless = true;
      Note("column " + std::to_string(out_.columns.size()) + " has no name: left alone");
      return Status::Ok();
    }
    if (std::any_of(name.begin(), name.end(), [](unsigned char c) { return c < ' ' || c == 0x7F; }))
      return Error(place + ": the name " + ShownField(name) + " holds line ends or other control characters");
    CsvColumn column;
    column.name = std::string(name);
    if (!seen->insert(column.name).second) return Error(place + ": " + column.name + " is there twice");
    const size_t dot = name.find('.');
    const std::string_view prefix = name.substr(0, dot);
    if (name == "time") {
      column.kind = CsvKind::kTime;
    } else if (ignored_.count(column.name) > 0) {
      column.kind = CsvKind::kOther;
    } else if (dot != std::string_view::npos && KindsOfJoints().count(prefix)) {
      column.kind = KindOf(prefix);
      column.joint = std::string(name.substr(dot + 1));
      if (!options_.robot.empty() && !RobotHas(column.joint)) {
        return Error(place + ": " + column.name + ": the robot has no joint " + ShownField(column.joint) +
                     UnknownJointAdvice(column.joint, JointNames()));
      }
    }
    out_.columns.push_back(std::move(column));
    return Status::Ok();
  }

  std::vector<std::string> JointNames() const {
    std::vector<std::string> names;
    for (const JointInfo& info : options_.robot) names.push_back(info.name);
    return names;
  }

  bool RobotHas(const std::string& joint) const {
    return std::any_of(options_.robot.begin(), options_.robot.end(),
                       [&](const JointInfo& info) { return info.name == joint; });
  }

  Status ChooseJoints() {
    out_.joints = options_.joints;
    if (out_.joints.empty()) {
      for (const CsvColumn& column : out_.columns) {
        if (column.kind == CsvKind::kPosition) out_.joints.push_back(column.joint);
      }
    }
    if (out_.joints.empty()) return Error(HeaderName() + ": no column position.<joint>");
    for (const std::string& joint : out_.joints) {
      if (!out_.Find(CsvKind::kPosition, joint)) {
        return Error(
            HeaderName() + ": column position." + joint + " is missing" +
            MissingColumnAdvice(Names(), joint, {"pos", "q", "angle", "actual"}, "position." + joint,
                                "; leave the joint out of the manifest's joints if it was not recorded"));
      }
    }
    return Status::Ok();
  }

  // A kind is there for all the joints or for none of them, prescribed joints aside.
  Status ChooseKinds() {
    ChoosePrescribed();
    for (const CsvKind kind : {CsvKind::kVelocity, CsvKind::kEffortCommand, CsvKind::kEffortMeasured}) {
      std::string missing;
      int there = 0;
      for (const std::string& joint : out_.joints) {
        if (out_.prescribed.count(joint) > 0) continue;
        if (out_.Find(kind, joint)) {
          ++there;
        } else if (missing.empty()) {
          missing = joint;
        }
      }
      const std::string name = kKindNames[static_cast<int>(kind)];
      if (there > 0 && !missing.empty()) {
        return Error(HeaderName() + ": column " + name + "." + missing + " is missing, other joints have " +
                     name +
                     (kind == CsvKind::kVelocity ? "; give it, or leave all of them out" : kHowToPrescribe));
      }
      out_.has[static_cast<int>(kind)] = there > 0;
    }
    if (options_.require_effort && !out_.Has(CsvKind::kEffortCommand) &&
        !out_.Has(CsvKind::kEffortMeasured)) {
      return Error(HeaderName() + NoEffort());
    }
    return Status::Ok();
  }

  std::string NoEffort() const {
    for (const CsvColumn& column : out_.columns) {
      for (const char* commanded : {"position_reference.", "position_command.", "position_desired."}) {
        if (column.name.rfind(commanded, 0) == 0)
          return ": positions are commanded (" + column.name +
                 ") and no effort is recorded: position-commanded drives are not modelled yet; record "
                 "effort_command.<joint> or effort_measured.<joint>";
      }
    }
    const std::string advice =
        MissingColumnAdvice(Names(), out_.joints[0], {"effort", "torque", "tau", "force", "u", "cmd"},
                            "effort_command." + out_.joints[0] + " or effort_measured." + out_.joints[0], "");
    return ": no effort: neither effort_command.<joint> nor effort_measured.<joint>" +
           (advice.empty() ? "; without one nothing can be told of forces" : advice);
  }

  void ChoosePrescribed() {
    const auto driven = [&](const std::string& joint) {
      return out_.Find(CsvKind::kEffortCommand, joint) || out_.Find(CsvKind::kEffortMeasured, joint);
    };
    const bool any = std::any_of(out_.joints.begin(), out_.joints.end(), driven);
    for (const std::string& joint : out_.joints) {
      const auto& named = options_.prescribed;
      if (named ? std::find(named->begin(), named->end(), joint) != named->end() : any && !driven(joint))
        out_.prescribed.insert(joint);
    }
    // What a file says of an effort that drives nothing is one more column.
    for (CsvColumn& column : out_.columns) {
      if (column.kind < CsvKind::kEffortCommand || out_.prescribed.count(column.joint) == 0) continue;
      column.kind = CsvKind::kOther, column.joint.clear();
    }
  }

  std::string_view text_;
  const std::string& source_;
  const CsvOptions& options_;
  const std::set<std::string>& ignored_;
  std::optional<CsvText>* lines_;
  int header_line_ = 1;
  CsvHeader out_;
};

}  // namespace

CsvColumn* CsvHeader::Find(CsvKind kind, const std::string& joint) {
  for (CsvColumn& column : columns) {
    if (column.kind == kind && column.joint == joint) return &column;
  }
  return nullptr;
}

Result<CsvHeader> ReadCsvHeader(std::string_view text, const std::string& source, const CsvOptions& options,
                                const std::set<std::string>& ignored, std::optional<CsvText>* lines) {
  return HeaderReader(text, source, options, ignored, lines).Read();
}

}  // namespace rg::recordings
