// The windows of recordings simulated, and linearised node by node, for the fits of lifted_fit.h.
//
// Every worker has a simulator of its own: calls with different workers may be made at once. All but
// SetValues leave what others read as it is.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "services/diagnosis/likelihood/lifted_fit.h"
#include "services/diagnosis/likelihood/linear_window.h"

namespace rg::diagnosis {

inline constexpr int kTogether = 8;         // windows that are simulated side by side
inline constexpr double kSettleTime = 0.5;  // s before a window from which hidden states are simulated

// A plant with a constant torque of size zero on each joint, whose sensitivities are the columns B of
// lifted_fit.h.
struct Probe {
  sim::Plant plant;
  VectorXd values;
  std::vector<int> torque;  // parameter index per joint, −1: none
};

// Without the torque on joints that can take no further effect of either kind.
Probe MakeProbe(const FitModel& model, bool with_torque);

class Lineariser {
 public:
  // `data` outlives it. `with_torque`: linearises in torques on joints too, for features.
  Lineariser(const FitData& data, const FitModel& model, bool with_torque, const LiftedOptions& options);
  ~Lineariser();

  int nx() const { return nx_; }
  int P() const { return P_; }
  int RowsOf(const NodeWindow& w) const;
  bool has_gaps() const { return !gaps_.empty(); }
  // Per joint: place of the motor's position among the internal states where the encoder sits on the motor,
  // or −1.
  const std::vector<int>& sensed_motors() const { return sensed_motors_; }
  // s before a window from which its lags are simulated; 0: they are free states.
  double Memory() const;
  void SetValues(const FitModel& model, const VectorXd& values);
  // n: what each joint's sensor reads too much; recorded positions less that are where the joints were.
  const VectorXd& sensor_offsets() const { return sensor_offsets_; }
  sim::State MakeState(int worker, const VectorXd& q, const VectorXd& v, double t, int recording);

  // states: nx × (N + 1). phi: C × N or null. `keep`: the sensitivities of all nodes.
  void Run(int worker, int index, const MatrixXd& states, const std::vector<int>* joint, const MatrixXd* phi,
           bool keep, Linear* out);

  // (y − ŷ)/σ of a window, or of the first `part` of its nodes, simulated from x_0 in one go, rows in the
  // order of Run; where the motion of prescribed joints is in doubt, what is left of it when rows are made
  // independent.
  VectorXd Residuals(int worker, int index, const VectorXd& x0, double part = 1.0);
  // The same of several windows side by side, each from its own x_0.
  std::vector<VectorXd> Residuals(int worker, const std::vector<int>& indices,
                                  const std::vector<VectorXd>& x0, double part = 1.0);
  // Σ ((y − ŷ)/σ)² of them; far residuals softened.
  std::vector<double> Simulated(int worker, const std::vector<int>& indices, const std::vector<VectorXd>& x0,
                                double part = 1.0);
  // χ² of a window whose simulation broke at once.
  double WorstChi2(int index) const;

  // Restarts a window at the recorded state, at the recorded velocities, or, if there are hidden states,
  // where the window before ended (`before`, null: none), if its χ² is less from there; writes the simulated
  // states, nx × (N + 1).
  void TryRecordedStart(int worker, int index, const VectorXd* before, MatrixXd* states, double* chi2);
  // A window simulated from x_0 in one go, at these times in it; valid until the worker's next run.
  const sim::Trajectory& SimulatedAt(int worker, int index, const VectorXd& x0,
                                     const std::vector<double>& times);
  // Replaces a window's states by a simulation from its start; unchanged where that fails.
  void Simulate(int worker, int index, MatrixXd* states);
  // Simulates hidden states node by node along the recorded motion, in place. With the encoder on the motor
  // the link is the hidden one.
  void CarryHidden(int worker, const NodeWindow& window, const std::vector<int>& motor, MatrixXd* states);
  // Multi-start over the contact of a gear with play: the link lies on either face or between them, at rest
  // against the motor or moving, and no gradient leads from one to the other. Takes the start with the least
  // χ² if that is below `best`, the χ² of the present start; returns the χ². `before`: end state of the
  // window before, or null. `closely`: also between the starts of the grid.
  double ChooseFace(int worker, int index, const VectorXd* before, bool closely, double best,
                    MatrixXd* states);

 private:
  struct Worker;
  struct Gap {
    int joint, parameter, inertia, motor;  // place of the motor's position among the internal states
    bool reads_motor;
  };
  struct Lag {
    int state, time_constant;  // row of the state, place among the parameters
  };

  void ReadSensorOffsets();
  void FindGaps();
  void FindLags();
  void FreeStarts();
  std::vector<int> Columns(const FitModel& model);

  // A window's start `x` with the motor `ahead` of its link, and `faster`; what the sensor reads stays.
  VectorXd AcrossGap(const Gap& gap, VectorXd x, double ahead, double faster) const;
  // From a window's start by steps across the gap (`ahead`, `faster`), halved where none is better; χ².
  double Descend(int worker, int index, const Gap& gap, double ahead, double faster, double best,
                 MatrixXd* states);

  void TieLags(const NodeWindow& window, const VectorXd& x0, Worker* w, MutableRows E) const;
  bool Recorded(int recording, double from, double to) const;
  void RunNodes(const NodeWindow& window, const MatrixXd& states, Worker* w) const;
  VectorXd MeanBeyond(const Worker& w, const NodeWindow& window, int node, bool speed) const;
  void WriteRows(const Worker& w, const NodeWindow& window, int node, int run, int output, const Rows& E,
                 int acting, const std::vector<int>* joint, const MatrixXd* phi, Linear* out, int* row) const;

  const sim::CommandSignal& CommandOf(const NodeWindow& window) const;
  void SetState(const Eigen::Ref<const VectorXd>& stacked, double time, sim::State* x) const;
  const sim::Trajectory& RunFrom(const NodeWindow& window, const VectorXd& x0,
                                 const std::vector<double>& times, Worker* w) const;
  VectorXd Residuals(const NodeWindow& window, const sim::Trajectory& simulated, double part) const;

  const FitData& data_;
  Probe probe_;
  LiftedOptions options_;
  const int n_ = data_.n, P_, nx_;
  std::vector<int> sensed_motors_, torque_column_;
  VectorXd sensor_offsets_;
  MatrixXd starts_;  // nx × nx
  std::vector<Gap> gaps_;
  std::vector<Lag> lags_;
  std::vector<int> delays_;  // of commands, places among the parameters
  std::vector<std::unique_ptr<Worker>> workers_;
};

// Residuals of these windows, simulated from the starts of their states (of all windows).
std::vector<VectorXd> ResidualsFrom(const NodeStates& states, const std::vector<int>& windows, int threads,
                                    Lineariser& lin);

}  // namespace rg::diagnosis
