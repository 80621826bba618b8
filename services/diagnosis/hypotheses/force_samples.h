// The missing force at the middles of its segments, with the motion there: what start values are regressed
// on.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "services/diagnosis/data/fit_data.h"
#include "services/diagnosis/likelihood/missing_force.h"

namespace rg::diagnosis {

// Row of the fine motion at time t.
inline Eigen::Index FineRow(const FineMotion& fine, double t) {
  const double dt = fine.t[1] - fine.t[0];
  return static_cast<Eigen::Index>(
      std::clamp((t - fine.t[0]) / dt, 0.0, static_cast<double>(fine.t.size() - 1)));
}

struct ForceSample {
  double t = 0;            // s, since the start of the recording
  VectorXd q, v;           // n
  VectorXd force, weight;  // n: missing force, 1/σ²
};

inline std::vector<ForceSample> ForceSamples(const FitData& data, const MissingForce& missing) {
  std::vector<ForceSample> out;
  for (size_t w = 0; w < missing.force.size(); ++w) {
    const FineMotion& fine = data.fine[data.windows[w].recording];
    for (size_t s = 0; s < missing.t[w].size(); ++s) {
      const Eigen::Index row = FineRow(fine, missing.t[w][s]);
      const auto col = static_cast<Eigen::Index>(s);
      out.push_back({missing.t[w][s] - fine.t[0], fine.q.col(row), fine.v.col(row), missing.force[w].col(col),
                     missing.stddev[w].col(col).cwiseMax(1e-12).cwiseAbs2().cwiseInverse()});
    }
  }
  return out;
}

}  // namespace rg::diagnosis
