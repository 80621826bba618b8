// Recordings made ready for the diagnosis: nodes to fit at, and a smooth motion between them.
#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

#include "common/recordings/noise.h"
#include "common/recordings/recording.h"
#include "common/sim/command_signal.h"

namespace rg::diagnosis {

using Eigen::MatrixXd;
using Eigen::VectorXd;

inline constexpr double kMovesBy = 20.0;  // stddevs of the position, from which a joint counts as moving

// Position, velocity and acceleration of one recording at any time, from local cubics through measured
// positions and, where there are any, velocities, each weighted by its noise.
class SmoothMotion {
 public:
  // `least_span`: half of the time that a cubic reaches over, at least [s].
  SmoothMotion(const recordings::Recording& recording, const recordings::SensorNoise& noise,
               double least_span = 0.05);
  // n each.
  void At(double t, VectorXd* q, VectorXd* v, VectorXd* a) const;
  double half_span() const { return half_span_; }

 private:
  const recordings::Recording* recording_;
  VectorXd weight_q_, weight_v_;  // n, 1/stddev
  double half_span_ = 0.05;
};

// One window of a recording, cut into short intervals by N + 1 nodes. Rows closer together than a node
// interval are averaged into their node, so that no information is lost; a model is compared by the average
// of its outputs at the same times, for within them a motion bends and a command may step.
struct NodeWindow {
  int recording = 0;
  std::vector<double> t;                           // N + 1
  std::vector<char> measured;                      // N + 1
  std::vector<std::vector<double>> before, after;  // N + 1: times of the other rows averaged into a node
  MatrixXd q, v;                                   // n × (N + 1), where measured: mean of the rows
  MatrixXd q_stddev, v_stddev;                     // n × (N + 1) of it
  MatrixXd q_row, v_row;                           // n × (N + 1): its own row alone
  MatrixXd q0, v0;                                 // n × (N + 1): the smooth motion
  // Effect of the uncertainty of prescribed joints' motion on the others (prepare_data.cc), or empty:
  // n·(N + 1) × ways, node by node; and the Cholesky factor of the whitened residuals' covariance.
  MatrixXd q_doubt, v_doubt, factor;
};

// Its matrices with a column per node.
inline constexpr MatrixXd NodeWindow::*kNodeMatrices[] = {
    &NodeWindow::q,     &NodeWindow::v,     &NodeWindow::q_stddev, &NodeWindow::v_stddev,
    &NodeWindow::q_row, &NodeWindow::v_row, &NodeWindow::q0,       &NodeWindow::v0};

// Whether `window` begins at most 50 ms after `before` ends, in the same recording.
bool FollowsOn(const NodeWindow& before, const NodeWindow& window);

// What features of the force are made of: the motion and the command of one recording on a fine grid.
struct FineMotion {
  std::vector<double> t;  // F
  MatrixXd q, v, a, u;    // n × F
  std::vector<std::pair<double, double>>
      gaps;  // from one row to the next [s], where rows between are missing
};

struct NodeOptions {
  double window_s = 1.0;
  double interval_s = 0.01;  // longest interval between nodes
  // No window begins earlier in a recording than this: a late drive still follows commands from before it.
  double unknown_s = 0.1;
  double late_s = 0.05;  // nor sooner than this after a gap of rows, where that leaves enough
  int fine_per_interval = 4;
};

std::vector<NodeWindow> CutIntoNodes(const recordings::Recording& recording, int index,
                                     const SmoothMotion& motion, const recordings::SensorNoise& noise,
                                     const NodeOptions& options);
// Computes `factor` from the doubts and stddevs; empty v_doubt: rows are positions only.
void SetFactor(NodeWindow* window);
// The same nodes in windows of about `piece_s`, but never less than three measured nodes. Where a piece
// begins or ends within a window, a node is its own row alone.
std::vector<NodeWindow> InPieces(const std::vector<NodeWindow>& windows, double piece_s,
                                 const recordings::SensorNoise& noise);
// Stddev of the mean of positions quantised in steps of `resolution`, read at times `t` of a motion at speed
// `speed`. `stddev`: of one reading, quantisation included. A reading's error by quantisation is a sawtooth
// over position, which the sensor's other noise blurs: where the motion is less than a step its mean is no
// smaller.
double StddevOfMean(const std::vector<double>& t, double speed, double stddev, double resolution);
FineMotion FineMotionOf(const recordings::Recording& recording, const sim::CommandSignal& command,
                        const SmoothMotion& motion, const NodeOptions& options);

}  // namespace rg::diagnosis
