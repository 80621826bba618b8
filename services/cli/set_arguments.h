// Where a command's recordings come from: folders of recording sets, or a URDF and CSV files, and how they
// are read.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording_set.h"

namespace CLI {
class App;
}

namespace rg::cli {

struct ReadArguments {
  std::string time_unit, dialect;

  // --time-unit and --csv-dialect.
  void AddTo(CLI::App* command);
  Result<recordings::ReadOptions> Options() const;
};

struct SetArguments {
  std::vector<std::string> sets;  // folders, or with `urdf` files
  std::string urdf;
  std::string split_time;  // empty: not asked for
  ReadArguments read;

  // SET…, --urdf, --split-time and those of ReadArguments.
  void AddTo(CLI::App* command);
  // Several folders of one robot become one set. `keep_whole`: as in recordings::ReadOptions.
  Result<recordings::RecordingSet> Load(bool keep_whole = false) const;
  // Exactly a folder's files, read in the plain way.
  bool is_one_plain_folder() const;
  // For titles: the last part of the first path.
  std::string name() const;
};

}  // namespace rg::cli
