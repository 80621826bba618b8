#include "common/recordings/csv.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <set>

#include "common/base/file.h"
#include "common/base/number_text.h"
#include "common/recordings/angles.h"
#include "common/recordings/csv_advice.h"
#include "common/recordings/csv_header.h"
#include "common/recordings/odd_values.h"
#include "common/recordings/prescribed.h"
#include "common/recordings/time_stamps.h"
#include "common/recordings/velocity_column.h"

namespace rg::recordings {
namespace {

constexpr int kTooFewRowsToJudgeDigits = 20;
constexpr int kLookedAhead = 20, kFewRepeats = 3;  // rows
constexpr const char* kTakeRowOut = "; take the row out, rows may be missing";

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
    RG_ASSIGN_OR_RETURN(header_, ReadCsvHeader(text_, source_, options_, ignored_, &lines_));
    recording_.notes = header_.notes;
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
  Status FieldError(Eigen::Index row, const CsvColumn& column, const std::string& what) const {
    return Error(RowName(row) + ", column " + column.name + ": " + what);
  }

  void Allocate() {
    // A row has a separator less than columns: lines that are none take no memory.
    const auto ends =
        std::count_if(text_.begin(), text_.end(), [](char c) { return c == '\n' || c == '\r'; }) + 1;
    const auto lines = std::min<long>(ends, static_cast<long>(text_.size() / header_.columns.size()) + 2);
    const auto n = static_cast<Eigen::Index>(header_.joints.size());
    Recording& r = recording_;
    r.t.resize(lines);
    r.q.resize(n, lines);
    if (header_.Has(CsvKind::kVelocity)) r.v.resize(n, lines);
    if (header_.Has(CsvKind::kEffortCommand)) r.effort_command.resize(n, lines);
    if (header_.Has(CsvKind::kEffortMeasured)) r.effort_measured.resize(n, lines);
    const auto point = [&](CsvKind kind, Eigen::MatrixXd& x) {
      for (Eigen::Index i = 0; x.size() > 0 && i < n; ++i) {
        CsvColumn* column = header_.Find(kind, header_.joints[static_cast<size_t>(i)]);
        if (column == nullptr) {  // of a prescribed joint
          x.row(i).setZero();
          continue;
        }
        column->out = &x(i, 0);
        column->stride = n;
      }
    };
    point(CsvKind::kPosition, r.q);
    point(CsvKind::kVelocity, r.v);
    point(CsvKind::kEffortCommand, r.effort_command);
    point(CsvKind::kEffortMeasured, r.effort_measured);
    for (CsvColumn& column : header_.columns) {
      if (column.kind == CsvKind::kTime) column.out = r.t.data();
      if (column.kind != CsvKind::kOther || column.is_nameless) continue;
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
    if (!lines_->status().ok()) return Error(lines_->status().message());
    if (rows_ == 0) return Error("no rows under the header");
    if (rows_ == 1) return Error("only one row under the header");
    return Status::Ok();
  }

  Status ReadRow(std::vector<std::string_view>& fields) {
    // Separators at the line's end are no fields.
    while (fields.size() > header_.columns.size() && fields.back().empty()) fields.pop_back();
    RG_RETURN_IF_ERROR(CheckIsNoHeader(fields));
    const size_t count = std::min(fields.size(), header_.columns.size());
    for (size_t i = 0; i < count; ++i) RG_RETURN_IF_ERROR(ReadField(header_.columns[i], fields[i]));
    if (fields.size() != header_.columns.size()) return WrongFieldCount(fields.size());
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
    if (fields[0] == header_.columns[0].name && fields[1] == header_.columns[1].name)
      return Error(RowName(rows_) + ": the header again: give each run its own file");
    if (rows_ > 0 || std::any_of(fields.begin(), fields.end(), IsNumber)) return Status::Ok();
    return Error(RowName(rows_) + ": " + ShownField(fields[0]) + ", " + ShownField(fields[1]) +
                 ": no numbers (units?); take the line out");
  }
  static bool BeginsAsNumber(std::string_view field) {
    return field[0] == '-' || field[0] == '+' || field[0] == '.' || (field[0] >= '0' && field[0] <= '9');
  }

  Status WrongFieldCount(size_t fields) const {
    std::string counts =
        std::to_string(fields) + " of " + std::to_string(header_.columns.size()) + " fields are there";
    if (fields > header_.columns.size()) {
      // A whole number has no comma: 13 of 7.
      const bool doubled = 2 * fields > 3 * header_.columns.size() && fields <= 2 * header_.columns.size();
      if (doubled && header_.dialect.separator == ',')
        counts += ": decimal commas? Write numbers with points, or separate fields by semicolons";
      return Error(RowName(rows_) + ", column " + std::to_string(header_.columns.size() + 1) + ": " + counts);
    }
    return Error(RowName(rows_) + ", column " + header_.columns[fields].name + ": " +
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
    while (header_.columns[column].kind != CsvKind::kTime) ++column;
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

  Status ReadField(CsvColumn& column, std::string_view field) {
    if (!column.out) return Status::Ok();
    double value = 0.0;
    NumberText outcome = ParseNumber(field, &value);
    if (outcome == NumberText::kNotANumber && header_.dialect.decimal_comma) {
      outcome = ParseNumber(WithPoint(field), &value);
    }
    if (outcome == NumberText::kNotANumber && MeansMissing(field)) outcome = NumberText::kEmpty;
    if (column.kind == CsvKind::kOther) {
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
                            ShownField(field) +
                            (outcome == NumberText::kNotANumber ? WhyNoNumber(field) : kTakeRowOut));
    }
    if (column.kind == CsvKind::kTime) value /= options_.time_units_per_s;
    column.out[rows_ * column.stride] = value;
    return Status::Ok();
  }

  static bool IsOptional(CsvKind kind) {
    return kind == CsvKind::kVelocity || kind == CsvKind::kEffortCommand || kind == CsvKind::kEffortMeasured;
  }

  Status BlankField(const CsvColumn& column, Eigen::Index row, std::string_view field, bool is_nan) const {
    return FieldError(row, column,
                      (is_nan          ? "NaN"
                       : field.empty() ? "the field is empty"
                                       : ShownField(field)) +
                          kTakeRowOut);
  }

  // The file's last field, without a line end behind it.
  bool IsCut(const CsvColumn& column) const {
    return !lines_->terminated() && &column == &header_.columns.back();
  }
  Status Cut(const CsvColumn& column, std::string_view field) const {
    return FieldError(rows_, column, "the last row is truncated at " + ShownField(field) + "; take it out");
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
    return FieldError(rows_ - 1, header_.columns.back(),
                      "the last row is truncated: no end of line, and " + ShownField(field) +
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
    r.joints = header_.joints;
    r.t.conservativeResize(rows_);
    for (Eigen::MatrixXd* x : {&r.q, &r.v, &r.effort_command, &r.effort_measured}) {
      if (x->size() > 0) x->conservativeResize(Eigen::NoChange, rows_);
    }
    for (const CsvColumn& column : header_.columns) {
      if (column.kind != CsvKind::kOther || column.is_nameless) continue;
      if (column.is_text) {
        r.other.erase(column.name);
      } else {
        r.other[column.name].conservativeResize(rows_);
      }
    }
    for (size_t i = 0; i < header_.joints.size(); ++i) {
      if (header_.prescribed.count(header_.joints[i]) == 0) continue;
      r.prescribed.push_back(static_cast<int>(i));
      if (r.has_velocity() && !header_.Find(CsvKind::kVelocity, header_.joints[i]))
        r.without_velocity.push_back(static_cast<int>(i));
    }
    r.drive =
        r.has_effort_command() || !r.has_effort_measured() ? EffortKind::kCommand : EffortKind::kMeasured;
  }

  // A single field of an optional column that is empty or NaN is an error, all of them are not. One blank
  // velocity column makes velocities of no use.
  Status FindBlankColumns() {
    bool velocity = false;
    for (const CsvColumn& column : header_.columns) {
      if (column.blanks == 0) continue;
      if (column.blanks < rows_)
        return BlankField(column, column.first_blank, column.first_blank_field, column.first_blank_is_nan);
      blank_columns_.insert(column.name);
      velocity = velocity || column.kind == CsvKind::kVelocity;
    }
    for (const CsvColumn& column : header_.columns) {
      if (velocity && column.kind == CsvKind::kVelocity) blank_columns_.insert(column.name);
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
  std::optional<CsvText> lines_;
  std::vector<int> line_of_;               // of each row
  std::optional<std::string> last_field_;  // of a last row without line end
  size_t fewest_digits_ = std::string::npos;
  CsvHeader header_;
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
