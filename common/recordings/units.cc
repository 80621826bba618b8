// CheckUnits of csv.h.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include "common/recordings/csv.h"

namespace rg::recordings {
namespace {

constexpr double kShareOfRows = 0.05;  // so many rows must be off: a glitch is not a unit
// A robot may be thrown beyond its stops and come back. Positions are in another unit where the joint lives
// outside, or where it would travel as far as motions do: of the range of the limits this share, or half of
// it if so many rows are off.
constexpr double kTravelled = 0.1, kManyRows = 0.25;
constexpr double kFarOutside = 3.0;       // times half the range of the limits, from their middle
constexpr double kInsideMargin = 0.35;    // what a converted value may exceed its limits by
constexpr double kFastOutside = 12.0;     // times the speed limit: URDFs carry dummy limits of 1
constexpr double kFastTypical = 5.0;      // the same of the median speed
constexpr double kFastUndeclared = 60.0;  // rad/s, for joints without a speed limit: 570 turns a minute
constexpr double kUnitsTravelled = 12.0;  // less in a whole recording is no motion in degrees or millimetres
constexpr double kBlockSeconds = 0.1;     // motion is compared with velocity over such blocks
constexpr double kOtherUnit = 3.0;        // times the rate of position, and more
constexpr double kRpm = 30.0 / std::numbers::pi;
constexpr size_t kMinBlocks = 10;
constexpr double kMinCorrelation = 0.9, kExchanged = 0.98;

struct Unit {
  double per_si;  // file value / SI value
  const char* length;
  const char* wrong;
};

Unit SuspectOf(const JointInfo& joint) {
  if (joint.type == JointInfo::Type::kPrismatic) return {1000.0, "m", "millimetres"};
  return {180.0 / std::numbers::pi, "rad", "degrees"};
}

std::string Number(double value) {
  char buffer[32];
  std::snprintf(buffer, sizeof buffer, "%.4g", value);
  return buffer;
}

// First row at which x leaves [low, high] if at least `share` of all do, else -1.
template <class Row>
int FirstOutside(const Row& x, double low, double high, double share = kShareOfRows) {
  int first = -1, outside = 0;
  for (int k = 0; k < x.size(); ++k) {
    if (x[k] >= low && x[k] <= high) continue;
    if (first < 0) first = k;
    ++outside;
  }
  return outside > share * static_cast<double>(x.size()) ? first : -1;
}

template <class Row>
double Median(const Row& values) {
  std::vector<double> sorted(values.size());
  for (int k = 0; k < values.size(); ++k) sorted[k] = values[k];
  std::nth_element(sorted.begin(), sorted.begin() + sorted.size() / 2, sorted.end());
  return sorted[sorted.size() / 2];
}

bool HasLimits(const JointInfo& joint) {
  return std::isfinite(joint.lower) && std::isfinite(joint.upper) &&
         joint.type != JointInfo::Type::kContinuous && joint.upper > joint.lower;
}

// Whether values that travel so far [as in the file] could be a motion in the suspected unit.
bool CouldBeMotion(const JointInfo& joint, double travel) {
  const double range = HasLimits(joint) ? (joint.upper - joint.lower) * SuspectOf(joint).per_si : 0.0;
  return travel >= std::max(kUnitsTravelled, 0.5 * kTravelled * range);
}

template <class Row>
Status CheckPositionLimits(const std::string& place, const JointInfo& joint, const Row& q) {
  if (!HasLimits(joint)) return Status::Ok();
  const Unit unit = SuspectOf(joint);
  const double middle = 0.5 * (joint.lower + joint.upper), half = 0.5 * (joint.upper - joint.lower);
  const double margin = joint.type == JointInfo::Type::kPrismatic ? 0.1 * half : kInsideMargin;
  const double reach = kFarOutside * half + (joint.type == JointInfo::Type::kPrismatic ? 0.0 : 1.0);
  const int row = FirstOutside(q, middle - reach, middle + reach);
  if (row < 0) return Status::Ok();
  const double travel = q.maxCoeff() - q.minCoeff();
  const bool far = travel >= 2 * kTravelled * half * unit.per_si,
             often = FirstOutside(q, middle - reach, middle + reach, kManyRows) >= 0,
             lives_there = std::abs(Median(q) - middle) > reach;
  if (!lives_there && !far && !(often && CouldBeMotion(joint, travel))) return Status::Ok();
  if (FirstOutside(q / unit.per_si, joint.lower - margin, joint.upper + margin) >= 0) return Status::Ok();
  return InvalidError(place + "row " + std::to_string(row + 1) + " (line " + std::to_string(row + 2) +
                      "), column position." + joint.name + ": " + Number(q[row]) + " " + unit.length +
                      " is far outside the limits " + Number(joint.lower) + " to " + Number(joint.upper) +
                      ": visibly " + unit.wrong + ", " + unit.length + " is expected");
}

template <class Row>
Status CheckSpeedLimit(const std::string& place, const JointInfo& joint, const std::string& column,
                       double travel, const Row& speed) {
  if (speed.size() == 0) return Status::Ok();
  // A joint that would hardly have moved, were it degrees, is a light one that runs fast.
  if (!CouldBeMotion(joint, travel)) return Status::Ok();
  const bool declared = std::isfinite(joint.velocity) && joint.velocity > 0.0;
  if (!declared && joint.type == JointInfo::Type::kPrismatic) return Status::Ok();
  const Unit unit = SuspectOf(joint);
  const double far = declared ? kFastOutside * joint.velocity : kFastUndeclared;
  const int row = FirstOutside(speed, -far, far);
  if (row < 0) return Status::Ok();
  const double inside = (declared ? joint.velocity : kFastUndeclared) * unit.per_si;
  if (FirstOutside(speed, -inside, inside) >= 0) return Status::Ok();
  // A light joint may run away now and then; in degrees even an ordinary moment is too fast.
  if (declared && Median(speed.abs()) < kFastTypical * joint.velocity) return Status::Ok();
  const std::string limit = declared ? "the limit " + Number(joint.velocity)
                                     : Number(kFastUndeclared) + " (the robot declares no speed limit)";
  return InvalidError(place + "row " + std::to_string(row + 1) + " (line " + std::to_string(row + 2) +
                      "), column " + column + ": a speed of " + Number(std::abs(speed[row])) + " " +
                      unit.length + "/s is far above " + limit + ": visibly " + unit.wrong + ", " +
                      unit.length + " is expected");
}

// Motion over blocks, and the integral of the measured velocity over the same blocks.
struct Motion {
  std::vector<double> moved, integrated, seconds;
};

template <class Row>
Motion MotionOverBlocks(const Eigen::VectorXd& t, const Row& q, const Row* v) {
  Motion motion;
  int start = 0;
  double integral = 0.0;
  for (int k = 1; k < t.size(); ++k) {
    if (v) integral += 0.5 * ((*v)[k] + (*v)[k - 1]) * (t[k] - t[k - 1]);
    if (t[k] - t[start] < kBlockSeconds) continue;
    motion.moved.push_back(q[k] - q[start]);
    motion.integrated.push_back(integral);
    motion.seconds.push_back(t[k] - t[start]);
    start = k;
    integral = 0.0;
  }
  return motion;
}

// Ratio of the measured velocity to the rate of the measured position, with its sign; 1 if they hardly
// correlate.
double VelocityToRate(const Motion& motion) {
  double xx = 0.0, yy = 0.0, xy = 0.0;
  for (size_t i = 0; i < motion.moved.size(); ++i) {
    xx += motion.moved[i] * motion.moved[i];
    yy += motion.integrated[i] * motion.integrated[i];
    xy += motion.moved[i] * motion.integrated[i];
  }
  if (motion.moved.size() < kMinBlocks || xx <= 0.0 || yy <= 0.0 ||
      std::abs(xy) < kMinCorrelation * std::sqrt(xx * yy))
    return 1.0;
  return std::copysign(std::sqrt(yy / xx), xy);
}

double Correlation(const std::vector<double>& x, const std::vector<double>& y) {
  double xx = 0.0, yy = 0.0, xy = 0.0;
  for (size_t i = 0; i < x.size(); ++i) xx += x[i] * x[i], yy += y[i] * y[i], xy += x[i] * y[i];
  return xx > 0.0 && yy > 0.0 ? xy / std::sqrt(xx * yy) : 0.0;
}

// Columns of two joints that stand in each other's place.
Status CheckExchanged(const Recording& r) {
  if (!r.has_velocity() || r.n() < 2) return Status::Ok();
  std::vector<Motion> motions;
  for (int i = 0; i < r.n(); ++i) {
    const Eigen::ArrayXd q = r.q.row(i).transpose().array(), v = r.v.row(i).transpose().array();
    motions.push_back(MotionOverBlocks(r.t, q, &v));
  }
  if (motions[0].moved.size() < kMinBlocks) return Status::Ok();
  const auto follows = [&](size_t i, size_t j) {
    return Correlation(motions[i].moved, motions[j].integrated);
  };
  for (size_t i = 0; i < motions.size(); ++i) {
    for (size_t j = i + 1; j < motions.size(); ++j) {
      if (follows(i, j) < kExchanged || follows(j, i) < kExchanged || follows(i, i) > kMinCorrelation ||
          follows(j, j) > kMinCorrelation)
        continue;
      return InvalidError(r.name + ": columns velocity." + r.joints[i] + " and velocity." + r.joints[j] +
                          ": each follows the other joint's position: the columns look exchanged");
    }
  }
  return Status::Ok();
}

Status CheckVelocityAgainstRate(const std::string& place, const JointInfo& joint, const Motion& motion) {
  const Unit unit = SuspectOf(joint);
  const double ratio = VelocityToRate(motion);
  const auto near = [](double a, double b) { return a < 1.5 * b && b < 1.5 * a; };
  const std::string times = "velocity is " + Number(ratio) + " times the rate of position: ";
  if (near(-ratio, 1.0))
    return InvalidError(place + "columns position." + joint.name + " and velocity." + joint.name + ": " +
                        times + "one of them has the wrong sign");
  if (near(ratio, 1e3))
    return InvalidError(place + "column time: " + times + "time is visibly in milliseconds, s is expected");
  const bool velocity_is_wrong = near(ratio, unit.per_si), position_is_wrong = near(ratio, 1.0 / unit.per_si);
  if (!velocity_is_wrong && !position_is_wrong) {
    if (std::abs(ratio) < kOtherUnit && std::abs(ratio) > 1.0 / kOtherUnit) return Status::Ok();
    const bool turns = joint.type != JointInfo::Type::kPrismatic && near(ratio, kRpm);
    return InvalidError(place + "columns position." + joint.name + " and velocity." + joint.name + ": " +
                        times +
                        (turns ? "velocity is visibly in turns a minute, rad/s is expected"
                               : "one of them is in another unit, or of the other side of a gear; convert it, or take "
                               "the velocity columns out"));
  }
  return InvalidError(place + "row 1 (line 2), column " + (velocity_is_wrong ? "velocity." : "position.") +
                      joint.name + ": " + times + (velocity_is_wrong ? "velocity" : "position") +
                      " is visibly in " + unit.wrong + ", " + unit.length + " is expected");
}

Status CheckJoint(const std::string& place, const JointInfo& joint, const Recording& r, int i) {
  const Eigen::ArrayXd q = r.q.row(i).transpose().array();
  Eigen::ArrayXd v;
  if (r.has_velocity()) v = r.v.row(i).transpose().array();
  const Motion motion = MotionOverBlocks(r.t, q, r.has_velocity() ? &v : nullptr);
  if (r.has_velocity()) RG_RETURN_IF_ERROR(CheckVelocityAgainstRate(place, joint, motion));
  RG_RETURN_IF_ERROR(CheckPositionLimits(place, joint, q));
  const double travel = q.size() > 0 ? q.maxCoeff() - q.minCoeff() : 0.0;
  if (r.has_velocity()) return CheckSpeedLimit(place, joint, "velocity." + joint.name, travel, v);
  Eigen::ArrayXd rate(static_cast<Eigen::Index>(motion.moved.size()));
  for (Eigen::Index b = 0; b < rate.size(); ++b) {
    rate[b] = motion.moved[static_cast<size_t>(b)] / motion.seconds[static_cast<size_t>(b)];
  }
  return rate.size() > 0 ? CheckSpeedLimit(place, joint, "position." + joint.name, travel, rate)
                         : Status::Ok();
}

}  // namespace

Status CheckUnits(const Recording& recording, const std::vector<JointInfo>& robot) {
  RG_RETURN_IF_ERROR(CheckExchanged(recording));
  for (int i = 0; i < recording.n(); ++i) {
    for (const JointInfo& joint : robot) {
      if (joint.name != recording.joints[static_cast<size_t>(i)]) continue;
      RG_RETURN_IF_ERROR(CheckJoint(recording.name + ": ", joint, recording, i));
    }
  }
  return Status::Ok();
}

}  // namespace rg::recordings
