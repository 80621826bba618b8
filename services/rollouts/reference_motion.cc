#include "services/rollouts/reference_motion.h"

#include <algorithm>
#include <cmath>

#include "common/base/printf.h"
#include "common/recordings/recording_set.h"

namespace rg::rollouts {
namespace {

constexpr double kAtRest = 0.05;      // of the velocity limit
constexpr double kLongestGap = 0.25;  // s between rows
constexpr double kLongest = 600.0;    // s

// Slopes: between its neighbours, zero at both ends.
Eigen::MatrixXd SlopesOf(const Eigen::VectorXd& t, const Eigen::MatrixXd& q) {
  Eigen::MatrixXd v = Eigen::MatrixXd::Zero(q.rows(), q.cols());
  for (Eigen::Index k = 1; k + 1 < t.size(); ++k)
    v.col(k) = (q.col(k + 1) - q.col(k - 1)) / (t[k + 1] - t[k - 1]);
  return v;
}

Status Beyond(const std::string& joint, const char* what, double value, double time, double limit) {
  const std::string text =
      Printf("motion: %s has %s %.4g at %.3g s, its limit is %.4g", joint.c_str(), what, value, time, limit);
  return InvalidError(text);
}

}  // namespace

void ReferenceMotion::At(double time, Eigen::VectorXd* q_at, Eigen::VectorXd* v_at,
                         Eigen::VectorXd* a_at) const {
  const Eigen::Index last = t.size() - 1;
  const bool outside = time <= t[0] || time >= t[last];
  if (outside) {
    *q_at = q.col(time <= t[0] ? 0 : last);
    v_at->setZero(q.rows());
    a_at->setZero(q.rows());
    return;
  }
  const Eigen::Index k = std::upper_bound(t.data(), t.data() + t.size(), time) - t.data() - 1;
  const double h = t[k + 1] - t[k], s = (time - t[k]) / h;
  const auto p0 = q.col(k), p1 = q.col(k + 1);
  const Eigen::VectorXd m0 = h * v.col(k), m1 = h * v.col(k + 1);
  *q_at = p0 + s * m0 + s * s * (3 * (p1 - p0) - 2 * m0 - m1) + s * s * s * (2 * (p0 - p1) + m0 + m1);
  *v_at = (m0 + 2 * s * (3 * (p1 - p0) - 2 * m0 - m1) + 3 * s * s * (2 * (p0 - p1) + m0 + m1)) / h;
  *a_at = (2 * (3 * (p1 - p0) - 2 * m0 - m1) + 6 * s * (2 * (p0 - p1) + m0 + m1)) / (h * h);
}

Result<ReferenceMotion> ParseMotion(std::string_view csv, const std::string& source,
                                    const model::RobotModel& robot) {
  recordings::CsvOptions options = recordings::CsvOptionsFor(robot);
  options.require_effort = false;
  RG_ASSIGN_OR_RETURN(const recordings::Recording rows, recordings::ParseCsv(csv, source, options));
  if (rows.rows() < 2) return InvalidError(source + ": a motion needs at least two rows");
  ReferenceMotion motion;
  motion.joints = rows.joints;
  motion.t = rows.t.array() - rows.t[0];
  motion.q = rows.q;
  motion.v = rows.has_velocity() ? rows.v : SlopesOf(rows.t, rows.q);
  return motion;
}

Status CheckMotion(const ReferenceMotion& motion, const MotionBounds& bounds) {
  if (motion.duration_s() > kLongest)
    return InvalidError("motion: it lasts " + std::to_string(motion.duration_s()) + " s, the limit is 600 s");
  for (Eigen::Index k = 0; k < motion.t.size(); ++k) {
    if (k > 0 && motion.t[k] - motion.t[k - 1] > kLongestGap)
      return InvalidError("motion: no row between " + std::to_string(motion.t[k - 1]) + " s and " +
                          std::to_string(motion.t[k]) + " s; rows may be 0.25 s apart at most");
    for (Eigen::Index j = 0; j < motion.q.rows(); ++j) {
      const std::string& joint = motion.joints[static_cast<size_t>(j)];
      const double q = motion.q(j, k), v = motion.v(j, k);
      if (!(q >= bounds.lower[j])) return Beyond(joint, "position", q, motion.t[k], bounds.lower[j]);
      if (!(q <= bounds.upper[j])) return Beyond(joint, "position", q, motion.t[k], bounds.upper[j]);
      if (!(std::abs(v) <= bounds.velocity[j]))
        return Beyond(joint, "velocity", v, motion.t[k], bounds.velocity[j]);
      if (k == 0 && std::abs(v) > kAtRest * bounds.velocity[j])
        return InvalidError("motion: " + joint + " begins at " + std::to_string(v) +
                            " (rad/s or m/s), it must begin at rest");
    }
  }
  return Status::Ok();
}

}  // namespace rg::rollouts
