// Time series as a log holds them: one track per topic and clock, in the log's order.
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "services/importing/columns.h"
#include "services/importing/inventory.h"
#include "services/importing/log_file.h"

namespace rg::importing {

inline constexpr double kNone = std::numeric_limits<double>::quiet_NaN();  // a value that is not there

struct Track {
  std::string topic;
  std::string clock;                        // "header", "log", a path; empty in a CSV
  std::vector<int64_t> stamps_ns;           // K, in the clock of the track
  std::vector<int64_t> log_ns;              // K, or empty where the clock is the log's own
  std::vector<size_t> columns;              // numbers of WantedColumns
  std::vector<std::vector<double>> values;  // one per column, K each, SI; NaN: not in that message
};

// Reads the columns that are wanted. Error: a field that the topic's type does not have, a clock that was
// never set (all stamps 0), a damaged message; names the topic.
Result<std::vector<Track>> ReadTracks(const LogFile& file, const Inventory& inventory,
                                      const std::vector<WantedColumn>& wanted, const ProgressFn& progress);

}  // namespace rg::importing
