#include "services/diagnosis/data/touching_points.h"

namespace rg::diagnosis {

using Eigen::MatrixXd;

namespace {

constexpr double kSamePlace = 1e-6;  // m

}  // namespace

std::vector<TouchingPoint> TouchingPoints(const model::RobotModel& model) {
  const int last_link = model.joint(model.num_joints() - 1).child_link;
  const model::Frame hand = *model.FindFrame(model.end_effector().name),
                     last = *model.FindFrame(model.link(last_link).name);
  std::vector<TouchingPoint> out = {{hand, ""}};
  const bool same =
      hand.body == last.body && (hand.X_BF.translation - last.X_BF.translation).norm() < kSamePlace;
  if (!same) out.push_back({last, "last_link"});
  return out;
}

PointMotion MotionOf(const TouchingPoint& point, const model::RobotModel& model, const MatrixXd& q) {
  const dynamics::Mechanism mechanism(model);
  dynamics::Workspace workspace;
  MatrixXd J(6, q.rows());
  PointMotion out{MatrixXd(3, q.cols()), {}};
  out.jacobian.fill(MatrixXd(q.rows(), q.cols()));
  for (Eigen::Index k = 0; k < q.cols(); ++k) {
    const Eigen::VectorXd at = q.col(k);
    out.position.col(k) = dynamics::FrameKinematics(mechanism, workspace, at, point.frame, J).translation;
    for (int axis = 0; axis < 3; ++axis) out.jacobian[static_cast<size_t>(axis)].col(k) = J.row(3 + axis);
  }
  return out;
}

}  // namespace rg::diagnosis
