// From logs to a recording set: bags, MCAP files and CSV files, one recording each.
//
// Called by the command line. Nothing is written before everything is read and checked: the set is made in
// a folder beside its own, loaded once as a user of it would, and then renamed.
#pragma once

#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "services/importing/columns.h"
#include "services/importing/import_map.h"

namespace rg::importing {

struct ImportOptions {
  std::vector<std::string> files;
  std::string urdf;  // path; may be empty where the files are bags that an export wrote
  std::string map;   // path; empty: guessed, and refused where the guess leaves a question
  std::string out;   // folder of the set; it is not there yet, or empty
};

struct TakenColumn {
  std::string topic, field, column, unit, clock;
  double rate_hz = 0.0;
  uint64_t samples = 0;
};

struct ImportedFile {
  std::string path;
  std::string recording;  // file name in the set
  bool holdout = false;
  int rows = 0;
  double duration_s = 0.0;
  int64_t start_ns = 0;  // of the first row, in the clock of the time base
  std::string base;      // the topic whose stamps are the rows', and its clock
  std::vector<TakenColumn> taken;
};

struct NotTaken {
  std::string topic;  // or a CSV's column
  std::string type;
  std::string why;  // "fields velocity, effort", "encoding protobuf is not read"
};

struct ImportReport {
  std::string out;
  std::string map_json;  // what was used; empty for bags that an export wrote
  bool guessed = false;
  std::vector<std::string> reasons;  // of a guess
  std::vector<ImportedFile> files;
  std::vector<NotTaken> not_taken;
  std::vector<std::string> notes;
};

Result<ImportReport> Import(const ImportOptions& options, const ProgressFn& progress);

struct GuessReport {
  std::string map_json;
  std::vector<std::string> reasons;
  std::vector<std::string> questions;
};

// What Import would take of the first file.
Result<GuessReport> Guess(const ImportOptions& options, const ProgressFn& progress);

// The joints of a URDF that move by themselves, in the order of the document.
Result<std::vector<RobotJoint>> RobotJoints(const std::string& urdf_text, const std::string& urdf_path);

}  // namespace rg::importing
