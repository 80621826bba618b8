#include "common/recordings/odd_values.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "common/base/printf.h"

namespace rg::recordings {
namespace {

using Eigen::Index;
using Eigen::VectorXd;

struct Spike {
  double times, least;
};
constexpr Spike kEffort = {1e3, 1e3}, kVelocity = {1e2, 50.0};
constexpr double kOrdinaryShare = 0.995;  // of the rows are no more than "the others": an idle axis has pulses

constexpr double kBlockSeconds = 0.2;  // and at least
constexpr int kBlockRows = 5;
constexpr int kFewestBlocks = 2;      // one after another: a position that stands still
constexpr double kMovingShare = 0.3;  // of the RMS velocity, and at least
constexpr double kMovingSpeed = 0.1;  // rad/s
constexpr double kSteps = 20.0;       // of the sensor's, passed over in a block

Status Error(const Recording& r, Index row, const std::string& column, const std::string& what) {
  return InvalidError(r.name + ": row " + std::to_string(row + 1) + ", column " + column + ": " + what);
}

double Ordinary(VectorXd x) {
  x = x.cwiseAbs();
  const auto at = x.data() + static_cast<Index>(kOrdinaryShare * static_cast<double>(x.size() - 1));
  std::nth_element(x.data(), at, x.data() + x.size());
  return *at;
}

Status CheckSpikes(const Recording& r, const std::string& column, const VectorXd& x, const Spike& spike) {
  Index row = 0;
  const double largest = x.cwiseAbs().maxCoeff(&row), others = Ordinary(x);
  if (largest <= spike.least || largest <= spike.times * others) return Status::Ok();
  return Error(r, row, column,
               Printf("%.4g", x[row]) + ", where nearly all rows have less than " + Printf("%.4g", others) +
                   ": correct the row or take it out, rows may be missing");
}

double SmallestStep(const VectorXd& q) {
  double least = std::numeric_limits<double>::infinity();
  for (Index k = 1; k < q.size(); ++k) {
    if (q[k] != q[k - 1]) least = std::min(least, std::abs(q[k] - q[k - 1]));
  }
  return std::isfinite(least) ? least : 0.0;
}

// Blocks of rows in which the position is one value and the velocity has one sign and is no rest.
Status CheckStandsStill(const Recording& r, int joint) {
  const VectorXd q = r.q.row(joint).transpose(), v = r.v.row(joint).transpose();
  const double speed =
      std::max(kMovingSpeed, kMovingShare * std::sqrt(v.squaredNorm() / static_cast<double>(v.size())));
  const double step = SmallestStep(q);
  int still = 0;
  Index start = 0, first = 0;
  for (Index k = 1; k < r.rows(); ++k) {
    const double seconds = r.t[k] - r.t[start];
    if (seconds < kBlockSeconds || k - start < kBlockRows) continue;
    const auto part = v.segment(start, k - start + 1);
    const bool moves = part.minCoeff() > speed || part.maxCoeff() < -speed,
               same = (q.segment(start, k - start + 1).array() == q[start]).all();
    if (moves && same && speed * seconds > kSteps * step) {
      if (still++ == 0) first = start;
      if (still >= kFewestBlocks) {
        Index last = first;
        while (first > 0 && q[first - 1] == q[first]) --first;
        while (last + 1 < r.rows() && q[last + 1] == q[first]) ++last;
        const std::string name = r.joints[static_cast<size_t>(joint)];
        return Error(r, first, "position." + name,
                     "stands still at " + Printf("%.6g", q[first]) + " to row " + std::to_string(last + 1) +
                         " while velocity." + name +
                         " says that the joint moves; take these rows out, or the velocity columns");
      }
    } else {
      still = 0;
    }
    start = k;
  }
  return Status::Ok();
}

}  // namespace

Status CheckOddValues(const Recording& r) {
  if (r.rows() < 2 * kBlockRows) return Status::Ok();
  for (int i = 0; i < r.n(); ++i) {
    const std::string& joint = r.joints[static_cast<size_t>(i)];
    if (r.has_effort_command())
      RG_RETURN_IF_ERROR(
          CheckSpikes(r, "effort_command." + joint, r.effort_command.row(i).transpose(), kEffort));
    if (r.has_effort_measured())
      RG_RETURN_IF_ERROR(
          CheckSpikes(r, "effort_measured." + joint, r.effort_measured.row(i).transpose(), kEffort));
    if (!r.has_velocity()) continue;
    RG_RETURN_IF_ERROR(CheckSpikes(r, "velocity." + joint, r.v.row(i).transpose(), kVelocity));
    RG_RETURN_IF_ERROR(CheckStandsStill(r, i));
  }
  return Status::Ok();
}

}  // namespace rg::recordings
