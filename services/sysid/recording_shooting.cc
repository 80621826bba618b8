#include "services/sysid/recording_shooting.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/base/check.h"
#include "common/recordings/windows.h"

namespace rg::sysid {

using Eigen::MatrixXd;
using Eigen::VectorXd;

struct RecordingShooting::Window {
  const FitRecording* fit = nullptr;
  double start = 0.0;
  VectorXd q0, v0;            // measured or smoothed, at the first row
  std::vector<double> times;  // of the residuals
  MatrixXd q, v;              // n × times, measured; v empty where it is not used
};

struct RecordingShooting::Worker {
  Worker(const sim::Plant& plant, const sim::SimulatorOptions& options, VectorXd values)
      : simulator(plant, options), values(std::move(values)) {}
  sim::Simulator simulator;
  VectorXd values;
  sim::SensitivityRequest request;
  sim::Trajectory out;
  std::vector<sim::SimulationWindow> runs;
  std::vector<sim::Trajectory> outs;  // of the runs
};

namespace {

// Rows first + 1 … last, evenly thinned to about `rate`; the last one is always there.
std::vector<int> ThinnedRows(const VectorXd& t, int first, int last, double rate) {
  const double duration = t[last] - t[first];
  const int wanted = std::max(1, static_cast<int>(std::lround(duration * rate)));
  const int stride = std::max(1, (last - first) / wanted);
  std::vector<int> rows;
  for (int row = last; row > first; row -= stride) rows.push_back(row);
  std::reverse(rows.begin(), rows.end());
  return rows;
}

// Evenly, so that every recording keeps its share.
template <class Window>
void ThinWindows(int most, std::vector<Window>* windows) {
  const size_t count = windows->size();
  if (static_cast<int>(count) <= most) return;
  std::vector<Window> kept;
  for (int k = 0; k < most; ++k) kept.push_back(std::move((*windows)[k * count / most]));
  *windows = std::move(kept);
}

double RobustSpread(std::vector<double>& values) {
  if (values.empty()) return 0.0;
  for (double& x : values) x = std::abs(x);
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return 1.4826 * values[values.size() / 2];
}

}  // namespace

ShootingScales ScalesOf(const recordings::SensorNoise& noise) {
  return {noise.position_stddev, noise.velocity_stddev, noise.position_stddev, noise.velocity_stddev};
}

RecordingShooting::RecordingShooting(const sim::Plant& plant, const VectorXd& values, const FitSpace& space,
                                     const std::vector<FitRecording>& recordings,
                                     const ShootingScales& scales, const RecordingShootingOptions& options,
                                     int workers)
    : n_(plant.num_joints()),
      nz_(options.internal_state_stddev > 0.0 ? plant.num_internal_states() : 0),
      P_(space.size()),
      space_(space),
      scales_(scales),
      options_(options) {
  with_velocity_ = options.use_velocity && !recordings.empty();
  for (const FitRecording& fit : recordings) with_velocity_ = with_velocity_ && fit.recording->has_velocity();
  for (const FitRecording& fit : recordings) {
    const recordings::Recording& rec = *fit.recording;
    const MatrixXd v = recordings::VelocityOrEstimate(rec);
    for (const recordings::Window& w : recordings::SplitIntoWindows(rec, options.window_s)) {
      Window window;
      window.fit = &fit;
      window.start = rec.t[w.first];
      window.q0 = rec.q.col(w.first);
      window.v0 = v.col(w.first);
      const std::vector<int> rows = ThinnedRows(rec.t, w.first, w.last, options.residual_rate_hz);
      window.q.resize(n_, rows.size());
      if (with_velocity_) window.v.resize(n_, rows.size());
      for (size_t k = 0; k < rows.size(); ++k) {
        window.times.push_back(rec.t[rows[k]]);
        window.q.col(k) = rec.q.col(rows[k]);
        if (with_velocity_) window.v.col(k) = rec.v.col(rows[k]);
      }
      windows_.push_back(std::move(window));
    }
  }
  ThinWindows(options.max_windows, &windows_);
  for (int w = 0; w < std::max(1, workers); ++w) {
    workers_.push_back(std::make_unique<Worker>(plant, options.simulator, values));
    workers_.back()->request = {.initial_state = true, .parameters = Indices(space.parameters())};
  }
}

RecordingShooting::~RecordingShooting() = default;

int RecordingShooting::num_parameters() const { return P_; }
int RecordingShooting::num_windows() const { return static_cast<int>(windows_.size()); }
int RecordingShooting::window_unknowns(int) const { return 2 * n_ + nz_; }
int RecordingShooting::window_residuals(int window) const {
  return static_cast<int>(windows_[window].q.size() + windows_[window].v.size());
}

sim::State RecordingShooting::StartOf(const Worker& w, const Window& window, const VectorXd& xi) const {
  const VectorXd q0 = window.q0 + scales_.initial_position.cwiseProduct(xi.head(n_));
  const VectorXd v0 = window.v0 + scales_.initial_velocity.cwiseProduct(xi.segment(n_, n_));
  sim::State x0 = w.simulator.MakeState(q0, v0, window.start, window.fit->command);
  if (nz_ > 0) x0.z += options_.internal_state_stddev * xi.tail(nz_);
  return x0;
}

bool RecordingShooting::WriteWindow(const Window& window, const sim::Trajectory& out, const VectorXd& theta,
                                    VectorXd* r, RowMatrix* dr_dtheta, RowMatrix* dr_dxi) const {
  if (!out.outcome.ok()) return false;
  WriteResiduals(window, out, r);
  if (dr_dtheta != nullptr) {
    WriteJacobians(window, out, dr_dtheta, dr_dxi);
    space_.PullBack(theta, dr_dtheta);
  }
  return true;
}

bool RecordingShooting::Evaluate(int worker, int index, const VectorXd& theta, const VectorXd& xi,
                                 VectorXd* r, RowMatrix* dr_dtheta, RowMatrix* dr_dxi) {
  Worker& w = *workers_[worker];
  const Window& window = windows_[index];
  w.values = space_.Values(theta, std::move(w.values));
  w.simulator.SetParameters(w.values);
  w.simulator.SimulateInto(StartOf(w, window, xi), window.fit->command, window.times,
                           dr_dtheta != nullptr ? w.request : sim::SensitivityRequest{}, &w.out);
  return WriteWindow(window, w.out, theta, r, dr_dtheta, dr_dxi);
}

int RecordingShooting::side_by_side() const { return num_windows() > 1 ? workers_[0]->simulator.lanes() : 1; }

void RecordingShooting::EvaluateMany(int worker, const VectorXd& theta,
                                     std::vector<Evaluation>* evaluations) {
  if (side_by_side() == 1 || evaluations->empty()) {
    return ShootingModel::EvaluateMany(worker, theta, evaluations);
  }
  Worker& w = *workers_[worker];
  w.values = space_.Values(theta, std::move(w.values));
  w.simulator.SetParameters(w.values);
  w.runs.clear();
  for (const Evaluation& e : *evaluations) {
    const Window& window = windows_[e.window];
    w.runs.push_back({StartOf(w, window, *e.xi), &window.fit->command, &window.times});
  }
  const bool with_jacobian = evaluations->front().dr_dtheta != nullptr;
  w.simulator.SimulateWindows(w.runs, with_jacobian ? w.request : sim::SensitivityRequest{}, &w.outs);
  for (size_t k = 0; k < evaluations->size(); ++k) {
    Evaluation& e = (*evaluations)[k];
    e.ok = WriteWindow(windows_[e.window], w.outs[k], theta, e.r, e.dr_dtheta, e.dr_dxi);
  }
}

void RecordingShooting::WriteResiduals(const Window& window, const sim::Trajectory& out, VectorXd* r) const {
  const int K = static_cast<int>(window.times.size()), m = K * n_;
  for (int k = 0; k < K; ++k) {
    r->segment(k * n_, n_) = (out.position.col(k) - window.q.col(k)).cwiseQuotient(scales_.position);
    if (with_velocity_) {
      r->segment(m + k * n_, n_) = (out.velocity.col(k) - window.v.col(k)).cwiseQuotient(scales_.velocity);
    }
  }
  // Prescribed joints are given: what is left of their noise is no misfit.
  for (const int j : window.fit->recording->prescribed) {
    for (int row = j; row < r->size(); row += n_) (*r)[row] = 0.0;
  }
}

void RecordingShooting::WriteJacobians(const Window& window, const sim::Trajectory& out, RowMatrix* dr_dtheta,
                                       RowMatrix* dr_dxi) const {
  const int K = static_cast<int>(window.times.size()), m = K * n_;
  const int nx = static_cast<int>(out.dposition.cols()) - P_;
  for (int row = 0; row < m; ++row) {
    const double inverse = 1.0 / scales_.position[row % n_];
    dr_dtheta->row(row) = inverse * out.dposition.row(row).tail(P_);
    dr_dxi->row(row) = inverse * out.dposition.row(row).head(2 * n_ + nz_);
    if (!with_velocity_) continue;
    const double inverse_v = 1.0 / scales_.velocity[row % n_];
    dr_dtheta->row(m + row) = inverse_v * out.dvelocity.row(row).tail(P_);
    dr_dxi->row(m + row) = inverse_v * out.dvelocity.row(row).head(2 * n_ + nz_);
  }
  RG_CHECK(nx >= 2 * n_ + nz_);
  for (int j = 0; j < n_; ++j) {
    dr_dxi->col(j) *= scales_.initial_position[j];
    dr_dxi->col(n_ + j) *= scales_.initial_velocity[j];
  }
  if (nz_ > 0) dr_dxi->rightCols(nz_) *= options_.internal_state_stddev;
}

void RecordingShooting::ResidualSpread(const std::vector<VectorXd>& residuals, VectorXd* position,
                                       VectorXd* velocity) const {
  std::vector<std::vector<double>> q(n_), v(n_);
  for (size_t w = 0; w < windows_.size(); ++w) {
    const int m = static_cast<int>(windows_[w].q.size());
    for (int k = 0; k < residuals[w].size(); ++k) (k < m ? q : v)[k % n_].push_back(residuals[w][k]);
  }
  position->resize(n_);
  velocity->resize(with_velocity_ ? n_ : 0);
  for (int j = 0; j < n_; ++j) {
    (*position)[j] = scales_.position[j] * RobustSpread(q[j]);
    if (with_velocity_) (*velocity)[j] = scales_.velocity[j] * RobustSpread(v[j]);
  }
}

ShootingProblem ShootingProblemFor(ShootingModel* model, const FitSpace& space) {
  ShootingProblem problem;
  problem.model = model;
  problem.theta0 = space.nominal();
  problem.prior_information = space.prior_stddev().cwiseAbs2().cwiseInverse();
  problem.scale = space.prior_stddev();
  problem.lower = space.lower();
  problem.upper = space.upper();
  return problem;
}

}  // namespace rg::sysid
