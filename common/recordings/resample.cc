#include "common/recordings/resample.h"

#include <algorithm>
#include <cmath>

#include "common/base/check.h"

namespace rg::recordings {

int RowAt(const Eigen::VectorXd& t, double time) {
  const auto* begin = t.data();
  const auto* after = std::upper_bound(begin, begin + t.size(), time);
  return std::max(0, static_cast<int>(after - begin) - 1);
}

Eigen::MatrixXd InterpolateLinear(const Eigen::VectorXd& t, const Eigen::MatrixXd& x,
                                  const Eigen::VectorXd& times) {
  RG_CHECK(t.size() == x.cols() && t.size() > 0) << t.size() << " times for " << x.cols() << " columns";
  Eigen::MatrixXd out(x.rows(), times.size());
  for (Eigen::Index i = 0; i < times.size(); ++i) {
    const int k = RowAt(t, times[i]);
    if (times[i] <= t[0] || k + 1 >= t.size()) {
      out.col(i) = x.col(k);
      continue;
    }
    const double share = (times[i] - t[k]) / (t[k + 1] - t[k]);
    out.col(i) = x.col(k) + share * (x.col(k + 1) - x.col(k));
  }
  return out;
}

Eigen::MatrixXd InterpolateZeroOrder(const Eigen::VectorXd& t, const Eigen::MatrixXd& x,
                                     const Eigen::VectorXd& times) {
  RG_CHECK(t.size() == x.cols() && t.size() > 0) << t.size() << " times for " << x.cols() << " columns";
  Eigen::MatrixXd out(x.rows(), times.size());
  for (Eigen::Index i = 0; i < times.size(); ++i) out.col(i) = x.col(RowAt(t, times[i]));
  return out;
}

Recording Resample(const Recording& r, const Eigen::VectorXd& times) {
  Recording out = r;
  out.t = times;
  out.q = InterpolateLinear(r.t, r.q, times);
  if (r.has_velocity()) out.v = InterpolateLinear(r.t, r.v, times);
  if (r.has_effort_command()) out.effort_command = InterpolateZeroOrder(r.t, r.effort_command, times);
  if (r.has_effort_measured()) out.effort_measured = InterpolateLinear(r.t, r.effort_measured, times);
  for (auto& [name, column] : out.other) {
    const Eigen::MatrixXd row = column.transpose();
    column = InterpolateLinear(r.t, row, times).transpose();
  }
  return out;
}

Recording ResampleAtRate(const Recording& recording, double rate_hz) {
  RG_CHECK(rate_hz > 0.0) << "rate of " << rate_hz << " Hz";
  RG_CHECK(recording.rows() > 0) << recording.name << " has no rows";
  const double span = recording.t[recording.rows() - 1] - recording.t[0];
  const auto count = static_cast<Eigen::Index>(std::floor(span * rate_hz + 1e-6)) + 1;
  Eigen::VectorXd times(count);
  for (Eigen::Index i = 0; i < count; ++i) times[i] = recording.t[0] + static_cast<double>(i) / rate_hz;
  return Resample(recording, times);
}

}  // namespace rg::recordings
