#include "common/recordings/angles.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "common/base/printf.h"

namespace rg::recordings {
namespace {

constexpr double kTurn = 2.0 * std::numbers::pi;
constexpr double kLeastJump = 1.0;       // rad
constexpr double kAcceleration = 400.0;  // rad/s²: half of it bends a step by as much
constexpr double kLongestStep = 0.1;     // s
constexpr double kMargin = 0.35;         // rad beyond a limit, as units.cc allows

using Row = Eigen::VectorXd;

double JumpFrom(double dt) { return std::max(kLeastJump, kAcceleration * dt * dt); }

// What step k (from row k to k + 1) has beyond the speed of the step before it or of the one behind it,
// whichever is less.
double Excess(const Eigen::VectorXd& t, const Row& q, Eigen::Index k) {
  const double dt = t[k + 1] - t[k], step = q[k + 1] - q[k];
  double excess = step;
  const auto compare = [&](Eigen::Index other) {
    if (other < 0 || other + 1 >= t.size()) return;
    const double span = t[other + 1] - t[other];
    if (span > kLongestStep && dt <= kLongestStep) return;
    const double expected = (q[other + 1] - q[other]) / span * dt;
    if (std::abs(step - expected) < std::abs(excess)) excess = step - expected;
  };
  compare(k - 1);
  compare(k + 1);
  return excess;
}

bool IsTurn(double excess, double dt) {
  return std::abs(std::abs(excess) - kTurn) < std::min(JumpFrom(dt), 0.4 * kTurn);
}

struct Unwrapped {
  Row q;                             // turns added
  Row turns;                         // rad
  std::optional<Eigen::Index> jump;  // the first step that is a jump but no turn
  std::optional<Eigen::Index> first_turn;
};

Unwrapped Unwrap(const Eigen::VectorXd& t, const Row& q) {
  Unwrapped out{q, Row::Zero(q.size()), {}, {}};
  double offset = 0.0;
  for (Eigen::Index k = 0; k + 1 < t.size(); ++k) {
    const double dt = t[k + 1] - t[k];
    if (std::abs(q[k + 1] - q[k]) > kLeastJump) {
      const double excess = Excess(t, q, k);
      if (std::abs(excess) > JumpFrom(dt) || dt > kLongestStep) {
        if (IsTurn(excess, dt)) {
          offset -= std::copysign(kTurn, excess);
          if (!out.first_turn) out.first_turn = k;
        } else if (dt <= kLongestStep && !out.jump) {
          out.jump = k;
        }
      }
    }
    out.turns[k + 1] = offset;
    out.q[k + 1] = q[k + 1] + offset;
  }
  return out;
}

// The turns to add so that q lies within the limits; none if no number of turns does.
std::optional<int> TurnsIntoLimits(const JointInfo& joint, const Row& q) {
  if (joint.type == JointInfo::Type::kContinuous) return 0;
  for (const int turns : {0, 1, -1, 2, -2}) {
    const double low = q.minCoeff() + turns * kTurn, high = q.maxCoeff() + turns * kTurn;
    if (low >= joint.lower - kMargin && high <= joint.upper + kMargin) return turns;
  }
  return std::nullopt;
}

Status JumpError(const Recording& r, const JointInfo& joint, Eigen::Index k, const Row& q,
                 const std::string& why) {
  return InvalidError(r.name + ": row " + std::to_string(k + 2) + ", column position." + joint.name +
                      ": jumps from " + Printf("%.4g", q[k]) + " to " + Printf("%.4g", q[k + 1]) +
                      " within " + Printf("%.4g", r.t[k + 1] - r.t[k]) + " s: " + why);
}

Status UnwrapJoint(const JointInfo& joint, int i, Recording* r) {
  const Row q = r->q.row(i).transpose();
  Unwrapped unwrapped = Unwrap(r->t, q);
  if (unwrapped.jump) {
    return JumpError(*r, joint, *unwrapped.jump, q,
                     "no arm moves so fast, and it is no full turn; correct the row or take it out");
  }
  if (!unwrapped.first_turn) return Status::Ok();
  const std::optional<int> turns = TurnsIntoLimits(joint, unwrapped.q);
  if (!turns) {
    return JumpError(*r, joint, *unwrapped.first_turn, q,
                     "a full turn, but unwrapped the motion leaves the joint's limits " +
                         Printf("%.4g", joint.lower) + " to " + Printf("%.4g", joint.upper));
  }
  if (r->turns_added.size() == 0) r->turns_added = Eigen::MatrixXd::Zero(r->n(), r->rows());
  r->turns_added.row(i) = (unwrapped.turns.array() + *turns * kTurn).transpose();
  r->q.row(i) += r->turns_added.row(i);
  r->notes.push_back("position." + joint.name + " jumps by full turns (an angle that wraps): unwrapped");
  return Status::Ok();
}

}  // namespace

Status UnwrapAngles(const std::vector<JointInfo>& robot, Recording* r) {
  for (int i = 0; i < r->n(); ++i) {
    for (const JointInfo& joint : robot) {
      if (joint.name != r->joints[static_cast<size_t>(i)] || joint.type == JointInfo::Type::kPrismatic)
        continue;
      RG_RETURN_IF_ERROR(UnwrapJoint(joint, i, r));
    }
  }
  return Status::Ok();
}

Eigen::MatrixXd InFilesWrapping(const Recording& r, Eigen::MatrixXd q) {
  if (r.turns_added.size() > 0) q -= r.turns_added;
  return q;
}

}  // namespace rg::recordings
