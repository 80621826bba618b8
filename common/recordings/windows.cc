#include "common/recordings/windows.h"

#include <cmath>

#include "common/base/check.h"
#include "common/recordings/recording.h"

namespace rg::recordings {

std::vector<Window> SplitIntoWindows(const Eigen::VectorXd& t, double window_s) {
  RG_CHECK(window_s > 0.0) << "window of " << window_s << " s";
  const int rows = static_cast<int>(t.size());
  std::vector<Window> windows;
  if (rows < 2) return windows;
  Recording times;
  times.t = t;
  const double tolerance = 0.5 * times.SamplePeriod();
  int first = 0;
  for (int k = 1; k < rows; ++k) {
    const double boundary = std::floor((t[k] + tolerance - t[0]) / window_s);
    const double before = std::floor((t[k - 1] + tolerance - t[0]) / window_s);
    if (boundary <= before) continue;
    windows.push_back({first, k});
    first = k;
  }
  if (first < rows - 1) windows.push_back({first, rows - 1});
  return windows;
}

}  // namespace rg::recordings
