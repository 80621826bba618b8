// One recording of a robot: what its sensors and its drives said, row by row. SI units throughout
// (s, rad, rad/s, N·m; m, m/s, N for prismatic joints).
//
// A column of q, v and the efforts is one row of the file, so that the state at row k is contiguous.
// Rows are strictly increasing in time; sampling may be irregular and rows may be missing. Every
// value of t, q, v and the efforts is finite (the readers hold that).
#pragma once

#include <Eigen/Core>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::recordings {

enum class Split { kFit, kHoldout };

enum class EffortKind {
  kCommand,   // holds from its row's time to the next row's (zero order)
  kMeasured,  // linear between rows
};

struct Recording {
  std::string name;  // the file's name within its set, or a name given by the maker
  Split split = Split::kFit;
  std::vector<std::string> joints;  // n names, the order of the rows below
  Eigen::VectorXd t;                // K, s; the file's stamps less time_offset
  // Whole seconds that were taken off the stamps of a file that counts from an epoch, so that effects over
  // time have small numbers; t + time_offset are the file's stamps to the last digit. 0 elsewhere.
  double time_offset = 0.0;
  Eigen::MatrixXd q;                // n × K
  Eigen::MatrixXd v;                // n × K, or 0 × 0: not measured
  Eigen::MatrixXd effort_command;   // n × K, or 0 × 0
  Eigen::MatrixXd effort_measured;  // n × K, or 0 × 0
  // Columns of other kinds by their full header ("motor_current.elbow"), K each. A field that was
  // empty or NaN is NaN here; a column that holds text is not here.
  std::map<std::string, Eigen::VectorXd> other;
  // Rows of joints that move as measured (prescribed), ascending: no effort drives them, theirs is 0, and
  // nothing is predicted of them. Efforts that the file has of them are in `other`.
  std::vector<int> prescribed;
  // Of these, the ones without a velocity column where others have one: their v is the slope of q.
  std::vector<int> without_velocity;
  EffortKind drive = EffortKind::kCommand;  // the effort that drives the model; it is there
  // What its reader did that a user wants to know, one line each.
  std::vector<std::string> notes;
  // Where the file's angles wrap: n × K, the full turns [rad] that were added to make q; 0 × 0 where none
  // were.
  Eigen::MatrixXd turns_added;
  // Windows of predictions are counted from this time; NaN: from the first row. Of a piece of a longer
  // recording: that recording's first row (time_stamps.h).
  double window_origin = std::numeric_limits<double>::quiet_NaN();

  int rows() const { return static_cast<int>(t.size()); }
  int n() const { return static_cast<int>(q.rows()); }
  bool has_velocity() const { return v.size() > 0; }
  bool has_effort_command() const { return effort_command.size() > 0; }
  bool has_effort_measured() const { return effort_measured.size() > 0; }
  bool IsPrescribed(int joint) const;
  // n × K: the effort that drives the model; 0 × 0 in a recording without effort.
  const Eigen::MatrixXd& drive_effort() const {
    return drive == EffortKind::kCommand ? effort_command : effort_measured;
  }
  // Other columns of one kind ("torque_sensor") as n × K, or 0 × 0 unless every joint has one.
  Eigen::MatrixXd OtherKind(const std::string& kind) const;
  // Median of the differences of t; 0 with fewer than two rows.
  double SamplePeriod() const;
};

// The joints of `recording` in the order of `joints`, which may leave some out.
// Error: a name that the recording does not have.
Result<Recording> Reorder(const Recording& recording, const std::vector<std::string>& joints);

// Rows [first, first + count) as a recording of their own; times are kept.
Recording Slice(const Recording& recording, int first, int count);

}  // namespace rg::recordings
