#include "services/trajectories/inverse_kinematics.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>

#include "common/base/check.h"
#include "common/dynamics/dynamics.h"

namespace rg::trajectories {
namespace {

// Metres that one radian of orientation error is worth.
constexpr double kOrientationScale = 0.3;

// One start of the search; holds the scratch.
class Search {
 public:
  Search(const model::RobotModel& model, const model::Frame& frame, const TaskGoal& goal,
         const IkOptions& options)
      : mechanism_(model), frame_(frame), goal_(goal), options_(options), n_(model.num_joints()) {
    lower_ = model.LowerLimits().array() + options.position_margin;
    upper_ = model.UpperLimits().array() - options.position_margin;
    rows_ = goal.orientation ? 6 : 3;
    jacobian_.resize(6, n_);
    J_.resize(rows_, n_);
    error_.resize(rows_);
  }

  void Clamp(Eigen::VectorXd* q) const {
    for (int i = 0; i < n_; ++i) (*q)[i] = std::max(lower_[i], std::min(upper_[i], (*q)[i]));
  }

  // Uniform inside the limits; joints without limits: near ± range.
  Eigen::VectorXd RandomStart(const Eigen::VectorXd& near, Rng& rng) const {
    Eigen::VectorXd q(n_);
    for (int i = 0; i < n_; ++i) {
      const double low = std::isfinite(lower_[i]) ? lower_[i] : near[i] - options_.continuous_range;
      const double high = std::isfinite(upper_[i]) ? upper_[i] : near[i] + options_.continuous_range;
      q[i] = rng.Uniform(low, high);
    }
    return q;
  }

  // Improves q; true when both tolerances hold.
  bool Run(Eigen::VectorXd* q) {
    double damping = 1e-3;
    double cost = Linearize(*q);
    for (int i = 0; i < options_.max_iterations && !Reached(); ++i) {
      const Eigen::VectorXd trial = *q + Step(*q, damping);
      Eigen::VectorXd inside = trial;
      Clamp(&inside);
      const double trial_cost = Linearize(inside);
      if (trial_cost < cost) {
        const bool stalled = cost - trial_cost < 1e-10 * cost;
        *q = inside;
        cost = trial_cost;
        damping = std::max(0.3 * damping, 1e-9);
        if (stalled) break;
      } else {
        Linearize(*q);
        damping *= 5.0;
        if (damping > 1e6) break;
      }
    }
    return Reached();
  }

  double position_error() const { return position_error_; }
  double orientation_error() const { return orientation_error_; }

 private:
  bool Reached() const {
    return position_error_ <= options_.position_tolerance &&
           orientation_error_ <= options_.orientation_tolerance;
  }

  // Fills error_ and J_ (d error = −J dq); returns ½|error|².
  double Linearize(const Eigen::VectorXd& q) {
    const model::Pose X_WF = dynamics::FrameKinematics(mechanism_, workspace_, q, frame_, jacobian_);
    error_.head<3>() = goal_.position - X_WF.translation;
    J_.topRows(3) = jacobian_.bottomRows(3);
    position_error_ = error_.head<3>().norm();
    orientation_error_ = 0.0;
    if (goal_.orientation) {
      // Rotation vector from the present to the wanted orientation, in W.
      const Eigen::Matrix3d R = *goal_.orientation * X_WF.rotation.transpose();
      const Eigen::Vector3d axial(R(2, 1) - R(1, 2), R(0, 2) - R(2, 0), R(1, 0) - R(0, 1));
      const double sine = 0.5 * axial.norm();
      const double angle = std::atan2(sine, 0.5 * (R.trace() - 1.0));
      const Eigen::Vector3d rotation =
          sine > 1e-9 ? (angle / (2.0 * sine) * axial).eval() : (0.5 * axial).eval();
      error_.tail<3>() = kOrientationScale * rotation;
      J_.bottomRows(3) = kOrientationScale * jacobian_.topRows(3);
      orientation_error_ = angle;
    }
    return 0.5 * error_.squaredNorm();
  }

  // Damped step; joints at a limit that it pushes outwards are taken out, one more at a time.
  Eigen::VectorXd Step(const Eigen::VectorXd& q, double damping) {
    Eigen::VectorXd free = Eigen::VectorXd::Ones(n_);
    Eigen::VectorXd step = Eigen::VectorXd::Zero(n_);
    for (int round = 0; round <= n_; ++round) {
      const Eigen::MatrixXd J = J_ * free.asDiagonal();
      Eigen::MatrixXd H = J.transpose() * J;
      H.diagonal().array() += damping;
      step = H.ldlt().solve(J.transpose() * error_);
      bool blocked = false;
      for (int i = 0; i < n_; ++i) {
        if (free[i] == 0.0) continue;
        if ((q[i] <= lower_[i] && step[i] < 0.0) || (q[i] >= upper_[i] && step[i] > 0.0)) {
          free[i] = 0.0;
          blocked = true;
        }
      }
      if (!blocked) break;
    }
    // A joint should not turn over in one step.
    const double longest = step.lpNorm<Eigen::Infinity>();
    return longest > 0.5 ? (0.5 / longest * step).eval() : step;
  }

  dynamics::Mechanism mechanism_;
  dynamics::Workspace workspace_;
  model::Frame frame_;
  TaskGoal goal_;
  IkOptions options_;
  int n_, rows_;
  Eigen::VectorXd lower_, upper_, error_;
  Eigen::MatrixXd jacobian_, J_;
  double position_error_ = 0.0, orientation_error_ = 0.0;
};

std::string Unreached(const std::string& link, const TaskGoal& goal, const IkResult& result) {
  char text[256];
  std::snprintf(text, sizeof text, "link %s: %.4g m and %.4g rad short of (%.4g, %.4g, %.4g) after %d starts",
                link.c_str(), result.position_error, result.orientation_error, goal.position.x(),
                goal.position.y(), goal.position.z(), result.starts);
  return text;
}

}  // namespace

IkResult SolveInverseKinematics(const model::RobotModel& model, const TaskGoal& goal,
                                const Eigen::VectorXd& near, const IkOptions& options, Rng& rng) {
  RG_CHECK(near.size() == model.num_joints()) << near.size() << " joints";
  IkResult best;
  best.q = near;
  const std::string link = goal.link.empty() ? model.end_effector().name : goal.link;
  const auto frame = model.FindFrame(link);
  if (!frame) {
    best.message = "the model has no link " + link;
    return best;
  }
  if (!goal.position.allFinite() || (goal.orientation && !goal.orientation->allFinite())) {
    best.message = "the goal is not finite";
    return best;
  }
  Search search(model, *frame, goal, options);
  double best_distance = std::numeric_limits<double>::infinity();
  double best_error = std::numeric_limits<double>::infinity();
  for (int start = 0; start < options.max_starts && best.solutions < options.solutions; ++start) {
    Eigen::VectorXd q = start == 0 ? near : search.RandomStart(near, rng);
    search.Clamp(&q);
    const bool reached = search.Run(&q);
    for (int i = 0; i < model.num_joints(); ++i)  // the same posture, nearest turn
      if (model.joint(i).type == model::JointType::kContinuous)
        q[i] = near[i] + std::remainder(q[i] - near[i], 2.0 * std::numbers::pi);
    ++best.starts;
    best.solutions += reached;
    const double distance = (q - near).norm();
    const double error = search.position_error() + kOrientationScale * search.orientation_error();
    const bool better =
        reached ? !best.reached || distance < best_distance : !best.reached && error < best_error;
    if (!better) continue;
    best.reached = reached;
    best.q = q;
    best.position_error = search.position_error();
    best.orientation_error = search.orientation_error();
    best_distance = distance;
    best_error = error;
  }
  if (!best.reached) best.message = Unreached(link, goal, best);
  return best;
}

}  // namespace rg::trajectories
