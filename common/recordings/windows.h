// Windows of a recording, as predictions are made and judged: with t0 the time of the first row and W
// the length, the simulation starts anew at the first row at or after t0 + k·W (with half a sample of
// tolerance) and runs to the row where the next window starts, or to the last row.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace rg::recordings {

struct Recording;

struct Window {
  int first = 0;  // the restart row: the measured state there starts the simulation
  int last = 0;   // the last row predicted (the next window's restart row, or the recording's last)
  int rows() const { return last - first; }  // predicted rows: first + 1 … last
};

// t: K strictly increasing times; window_s > 0, infinity for one window over all. Windows that a gap
// swallows are left out; a window has at least one predicted row; fewer than two rows give none.
std::vector<Window> SplitIntoWindows(const Eigen::VectorXd& t, double window_s);
// The same of a recording, or of a piece of one between gaps, whose windows are counted from window_origin.
std::vector<Window> SplitIntoWindows(const Recording& recording, double window_s);

}  // namespace rg::recordings
