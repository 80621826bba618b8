// Forces per unit of a coefficient (effects/inference.h) along one joint's recorded motion.
#pragma once

#include <Eigen/Core>

#include "common/effects/inference.h"
#include "services/diagnosis/data/motion.h"

namespace rg::diagnosis {

// One joint in one recording, a value per row.
struct JointMotion {
  Eigen::ArrayXd q, v, a, t;
  Eigen::ArrayXd effort;     // that the joint's gear carries
  Eigen::ArrayXd direction;  // sign of v, as sharp as v is known
};

// Of joint j, under these efforts (n × rows).
JointMotion MotionOf(const FineMotion& m, const Eigen::MatrixXd& effort, int j);

// x: the regressor's shape; y: a pulse's end, a piece's spacing to the next.
struct RegressorShape {
  double x = 0, y = 0;
};

// Of a regressor of the joint itself; kOtherEffort is the effort of the other one.
Eigen::ArrayXd ForceOf(effects::Regressor regressor, const JointMotion& m, const RegressorShape& shape);

}  // namespace rg::diagnosis
