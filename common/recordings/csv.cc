#include "common/recordings/csv.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>

#include "common/base/file.h"
#include "common/base/number_text.h"
#include "common/recordings/angles.h"
#include "common/recordings/csv_advice.h"
#include "common/recordings/csv_text.h"
#include "common/recordings/odd_values.h"
#include "common/recordings/prescribed.h"
#include "common/recordings/time_stamps.h"
#include "common/recordings/velocity_column.h"

namespace rg::recordings {
namespace {

constexpr int kTooFewRowsToJudgeDigits = 20;
constexpr int kLookedAhead = 20, kFewRepeats = 3;  // rows
constexpr const char* kTakeRowOut = "; take the row out, rows may be missing";
constexpr const char* kHowToPrescribe = " (\"prescribed\" in the manifest: it moves as measured)";

// A piece of an untrusted file for a message: short and printable.
std::string Shown(std::string_view field) {
  std::string shown = "'";
  for (const char c : field.substr(0, 40)) shown += (c >= ' ' && c <= '~') ? c : '?';
  if (field.size() > 40) shown += "...";
  return shown + "'";
}

bool IsNumber(std::string_view field) {
  double value = 0.0;
  return ParseNumber(field, &value) == NumberText::kOk;
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
  bool is_nameless = false;                   // not read
  bool is_text = false;                       // an other column that holds something else than numbers
  Eigen::Index blanks = 0, first_blank = -1;  // fields that are empty or NaN
  bool first_blank_is_nan = false;
  std::string first_blank_field;
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
  // `ignored`: columns, by name, that are as if they were not there.
  CsvParser(std::string_view text, const std::string& source, const CsvOptions& options,
            std::set<std::string> ignored)
      : text_(text), source_(source), options_(options), ignored_(std::move(ignored)) {}

  // Optional columns that Parse found empty or NaN throughout: they are to be ignored.
  const std::set<std::string>& blank_columns() const { return blank_columns_; }

  Result<Recording> Parse() {
    RG_RETURN_IF_ERROR(ChooseDialect());
    RG_RETURN_IF_ERROR(ReadHeader());
    RG_RETURN_IF_ERROR(ChooseJoints());
    RG_RETURN_IF_ERROR(ChooseKinds());
    Allocate();
    RG_RETURN_IF_ERROR(ReadRows());
    RG_RETURN_IF_ERROR(CheckLastRowIsWhole());
    RG_RETURN_IF_ERROR(FindBlankColumns());
    if (!blank_columns_.empty()) return Error("columns are empty");
    Finish();
    RG_RETURN_IF_ERROR(CheckSignals());
    return std::move(recording_);
  }

 private:
  Status Error(const std::string& what) const { return InvalidError(source_ + ": " + what); }
  // Data row `row` counts from 0 inside and from 1 for people.
  std::string RowName(Eigen::Index row) const {
    const int line = row < rows_ ? line_of_[static_cast<size_t>(row)] : lines_->line();
    return "row " + std::to_string(row + 1) + " (line " + std::to_string(line) + ")";
  }
  Status FieldError(Eigen::Index row, const Column& column, const std::string& what) const {
    return Error(RowName(row) + ", column " + column.name + ": " + what);
  }
  void Note(const std::string& what) { recording_.notes.push_back(what); }

  Status ChooseDialect() {
    const std::string other = OtherFormatOf(text_);
    if (!other.empty()) return Error(other);
    dialect_ = options_.dialect.value_or(CsvDialect{GuessSeparator(text_), false});
    lines_.emplace(text_, dialect_.separator);
    return Status::Ok();
  }

  Status ReadHeader() {
    if (lines_->AtEnd()) return Error("the file is empty");
    std::vector<std::string_view> names;
    do {
      if (!lines_->Next(&names)) return lines_->status().ok() ? Error("the file is empty") : Unclosed();
    } while (names.empty());
    header_line_ = lines_->line();
    if (lines_->header_was_comment()) Note("the header begins as a comment, whose mark was taken off");
    while (names.size() > 1 && names.back().empty()) names.pop_back();  // separators at the line's end
    if (std::all_of(names.begin(), names.end(), IsNumber))
      return Error("row 0 (line " + std::to_string(header_line_) +
                   "): the first line holds numbers, the header is missing");
    std::set<std::string> seen;
    for (const std::string_view name : names) RG_RETURN_IF_ERROR(AddColumn(name, &seen));
    if (!seen.count("time")) return NoTime();
    return CheckDecimals();
  }

  Status Unclosed() const { return Error(lines_->status().message()); }

  std::string HeaderName() const { return "header (line " + std::to_string(header_line_) + ")"; }

  Status NoTime() const {
    return Error("row 0 (line " + std::to_string(header_line_) + "): the header has no column time" +
                 NoTimeAdvice(Names()));
  }

  std::vector<std::string> Names() const {
    std::vector<std::string> names;
    for (const Column& column : columns_) names.push_back(column.name);
    return names;
  }

  // Fields by semicolons or tabs with decimal commas are read only where somebody says so.
  Status CheckDecimals() {
    if (options_.dialect || dialect_.separator == ',') return Status::Ok();
    CsvText ahead = *lines_;
    std::vector<std::string_view> fields;
    double value = 0.0;
    for (int row = 0; row < 20 && ahead.Next(&fields); ++row) {
      for (const std::string_view field : fields) {
        if (std::count(field.begin(), field.end(), ',') != 1) continue;
        if (ParseNumber(field, &value) == NumberText::kOk ||
            ParseNumber(WithPoint(field), &value) != NumberText::kOk)
          continue;
        const std::string name = dialect_.separator == ';' ? "semicolon" : "tab";
        return Error("line " + std::to_string(ahead.line()) + ": " + Shown(field) +
                     ": fields are separated by " + name +
                     "s and numbers have decimal commas: read it with --csv-dialect " + name +
                     ", or convert it: tr ',' '.' < FILE | tr '" + (dialect_.separator == ';' ? ";" : "\\t") +
                     "' ',' > NEW");
      }
    }
    Note(std::string("fields are separated by ") + (dialect_.separator == ';' ? "semicolons" : "tabs"));
    return Status::Ok();
  }

  std::string_view WithPoint(std::string_view field) {
    decimal_.assign(field);
    std::replace(decimal_.begin(), decimal_.end(), ',', '.');
    return decimal_;
  }

  Status AddColumn(std::string_view name, std::set<std::string>* seen) {
    const std::string place = HeaderName() + ", column " + std::to_string(columns_.size() + 1);
    if (name.empty()) {  // as the index that pandas writes
      columns_.emplace_back().is_nameless = true;
      Note("column " + std::to_string(columns_.size()) + " has no name: left alone");
      return Status::Ok();
    }
    if (std::any_of(name.begin(), name.end(), [](unsigned char c) { return c < ' ' || c == 0x7F; }))
      return Error(place + ": the name " + Shown(name) + " holds line ends or other control characters");
    Column column;
    column.name = std::string(name);
    if (!seen->insert(column.name).second) return Error(place + ": " + column.name + " is there twice");
    const size_t dot = name.find('.');
    const std::string_view prefix = name.substr(0, dot);
    if (name == "time") {
      column.kind = Kind::kTime;
    } else if (ignored_.count(column.name) > 0) {
      column.kind = Kind::kOther;
    } else if (dot != std::string_view::npos && KindsOfJoints().count(prefix)) {
      column.kind = KindOf(prefix);
      column.joint = std::string(name.substr(dot + 1));
      if (!options_.robot.empty() && !RobotHas(column.joint)) {
        return Error(place + ": " + column.name + ": the robot has no joint " + Shown(column.joint) +
                     UnknownJointAdvice(column.joint, JointNames()));
      }
    }
    columns_.push_back(std::move(column));
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
    if (joints_.empty()) return Error(HeaderName() + ": no column position.<joint>");
    for (const std::string& joint : joints_) {
      if (!Find(Kind::kPosition, joint)) {
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
        return Error(HeaderName() + ": column " + name + "." + missing + " is missing, other joints have " +
                     name +
                     (kind == Kind::kVelocity ? "; give it, or leave all of them out" : kHowToPrescribe));
      }
      has_[static_cast<int>(kind)] = there > 0;
    }
    if (options_.require_effort && !has_[static_cast<int>(Kind::kEffortCommand)] &&
        !has_[static_cast<int>(Kind::kEffortMeasured)]) {
      return Error(HeaderName() + NoEffort());
    }
    return Status::Ok();
  }

  std::string NoEffort() const {
    for (const Column& column : columns_) {
      for (const char* commanded : {"position_reference.", "position_command.", "position_desired."}) {
        if (column.name.rfind(commanded, 0) == 0)
          return ": positions are commanded (" + column.name +
                 ") and no effort is recorded: position-commanded drives are not modelled yet; record "
                 "effort_command.<joint> or effort_measured.<joint>";
      }
    }
    const std::string advice =
        MissingColumnAdvice(Names(), joints_[0], {"effort", "torque", "tau", "force", "u", "cmd"},
                            "effort_command." + joints_[0] + " or effort_measured." + joints_[0], "");
    return ": no effort: neither effort_command.<joint> nor effort_measured.<joint>" +
           (advice.empty() ? "; without one nothing can be told of forces" : advice);
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
    // A row has a separator less than columns: lines that are none take no memory.
    const auto ends =
        std::count_if(text_.begin(), text_.end(), [](char c) { return c == '\n' || c == '\r'; }) + 1;
    const auto lines = std::min<long>(ends, static_cast<long>(text_.size() / columns_.size()) + 2);
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
      if (column.kind != Kind::kOther || column.is_nameless) continue;
      Eigen::VectorXd& values = r.other[column.name];
      values.resize(lines);
      column.out = values.data();
    }
  }

  Status ReadRows() {
    std::vector<std::string_view> fields;
    while (lines_->Next(&fields)) {
      if (fields.empty()) {
        if (lines_->AtEnd()) break;
        return Error(RowName(rows_) + ": the line is empty; take it out");
      }
      RG_RETURN_IF_ERROR(ReadRow(fields));
      line_of_.push_back(lines_->line());
      ++rows_;
    }
    if (!lines_->status().ok()) return Unclosed();
    if (rows_ == 0) return Error("no rows under the header");
    if (rows_ == 1) return Error("only one row under the header");
    return Status::Ok();
  }

  Status ReadRow(std::vector<std::string_view>& fields) {
    // Separators at the line's end are no fields.
    while (fields.size() > columns_.size() && fields.back().empty()) fields.pop_back();
    RG_RETURN_IF_ERROR(CheckIsNoHeader(fields));
    const size_t count = std::min(fields.size(), columns_.size());
    for (size_t i = 0; i < count; ++i) RG_RETURN_IF_ERROR(ReadField(columns_[i], fields[i]));
    if (fields.size() != columns_.size()) return WrongFieldCount(fields.size());
    if (rows_ > 0 && !(recording_.t[rows_] > recording_.t[rows_ - 1])) return TimeError();
    const size_t digits = CountDigits(fields.back());
    if (!lines_->terminated()) {
      last_field_ = std::string(fields.back());
    } else {
      fewest_digits_ = std::min(fewest_digits_, digits);
    }
    return Status::Ok();
  }

  // A second header, or a row of units under the first.
  Status CheckIsNoHeader(const std::vector<std::string_view>& fields) const {
    if (fields.size() < 2 || fields[0].empty() || BeginsAsNumber(fields[0])) return Status::Ok();
    if (fields[0] == columns_[0].name && fields[1] == columns_[1].name)
      return Error(RowName(rows_) + ": the header again: give each run its own file");
    if (rows_ > 0 || std::any_of(fields.begin(), fields.end(), IsNumber)) return Status::Ok();
    return Error(RowName(rows_) + ": " + Shown(fields[0]) + ", " + Shown(fields[1]) +
                 ": no numbers (units?); take the line out");
  }
  static bool BeginsAsNumber(std::string_view field) {
    return field[0] == '-' || field[0] == '+' || field[0] == '.' || (field[0] >= '0' && field[0] <= '9');
  }

  Status WrongFieldCount(size_t fields) const {
    std::string counts =
        std::to_string(fields) + " of " + std::to_string(columns_.size()) + " fields are there";
    if (fields > columns_.size()) {
      // A whole number has no comma: 13 of 7.
      const bool doubled = 2 * fields > 3 * columns_.size() && fields <= 2 * columns_.size();
      if (doubled && dialect_.separator == ',')
        counts += ": decimal commas? Write numbers with points, or separate fields by semicolons";
      return Error(RowName(rows_) + ", column " + std::to_string(columns_.size() + 1) + ": " + counts);
    }
    return Error(RowName(rows_) + ", column " + columns_[fields].name + ": " +
                 (lines_->AtEnd() ? "the last row is truncated: " : "") + counts +
                 "; complete the row, or take it out");
  }

  Status TimeError() const {
    const double now = recording_.t[rows_], before = recording_.t[rows_ - 1];
    if (const int more = RepeatsAhead(now); now == before && more > kFewRepeats) {
      return Error(
          RowName(rows_) + ", column time: time repeats: " + Number(now) + " after " + Number(before) +
          ", and in " + std::to_string(more) + " of the next " + std::to_string(kLookedAhead) +
          " rows: its stamps have too few digits, or rows of several messages share one; write more digits "
          "(%.9f) or one row for each stamp");
    }
    return Error(
        RowName(rows_) + ", column time: " + (now == before ? "time repeats: " : "time goes back: ") +
        Number(now) + " after " + Number(before) +
        (now == before ? "; take one of the rows out" : "; sort the rows, or give each run its own file"));
  }

  // Of the rows behind this one, those with the time of the row before them.
  int RepeatsAhead(double before) const {
    CsvText ahead = *lines_;
    std::vector<std::string_view> fields;
    size_t column = 0;
    while (columns_[column].kind != Kind::kTime) ++column;
    int repeats = 0;
    for (int row = 0; row < kLookedAhead && ahead.Next(&fields); ++row) {
      double now = 0.0;
      if (fields.size() <= column || ParseNumber(fields[column], &now) != NumberText::kOk) continue;
      now /= options_.time_units_per_s;
      repeats += now == before, before = now;
    }
    return repeats;
  }

  static std::string Number(double value) {
    char buffer[32];
    const auto end = std::to_chars(buffer, buffer + sizeof buffer, value);
    return std::string(buffer, end.ptr);
  }

  Status ReadField(Column& column, std::string_view field) {
    if (!column.out) return Status::Ok();
    double value = 0.0;
    NumberText outcome = ParseNumber(field, &value);
    if (outcome == NumberText::kNotANumber && dialect_.decimal_comma) {
      outcome = ParseNumber(WithPoint(field), &value);
    }
    if (outcome == NumberText::kNotANumber && MeansMissing(field)) outcome = NumberText::kEmpty;
    if (column.kind == Kind::kOther) {
      if (outcome == NumberText::kNotANumber) column.is_text = true;
      if (outcome != NumberText::kOk && outcome != NumberText::kNotFinite) value = std::nan("");
    } else if (outcome == NumberText::kEmpty || (outcome == NumberText::kNotFinite && std::isnan(value))) {
      if (IsCut(column)) return Cut(column, field);
      if (!IsOptional(column.kind)) return BlankField(column, rows_, field, outcome != NumberText::kEmpty);
      if (column.blanks++ == 0) {
        column.first_blank = rows_, column.first_blank_field = std::string(field);
        column.first_blank_is_nan = outcome != NumberText::kEmpty;
      }
      value = std::nan("");
    } else if (outcome != NumberText::kOk) {
      if (IsCut(column)) return Cut(column, field);
      return FieldError(rows_, column,
                        (outcome == NumberText::kNotFinite    ? "not finite: "
                         : outcome == NumberText::kOutOfRange ? "out of a double's range: "
                                                              : "not a number: ") +
                            Shown(field) +
                            (outcome == NumberText::kNotANumber ? WhyNoNumber(field) : kTakeRowOut));
    }
    if (column.kind == Kind::kTime) value /= options_.time_units_per_s;
    column.out[rows_ * column.stride] = value;
    return Status::Ok();
  }

  static bool IsOptional(Kind kind) {
    return kind == Kind::kVelocity || kind == Kind::kEffortCommand || kind == Kind::kEffortMeasured;
  }

  Status BlankField(const Column& column, Eigen::Index row, std::string_view field, bool is_nan) const {
    return FieldError(row, column,
                      (is_nan          ? "NaN"
                       : field.empty() ? "the field is empty"
                                       : Shown(field)) +
                          kTakeRowOut);
  }

  // The file's last field, without a line end behind it.
  bool IsCut(const Column& column) const { return !lines_->terminated() && &column == &columns_.back(); }
  Status Cut(const Column& column, std::string_view field) const {
    return FieldError(rows_, column, "the last row is truncated at " + Shown(field) + "; take it out");
  }

  // A file that ends inside its last number still reads as a number. It gives itself away where that
  // number has fewer digits than all others of its column.
  Status CheckLastRowIsWhole() const {
    if (!last_field_ || rows_ < kTooFewRowsToJudgeDigits) return Status::Ok();
    const std::string& field = *last_field_;
    if (CountDigits(field) >= fewest_digits_ &&
        std::isdigit(static_cast<unsigned char>(field.empty() ? '0' : field.back()))) {
      return Status::Ok();
    }
    return FieldError(rows_ - 1, columns_.back(),
                      "the last row is truncated: no end of line, and " + Shown(field) +
                          " has fewer digits than any other row; take it out");
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
      if (column.kind != Kind::kOther || column.is_nameless) continue;
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
    r.drive =
        r.has_effort_command() || !r.has_effort_measured() ? EffortKind::kCommand : EffortKind::kMeasured;
  }

  // A single field of an optional column that is empty or NaN is an error, all of them are not. One blank
  // velocity column makes velocities of no use.
  Status FindBlankColumns() {
    bool velocity = false;
    for (const Column& column : columns_) {
      if (column.blanks == 0) continue;
      if (column.blanks < rows_)
        return BlankField(column, column.first_blank, column.first_blank_field, column.first_blank_is_nan);
      blank_columns_.insert(column.name);
      velocity = velocity || column.kind == Kind::kVelocity;
    }
    for (const Column& column : columns_) {
      if (velocity && column.kind == Kind::kVelocity) blank_columns_.insert(column.name);
    }
    return Status::Ok();
  }

  // What the values themselves show: units, angles that wrap, velocities that stand still.
  Status CheckSignals() {
    if (!options_.time_unit_is_known) RG_RETURN_IF_ERROR(CheckTimeUnit(recording_, options_.sample_rate_hz));
    const Status jump = UnwrapAngles(options_.robot, &recording_);
    FillVelocities(&recording_);
    LeaveOutFrozenVelocity(&recording_);
    RG_RETURN_IF_ERROR(CheckUnits(recording_, options_.robot));
    RG_RETURN_IF_ERROR(CheckOddValues(recording_));
    TakeEpochOff(&recording_);
    return jump;
  }

  std::string_view text_;
  const std::string& source_;
  const CsvOptions& options_;
  std::set<std::string> ignored_, blank_columns_;
  CsvDialect dialect_;
  std::optional<CsvText> lines_;
  std::vector<int> line_of_;  // of each row
  int header_line_ = 1;
  std::string decimal_;
  std::optional<std::string> last_field_;  // of a last row without line end
  size_t fewest_digits_ = std::string::npos;
  std::vector<Column> columns_;
  std::vector<std::string> joints_;
  std::set<std::string> prescribed_;
  bool has_[6] = {};
  Eigen::Index rows_ = 0;
  Recording recording_;
};

}  // namespace

Result<Recording> ParseCsv(std::string_view text, const std::string& source_name, const CsvOptions& options) {
  CsvParser parser(text, source_name, options, {});
  auto recording = parser.Parse();
  const std::set<std::string>& blank = parser.blank_columns();
  if (blank.empty()) return recording;
  CsvParser again(text, source_name, options, blank);
  recording = again.Parse();
  if (!recording.ok()) return recording;
  std::string names;
  for (const std::string& name : blank) names += (names.empty() ? "" : ", ") + name;
  recording->notes.push_back(names + ": left out, " + (blank.size() == 1 ? "the column is" : "a column is") +
                             " empty throughout");
  return recording;
}

Result<Recording> LoadCsv(const std::string& path, const CsvOptions& options) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return ParseCsv(text, path, options);
}

}  // namespace rg::recordings
