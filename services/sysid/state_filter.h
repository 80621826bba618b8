// An extended Kalman filter over the model itself: the state at a row from the rows up to it.
//
// Prediction between rows is the simulator's own step with its exact linearisation; the measurement is
// position and, where there is one, velocity. What the model leaves out enters as a white acceleration
// of each joint, whose strength adapts to the innovations (covariance matching): where the model is
// right it falls to almost nothing and the state is smoothed over many rows, hidden states included;
// where the model is wrong it rises and the sensors lead. A step that is not finite starts the filter
// anew at its row.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "common/recordings/noise.h"
#include "common/recordings/recording.h"
#include "common/sim/command_signal.h"
#include "common/sim/plant.h"
#include "common/sim/simulator.h"

namespace rg::sysid {

// Puts the prescribed joints of a state where the command's motion has them at `time`.
void PlacePrescribed(const sim::CommandSignal& command, double time, sim::State* x);

class StateFilter {
 public:
  // All outlive the filter. `gravity_torque` (or null) is added to the command at the filter's position:
  // what a drive with its own gravity compensation does.
  using DriveTorque = std::function<void(const Eigen::VectorXd& q, Eigen::VectorXd* torque)>;
  StateFilter(sim::Simulator* simulator, const recordings::Recording& recording,
              const sim::CommandSignal& command, const recordings::SensorNoise& noise,
              DriveTorque drive_torque = {});

  // Takes rows in up to and including `row` (not before the last call's) and returns the state there.
  // Prescribed joints are where the command's motion says.
  const sim::State& StateAt(int row);

 private:
  void Start(int row);
  void Step(int row);
  bool Propagate(double begin, double end);
  void Correct(int row);
  void PlaceSensors();
  void FindLatePositions();
  double PositionVariance(int joint) const;
  void Update(int index, int other, double slope, double innovation, double variance);

  sim::Simulator& simulator_;
  const recordings::Recording& recording_;
  const sim::CommandSignal& command_;
  DriveTorque drive_torque_;
  Eigen::VectorXd position_variance_, velocity_variance_;
  int n_, nx_;
  // Per joint: the place in (q, v, z) of what its encoder sees; the motor's where it sits there.
  std::vector<int> position_index_, velocity_index_;
  Eigen::VectorXd late_;  // s, by which a joint's position is old
  int row_ = -1;
  sim::State x_;
  sim::Linearization lin_;
  Eigen::MatrixXd P_;
  Eigen::VectorXd log_acceleration_;  // of the process noise, per joint, rad/s² per sqrt(Hz)
};

}  // namespace rg::sysid
