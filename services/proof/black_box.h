// The baseline that knows no physics: a residual torque learnt from the same recordings.
//
//   u + r(q, v, u) = M(q)·a + c(q, v, g) + d·v + f·sign v      with the nominal model on the right,
//   r = Wᵀ·[1, z, tanh(A·z + b)],  z = (q, v, u) scaled to unit spread and kept within the range seen.
//
// A and b are random (Rahimi & Recht 2007), W is ridge regression on the torque that the nominal model misses
// between the rows of the `fit` recordings, both sides averaged over blocks of 80 ms; its strength is chosen
// by leaving one recording out, and no residual at all is among the choices.
#pragma once

#include <Eigen/Core>

#include "common/base/rng.h"
#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "common/sim/plant.h"

namespace rg::proof {

class BlackBox {
 public:
  // Error: recordings too short to say anything.
  static Result<BlackBox> Fit(const sim::Plant& nominal, const recordings::RecordingSet& set, Rng rng);

  // r at one state and command, n [N·m or N].
  Eigen::VectorXd Residual(const Eigen::VectorXd& q, const Eigen::VectorXd& v,
                           const Eigen::VectorXd& u) const;

  // n × K positions: windows restarted from the measured state, the residual renewed every 5 ms or more
  // often. Where a simulation breaks down, its last finite position is repeated.
  Eigen::MatrixXd Predict(const recordings::Recording& recording, double window_s) const;

 private:
  explicit BlackBox(sim::Plant nominal) : nominal_(std::move(nominal)) {}
  Eigen::VectorXd Features(const Eigen::VectorXd& state) const;  // state: 3n

  sim::Plant nominal_;
  Eigen::VectorXd mean_, spread_, low_, high_;  // 3n
  Eigen::MatrixXd project_;                     // features × 3n
  Eigen::VectorXd phase_;
  Eigen::MatrixXd weights_;  // (1 + 3n + features) × n
};

}  // namespace rg::proof
