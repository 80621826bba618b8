#include "common/recordings/csv.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <set>

#include "common/base/file.h"
#include "common/recordings/prescribed.h"

namespace rg::recordings {
namespace {

constexpr int kTooFewRowsToJudgeDigits = 20;
constexpr const char* kHowToPrescribe = " (\"prescribed\" in the manifest: it moves as measured)";

std::string_view Trim(std::string_view field) {
  while (!field.empty() && (field.front() == ' ' || field.front() == '\t')) field.remove_prefix(1);
  while (!field.empty() && (field.back() == ' ' || field.back() == '\t' || field.back() == '\r')) {
    field.remove_suffix(1);
  }
  return field;
}

// A piece of an untrusted file for a message: short and printable.
std::string Shown(std::string_view field) {
  std::string shown = "'";
  for (const char c : field.substr(0, 40)) shown += (c >= ' ' && c <= '~') ? c : '?';
  if (field.size() > 40) shown += "...";
  return shown + "'";
}

enum class Kind { kTime, kPosition, kVelocity, kEffortCommand, kEffortMeasured, kOther };
constexpr const char* kKindNames[] = {"time", "position", "velocity", "effort_command", "effort_measured"};

const std::set<std::string, std::less<>>& KindsOfJoints() {
  static const std::set<std::string, std::less<>> kinds = {
      "position",      "velocity",      "effort_command",     "effort_measured",
      "motor_current", "torque_sensor", "position_reference", "temperature"};
  return kinds;
}

struct Column {
  std::string name;
  Kind kind = Kind::kOther;
  std::string joint;      // of the known kinds
  double* out = nullptr;  // where row 0 goes; null: ignored
  Eigen::Index stride = 1;
  bool is_text = false;  // an other column that holds something else than numbers
};

Kind KindOf(std::string_view prefix) {
  for (int i = 1; i <= 4; ++i) {
    if (prefix == kKindNames[i]) return static_cast<Kind>(i);
  }
  return Kind::kOther;
}

// One parse: header, layout, rows, checks. Each step returns the first thing wrong.
class CsvParser {
 public:
  CsvParser(std::string_view text, const std::string& source, const CsvOptions& options)
      : text_(text), source_(source), options_(options) {}

  Result<Recording> Parse() {
    RG_RETURN_IF_ERROR(ReadHeader());
    RG_RETURN_IF_ERROR(ChooseJoints());
    RG_RETURN_IF_ERROR(ChooseKinds());
    Allocate();
    RG_RETURN_IF_ERROR(ReadRows());
    RG_RETURN_IF_ERROR(CheckLastRowIsWhole());
    Finish();
    RG_RETURN_IF_ERROR(CheckUnits(recording_, options_.robot));
    return std::move(recording_);
  }

 private:
  Status Error(const std::string& what) const { return InvalidError(source_ + ": " + what); }
  // Data row `row` counts from 0 inside and from 1 for people.
  std::string RowName(Eigen::Index row) const {
    return "row " + std::to_string(row + 1) + " (line " + std::to_string(row + 2) + ")";
  }
  Status FieldError(Eigen::Index row, const Column& column, const std::string& what) const {
    return Error(RowName(row) + ", column " + column.name + ": " + what);
  }

  std::string_view NextLine(bool* terminated) {
    const size_t end = text_.find('\n', at_);
    *terminated = end != std::string_view::npos;
    const std::string_view line = text_.substr(at_, *terminated ? end - at_ : std::string_view::npos);
    at_ = *terminated ? end + 1 : text_.size();
    return line;
  }

  Status ReadHeader() {
    if (text_.substr(0, 3) == "\xEF\xBB\xBF") text_.remove_prefix(3);
    if (text_.find_first_not_of(" \t\r\n") == std::string_view::npos) return Error("the file is empty");
    bool terminated = false;
    std::string_view line = NextLine(&terminated);
    std::set<std::string> seen;
    while (true) {
      const size_t comma = line.find(',');
      RG_RETURN_IF_ERROR(AddColumn(Trim(line.substr(0, comma)), &seen));
      if (comma == std::string_view::npos) break;
      line.remove_prefix(comma + 1);
    }
    if (!seen.count("time")) return Error("row 0 (line 1): the header has no column time");
    return Status::Ok();
  }

  Status AddColumn(std::string_view name, std::set<std::string>* seen) {
    if (name.size() >= 2 && name.front() == '"' && name.back() == '"') {
      name = name.substr(1, name.size() - 2);
    }
    const std::string place = "header (line 1), column " + std::to_string(columns_.size() + 1);
    if (name.empty()) return Error(place + ": has no name");
    Column column;
    column.name = std::string(name);
    if (!seen->insert(column.name).second) return Error(place + ": " + column.name + " is there twice");
    const size_t dot = name.find('.');
    const std::string_view prefix = name.substr(0, dot);
    if (name == "time") {
      column.kind = Kind::kTime;
    } else if (dot != std::string_view::npos && KindsOfJoints().count(prefix)) {
      column.kind = KindOf(prefix);
      column.joint = std::string(name.substr(dot + 1));
      if (!options_.robot.empty() && !RobotHas(column.joint)) {
        return Error(place + ": " + column.name + ": the robot has no joint " + Shown(column.joint));
      }
    }
    columns_.push_back(std::move(column));
    return Status::Ok();
  }

  bool RobotHas(const std::string& joint) const {
    return std::any_of(options_.robot.begin(), options_.robot.end(),
                       [&](const JointInfo& info) { return info.name == joint; });
  }

  Column* Find(Kind kind, const std::string& joint) {
    for (Column& column : columns_) {
      if (column.kind == kind && column.joint == joint) return &column;
    }
    return nullptr;
  }

  Status ChooseJoints() {
    joints_ = options_.joints;
    if (joints_.empty()) {
      for (const Column& column : columns_) {
        if (column.kind == Kind::kPosition) joints_.push_back(column.joint);
      }
    }
    if (joints_.empty()) return Error("header (line 1): no column position.<joint>");
    for (const std::string& joint : joints_) {
      if (!Find(Kind::kPosition, joint)) {
        return Error("header (line 1): column position." + joint + " is missing");
      }
    }
    return Status::Ok();
  }

  // A kind is there for all the joints or for none of them, prescribed joints aside.
  Status ChooseKinds() {
    ChoosePrescribed();
    for (const Kind kind : {Kind::kVelocity, Kind::kEffortCommand, Kind::kEffortMeasured}) {
      std::string missing;
      int there = 0;
      for (const std::string& joint : joints_) {
        if (prescribed_.count(joint) > 0) continue;
        if (Find(kind, joint)) {
          ++there;
        } else if (missing.empty()) {
          missing = joint;
        }
      }
      const std::string name = kKindNames[static_cast<int>(kind)];
      if (there > 0 && !missing.empty()) {
        return Error("header (line 1): column " + name + "." + missing + " is missing, other joints have " +
                     name + (kind == Kind::kVelocity ? "" : kHowToPrescribe));
      }
      has_[static_cast<int>(kind)] = there > 0;
    }
    if (options_.require_effort && !has_[static_cast<int>(Kind::kEffortCommand)] &&
        !has_[static_cast<int>(Kind::kEffortMeasured)]) {
      return Error("header (line 1): no effort: neither effort_command.<joint> nor effort_measured.<joint>");
    }
    return Status::Ok();
  }

  void ChoosePrescribed() {
    const auto driven = [&](const std::string& joint) {
      return Find(Kind::kEffortCommand, joint) || Find(Kind::kEffortMeasured, joint);
    };
    const bool any = std::any_of(joints_.begin(), joints_.end(), driven);
    for (const std::string& joint : joints_) {
      const auto& named = options_.prescribed;
      if (named ? std::find(named->begin(), named->end(), joint) != named->end() : any && !driven(joint))
        prescribed_.insert(joint);
    }
    // What a file says of an effort that drives nothing is one more column.
    for (Column& column : columns_) {
      if (column.kind < Kind::kEffortCommand || prescribed_.count(column.joint) == 0) continue;
      column.kind = Kind::kOther, column.joint.clear();
    }
  }

  void Allocate() {
    const auto lines = std::count(text_.begin() + static_cast<std::ptrdiff_t>(at_), text_.end(), '\n') + 1;
    const auto n = static_cast<Eigen::Index>(joints_.size());
    Recording& r = recording_;
    r.t.resize(lines);
    r.q.resize(n, lines);
    if (has_[static_cast<int>(Kind::kVelocity)]) r.v.resize(n, lines);
    if (has_[static_cast<int>(Kind::kEffortCommand)]) r.effort_command.resize(n, lines);
    if (has_[static_cast<int>(Kind::kEffortMeasured)]) r.effort_measured.resize(n, lines);
    const auto point = [&](Kind kind, Eigen::MatrixXd& x) {
      for (Eigen::Index i = 0; x.size() > 0 && i < n; ++i) {
        Column* column = Find(kind, joints_[static_cast<size_t>(i)]);
        if (column == nullptr) {  // of a prescribed joint
          x.row(i).setZero();
          continue;
        }
        column->out = &x(i, 0);
        column->stride = n;
      }
    };
    point(Kind::kPosition, r.q);
    point(Kind::kVelocity, r.v);
    point(Kind::kEffortCommand, r.effort_command);
    point(Kind::kEffortMeasured, r.effort_measured);
    for (Column& column : columns_) {
      if (column.kind == Kind::kTime) column.out = r.t.data();
      if (column.kind != Kind::kOther) continue;
      Eigen::VectorXd& values = r.other[column.name];
      values.resize(lines);
      column.out = values.data();
    }
  }

  Status ReadRows() {
    while (at_ < text_.size()) {
      last_line_ = NextLine(&last_terminated_);
      if (Trim(last_line_).empty()) {
        if (text_.find_first_not_of(" \t\r\n", at_) == std::string_view::npos) break;
        return Error(RowName(rows_) + ": the line is empty");
      }
      RG_RETURN_IF_ERROR(ReadRow(last_line_));
      ++rows_;
    }
    if (rows_ == 0) return Error("no rows under the header");
    if (rows_ == 1) return Error("only one row under the header");
    return Status::Ok();
  }

  Status ReadRow(std::string_view line) {
    size_t fields = 0;
    const char* at = line.data();
    const char* const end = at + line.size();
    while (true) {
      const auto* comma = static_cast<const char*>(std::memchr(at, ',', static_cast<size_t>(end - at)));
      const char* const stop = comma ? comma : end;
      if (fields < columns_.size()) {
        RG_RETURN_IF_ERROR(ReadField(columns_[fields], {at, static_cast<size_t>(stop - at)}));
      }
      ++fields;
      if (!comma) break;
      at = comma + 1;
    }
    if (fields != columns_.size()) return WrongFieldCount(fields);
    if (rows_ > 0 && !(recording_.t[rows_] > recording_.t[rows_ - 1])) return TimeError();
    return Status::Ok();
  }

  bool IsLastLine() const { return text_.find_first_not_of(" \t\r\n", at_) == std::string_view::npos; }

  Status WrongFieldCount(size_t fields) const {
    const std::string counts =
        std::to_string(fields) + " of " + std::to_string(columns_.size()) + " fields are there";
    if (fields > columns_.size()) {
      return Error(RowName(rows_) + ", column " + std::to_string(columns_.size() + 1) + ": " + counts);
    }
    return Error(RowName(rows_) + ", column " + columns_[fields].name + ": " +
                 (IsLastLine() ? "the last row is truncated: " : "") + counts);
  }

  Status TimeError() const {
    const double now = recording_.t[rows_], before = recording_.t[rows_ - 1];
    return Error(RowName(rows_) +
                 ", column time: " + (now == before ? "time repeats: " : "time goes back: ") + Number(now) +
                 " after " + Number(before));
  }

  static std::string Number(double value) {
    char buffer[32];
    const auto end = std::to_chars(buffer, buffer + sizeof buffer, value);
    return std::string(buffer, end.ptr);
  }

  Status ReadField(Column& column, std::string_view raw) {
    if (!column.out) return Status::Ok();
    std::string_view field = Trim(raw);
    if (!field.empty() && field.front() == '+') field.remove_prefix(1);
    double value = 0.0;
    const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), value);
    const bool is_number = error == std::errc() && end == field.data() + field.size();
    if (column.kind == Kind::kOther) {
      if (!is_number && !field.empty()) column.is_text = true;
      value = is_number ? value : std::nan("");
    } else if (!is_number) {
      return BadField(column, field, error == std::errc::result_out_of_range);
    } else if (!std::isfinite(value)) {
      return FieldError(rows_, column, std::isnan(value) ? "NaN" : "not finite: " + Shown(field));
    }
    column.out[rows_ * column.stride] = value;
    return Status::Ok();
  }

  Status BadField(const Column& column, std::string_view field, bool out_of_range) const {
    if (!last_terminated_ && &column == &columns_.back()) {
      return FieldError(rows_, column, "the last row is truncated at " + Shown(field));
    }
    if (field.empty()) return FieldError(rows_, column, "the field is empty");
    return FieldError(rows_, column,
                      (out_of_range ? "out of a double's range: " : "not a number: ") + Shown(field));
  }

  // A file that ends inside its last number still reads as a number. It gives itself away where that
  // number has fewer digits than all others of its column.
  Status CheckLastRowIsWhole() const {
    if (last_terminated_ || rows_ < kTooFewRowsToJudgeDigits) return Status::Ok();
    const auto last_field = [](std::string_view line) { return Trim(line.substr(line.rfind(',') + 1)); };
    const std::string_view field = last_field(last_line_);
    const size_t digits = CountDigits(field);
    size_t fewest = std::string_view::npos;
    std::string_view body = text_.substr(0, static_cast<size_t>(last_line_.data() - text_.data()));
    body.remove_prefix(body.find('\n') + 1);
    while (!body.empty()) {
      const size_t end = body.find('\n');
      fewest = std::min(fewest, CountDigits(last_field(body.substr(0, end))));
      body.remove_prefix(end == std::string_view::npos ? body.size() : end + 1);
    }
    if (digits >= fewest && std::isdigit(static_cast<unsigned char>(field.empty() ? '0' : field.back()))) {
      return Status::Ok();
    }
    return FieldError(rows_ - 1, columns_.back(),
                      "the last row is truncated: no end of line, and " + Shown(field) +
                          " has fewer digits than any other row");
  }

  static size_t CountDigits(std::string_view field) {
    size_t digits = 0;
    for (const char c : field) digits += c >= '0' && c <= '9';
    return digits;
  }

  void Finish() {
    Recording& r = recording_;
    r.name = source_;
    r.joints = joints_;
    r.t.conservativeResize(rows_);
    for (Eigen::MatrixXd* x : {&r.q, &r.v, &r.effort_command, &r.effort_measured}) {
      if (x->size() > 0) x->conservativeResize(Eigen::NoChange, rows_);
    }
    for (const Column& column : columns_) {
      if (column.kind != Kind::kOther) continue;
      if (column.is_text) {
        r.other.erase(column.name);
      } else {
        r.other[column.name].conservativeResize(rows_);
      }
    }
    for (size_t i = 0; i < joints_.size(); ++i) {
      if (prescribed_.count(joints_[i]) == 0) continue;
      r.prescribed.push_back(static_cast<int>(i));
      if (r.has_velocity() && !Find(Kind::kVelocity, joints_[i]))
        r.without_velocity.push_back(static_cast<int>(i));
    }
    FillVelocities(&r);
    r.drive =
        r.has_effort_command() || !r.has_effort_measured() ? EffortKind::kCommand : EffortKind::kMeasured;
  }

  std::string_view text_;
  const std::string& source_;
  const CsvOptions& options_;
  size_t at_ = 0;
  std::vector<Column> columns_;
  std::vector<std::string> joints_;
  std::set<std::string> prescribed_;
  bool has_[6] = {};
  Eigen::Index rows_ = 0;
  std::string_view last_line_;
  bool last_terminated_ = true;
  Recording recording_;
};

void AppendNumber(std::string* out, double value, int digits) {
  char buffer[40];
  const auto end =
      digits > 0 ? std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::general, digits)
                 : std::to_chars(buffer, buffer + sizeof buffer, value);
  out->append(buffer, end.ptr);
}

}  // namespace

Result<Recording> ParseCsv(std::string_view text, const std::string& source_name, const CsvOptions& options) {
  return CsvParser(text, source_name, options).Parse();
}

Result<Recording> LoadCsv(const std::string& path, const CsvOptions& options) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return ParseCsv(text, path, options);
}

std::string FormatCsv(const Recording& r, int digits) {
  std::string out = "time";
  const std::pair<const char*, const Eigen::MatrixXd*> kinds[] = {{"position", &r.q},
                                                                  {"velocity", &r.v},
                                                                  {"effort_command", &r.effort_command},
                                                                  {"effort_measured", &r.effort_measured}};
  const auto written = [&](const Eigen::MatrixXd* x, Eigen::Index i) {
    if (x == &r.v) {
      const auto& without = r.without_velocity;
      return std::find(without.begin(), without.end(), i) == without.end();
    }
    return x == &r.q || !r.IsPrescribed(static_cast<int>(i));
  };
  for (const auto& [kind, x] : kinds) {
    for (Eigen::Index i = 0; i < x->rows(); ++i) {
      if (written(x, i)) out += std::string(",") + kind + "." + r.joints[static_cast<size_t>(i)];
    }
  }
  for (const auto& [name, column] : r.other) out += "," + name;
  out += '\n';
  for (int k = 0; k < r.rows(); ++k) {
    AppendNumber(&out, r.t[k], 0);
    for (const auto& [kind, x] : kinds) {
      for (Eigen::Index i = 0; i < x->rows(); ++i) {
        if (!written(x, i)) continue;
        out += ',';
        AppendNumber(&out, (*x)(i, k), digits);
      }
    }
    for (const auto& [name, column] : r.other) {
      out += ',';
      if (!std::isnan(column[k])) AppendNumber(&out, column[k], digits);
    }
    out += '\n';
  }
  return out;
}

Status WriteCsv(const std::string& path, const Recording& recording, int digits) {
  return WriteFileAtomically(path, FormatCsv(recording, digits));
}

}  // namespace rg::recordings
