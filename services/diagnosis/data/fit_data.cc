#include "services/diagnosis/data/fit_data.h"

#include <limits>

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

}  // namespace rg::diagnosis
