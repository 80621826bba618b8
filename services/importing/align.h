// Several topics with clocks of their own on one time base, without inventing commands.
//
// The base is the stamps of the position column with most samples. Other tracks are shifted to its clock,
// then measurements are taken linearly between their two neighbours and commands as the last one before
// (zero order). Where a track has a gap (longer than max(5 of its periods, 0.1 s)), rows are left out;
// so are rows outside the span that all required columns share. Nothing is extrapolated.
//
// Clocks. A header's clock and the log's differ by an offset and the messages' latency; the offset is the
// lower edge (5 %) of log time minus stamp, and a line where it drifts by more than 2 ms. A track in the
// log's clock is shifted by the base's offset. Two header clocks are taken as one unless their offsets
// differ by more than 50 ms (another host).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/importing/columns.h"
#include "services/importing/tracks.h"

namespace rg::importing {

struct ClockOffset {
  std::string topic, clock;
  double offset_s = 0.0;  // added to the track's stamps, in the middle of the log
  double drift_s = 0.0;   // change of it over the log
};

struct ColumnUse {
  double rate_hz = 0.0;  // of the column's own samples
  uint64_t samples = 0;
};

struct Aligned {
  std::vector<int64_t> stamps_ns;            // K, strictly increasing
  std::vector<std::vector<double>> columns;  // by WantedColumn, K each; finite where required
  std::vector<ColumnUse> use;                // by WantedColumn
  size_t base_column = 0;
  std::vector<ClockOffset> offsets;
  std::vector<std::string> notes;
};

// Error: no position, stamps that jump back, no common time; names `log_name` and the topic.
Result<Aligned> Align(const std::vector<WantedColumn>& wanted, std::vector<Track> tracks,
                      const std::string& log_name);

}  // namespace rg::importing
