// Forces per unit coefficient of the regressors (effects/inference.h) along one joint's motion.
#pragma once

#include <Eigen/Core>

#include "common/effects/inference.h"
#include "services/diagnosis/data/motion.h"

namespace rg::diagnosis {

// One joint in one recording, a value per row.
struct JointMotion {
  Eigen::ArrayXd q, v, a, t;
  Eigen::ArrayXd effort;     // through the joint's gear
  Eigen::ArrayXd direction;  // sign of v, smoothed over the noise of v
};

// Joint j under these efforts (n × rows).
JointMotion MotionOf(const FineMotion& m, const MatrixXd& effort, int j);

// x: the regressor's shape; y: end of a pulse, or spacing of spline pieces.
struct RegressorShape {
  double x = 0, y = 0;
};

// `m`: of the joint itself; for kOtherEffort of the other joint.
Eigen::ArrayXd ForceOf(effects::Regressor regressor, const JointMotion& m, const RegressorShape& shape);

}  // namespace rg::diagnosis
