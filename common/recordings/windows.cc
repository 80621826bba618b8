#include "common/recordings/windows.h"

#include <cmath>

#include "common/base/check.h"
#include "common/recordings/recording.h"

namespace rg::recordings {

namespace {

std::vector<Window> WindowsFrom(double origin, const Eigen::VectorXd& t, double window_s) {
  RG_CHECK(window_s > 0.0) << "window of " << window_s << " s";
  const int rows = static_cast<int>(t.size());
  std::vector<Window> windows;
  if (rows < 2) return windows;
  Recording times;
  times.t = t;
  const double tolerance = 0.5 * times.SamplePeriod();
  int first = 0;
  for (int k = 1; k < rows; ++k) {
    const double boundary = std::floor((t[k] + tolerance - origin) / window_s);
    const double before = std::floor((t[k - 1] + tolerance - origin) / window_s);
    if (boundary <= before) continue;
    windows.push_back({first, k});
    first = k;
  }
  if (first < rows - 1) windows.push_back({first, rows - 1});
  return windows;
}

}  // namespace

std::vector<Window> SplitIntoWindows(const Eigen::VectorXd& t, double window_s) {
  return WindowsFrom(t.size() > 0 ? t[0] : 0.0, t, window_s);
}

std::vector<Window> SplitIntoWindows(const Recording& r, double window_s) {
  if (std::isnan(r.window_origin)) return SplitIntoWindows(r.t, window_s);
  return WindowsFrom(r.window_origin, r.t, window_s);
}

}  // namespace rg::recordings
