#include "services/diagnosis/data/fit_data.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace rg::diagnosis {

recordings::SensorNoise FitData::RowNoise() const {
  recordings::SensorNoise out = noise;
  for (const int j : prescribed)
    out.position_stddev[j] = out.velocity_stddev[j] = std::numeric_limits<double>::infinity();
  return out;
}

int FitData::Rows() const {
  int rows = 0;
  for (const NodeWindow& w : windows) {
    for (const char m : w.measured) rows += m * judged() * (use_velocity ? 2 : 1);
  }
  return rows;
}

double FitData::Seconds() const {
  double seconds = 0;
  for (const NodeWindow& w : windows) seconds += w.t.back() - w.t.front();
  return seconds;
}

size_t FitData::WindowsFor(size_t count) const {
  std::vector<double> lengths;
  for (const NodeWindow& w : windows) lengths.push_back(w.t.back() - w.t.front());
  const auto middle = lengths.begin() + static_cast<std::ptrdiff_t>(lengths.size() / 2);
  std::nth_element(lengths.begin(), middle, lengths.end());
  return std::max(count,
                  static_cast<size_t>(std::lround(static_cast<double>(count) * nodes.window_s / *middle)));
}

FitData FitData::OnWindows(const std::vector<uint32_t>& places) const {
  FitData out = *this;
  out.windows.clear();
  for (const uint32_t i : places) out.windows.push_back(windows[i]);
  return out;
}

}  // namespace rg::diagnosis
