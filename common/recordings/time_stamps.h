// Time stamps as loggers write them: their unit, and the gaps between them.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording.h"

namespace rg::recordings {

// Of --time-unit: s, ms, us or ns; how many make a second.
Result<double> TimeUnitsPerSecond(const std::string& unit);

// Refuses stamps that are visibly milli-, micro- or nanoseconds, in one line that names the unit. What tells:
// the expected rate if there is one; velocities beside the slope of positions; epoch stamps by their size; a
// rate below 2 Hz of positions that hardly change from row to row.
Status CheckTimeUnit(const Recording& recording, std::optional<double> sample_rate_hz);

// Takes the whole seconds of the first stamp off where stamps count from an epoch (above 1e6 s): t and
// time_offset. No digit is lost.
void TakeEpochOff(Recording* recording);

// Longest time between neighbouring rows that is no gap: max(5 sample periods, 0.1 s).
double LongestStep(const Eigen::VectorXd& t);
struct Gap {
  int row = 0;  // the first row after it
  double seconds = 0.0;
};
std::vector<Gap> FindGaps(const Eigen::VectorXd& t);

// The rows between gaps, as recordings of their own with the same name, split and window_origin. A recording
// without a gap is its own only piece.
std::vector<Recording> SplitAtGaps(const Recording& recording);
// Neighbours of the same name and split as one again, rows behind rows.
std::vector<Recording> JoinPieces(std::vector<Recording> recordings);

}  // namespace rg::recordings
