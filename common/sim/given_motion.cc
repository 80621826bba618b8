#include "common/sim/given_motion.h"

#include <algorithm>
#include <string>
#include <utility>

namespace rg::sim {
namespace {

constexpr int kSteps = 8;  // from where even rows would have a time, before it is looked for

}  // namespace

int SegmentAt(const std::vector<double>& times, double t) {
  const int last = static_cast<int>(times.size()) - 1;
  if (!(t > times.front())) return 0;
  if (t >= times.back()) return last;
  // Rows are nearly even as a rule: a few steps from where they would be if they were.
  int k = static_cast<int>(last * (t - times.front()) / (times.back() - times.front()));
  for (int step = 0; step < kSteps; ++step) {
    if (t < times[k]) {
      --k;
    } else if (k < last && t >= times[k + 1]) {
      ++k;
    } else {
      return k;
    }
  }
  const auto next = std::upper_bound(times.begin(), times.end(), t);
  return static_cast<int>(next - times.begin()) - 1;
}

Result<GivenMotion> GivenMotion::Create(std::vector<int> joints, std::vector<double> times, Eigen::MatrixXd q,
                                        Eigen::MatrixXd v, Eigen::MatrixXd a) {
  const auto rows = static_cast<Eigen::Index>(joints.size()), count = static_cast<Eigen::Index>(times.size());
  if (count == 0) return InvalidError("a given motion without knots");
  for (const Eigen::MatrixXd* x : {&q, &v, &a}) {
    if (x->rows() != rows || x->cols() != count) return InvalidError("a given motion of the wrong shape");
    if (!x->allFinite()) return InvalidError("a given motion that is not finite");
  }
  if (!std::is_sorted(joints.begin(), joints.end(), std::less_equal<>()))
    return InvalidError("a given motion whose joints are not ascending");
  for (Eigen::Index k = 1; k < count; ++k) {
    if (!(times[k] > times[k - 1]))
      return InvalidError("knot " + std::to_string(k) + " of a given motion: time does not increase");
  }
  GivenMotion out;
  out.joints_ = std::move(joints), out.times_ = std::move(times);
  out.q_ = std::move(q), out.v_ = std::move(v), out.a_ = std::move(a);
  return out;
}

GivenMotion::Point GivenMotion::At(int i, double t) const {
  const int k = SegmentAt(times_, t), last = static_cast<int>(times_.size()) - 1;
  if (k == last || t <= times_.front()) {
    return {q_(i, k) + v_(i, k) * (t - times_[k]), v_(i, k)};
  }
  // Hermite's quintic over s in [0, 1]: q0, h·v0, h²·a0 at its begin, the same at its end.
  const double h = times_[k + 1] - times_[k], s = (t - times_[k]) / h;
  const double p0 = q_(i, k), v0 = h * v_(i, k), a0 = h * h * a_(i, k);
  const double step = q_(i, k + 1) - p0, v1 = h * v_(i, k + 1), a1 = h * h * a_(i, k + 1);
  const double c3 = 10 * step - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1;
  const double c4 = -15 * step + 8 * v0 + 7 * v1 + 1.5 * a0 - a1;
  const double c5 = 6 * step - 3 * (v0 + v1) + 0.5 * (a1 - a0);
  return {p0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5)))),
          (v0 + s * (a0 + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / h};
}

}  // namespace rg::sim
