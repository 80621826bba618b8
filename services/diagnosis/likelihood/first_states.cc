// Where fits start (lifted_fit.h).
#include <algorithm>
#include <cmath>

#include "common/base/parallel.h"
#include "services/diagnosis/likelihood/lineariser.h"

namespace rg::diagnosis {

NodeStates InitialStates(const FitData& data, const FitModel& model, const LiftedOptions& options) {
  Lineariser lin(data, model, false, options);
  const std::vector<int>& motor = lin.sensed_motors();
  const int nx = lin.nx(), n = data.n;
  NodeStates states(data.windows.size());
  const VectorXd& offsets = lin.sensor_offsets();
  ParallelFor(options.threads, static_cast<int>(data.windows.size()), [&](int worker, int w) {
    const NodeWindow& window = data.windows[w];
    const int N = static_cast<int>(window.t.size());
    states[w].setZero(nx, N);
    states[w].topRows(n) = window.q0.colwise() - offsets;
    states[w].middleRows(n, n) = window.v0;
    if (nx == 2 * n) return;
    // Hidden states: settled some time before, then carried along the recorded motion.
    const double t0 = window.t[0] - kSettleTime;
    const FineMotion& fine = data.fine[window.recording];
    const double dt = fine.t[1] - fine.t[0];
    const int first = std::max(0, static_cast<int>(std::ceil((t0 - fine.t[0]) / dt)));
    const int stride = std::max(1, data.nodes.fine_per_interval);
    NodeWindow before;
    before.recording = window.recording;
    for (int k = first; fine.t[k] < window.t[0] - 1e-9; k += stride) before.t.push_back(fine.t[k]);
    const int B = static_cast<int>(before.t.size());
    before.t.push_back(window.t[0]);
    before.q0.resize(n, B + 1), before.v0.resize(n, B + 1);
    for (int k = 0; k < B; ++k) {
      before.q0.col(k) = fine.q.col(first + k * stride);
      before.v0.col(k) = fine.v.col(first + k * stride);
    }
    before.q0.col(B) = window.q0.col(0), before.v0.col(B) = window.v0.col(0);
    MatrixXd earlier = MatrixXd::Zero(nx, B + 1);
    earlier.topRows(n) = before.q0.colwise() - offsets, earlier.middleRows(n, n) = before.v0;
    const sim::State x =
        lin.MakeState(worker, earlier.col(0).head(n), before.v0.col(0), before.t[0], window.recording);
    earlier.col(0).tail(nx - 2 * n) = x.z;
    for (int j = 0; j < n; ++j) {
      if (motor[j] < 0) continue;
      const double sensed = before.q0(j, 0) - offsets[j];
      earlier(j, 0) -= x.z[motor[j]] - sensed;
      earlier(2 * n + motor[j], 0) = sensed;
    }
    lin.CarryHidden(worker, before, motor, &earlier);
    states[w].col(0) = earlier.col(B);
    if (lin.has_gaps()) {
      const double carried = lin.Simulated(worker, {w}, {states[w].col(0)})[0];
      lin.ChooseFace(worker, w, nullptr, false, carried, &states[w]);
    }
    lin.CarryHidden(worker, window, motor, &states[w]);
  });
  return states;
}

NodeStates CarriedStates(const FitData& data, const FitModel& to, const sim::Plant& from,
                         const NodeStates& states, const LiftedOptions& options) {
  const int n = data.n;
  const auto& theirs = from.internal_state_names();
  const auto& own = to.plant.internal_state_names();
  if (own == theirs) return states;
  NodeStates out = InitialStates(data, to, options);
  for (size_t w = 0; w < out.size(); ++w) {
    out[w].topRows(2 * n) = states[w].topRows(2 * n);
    for (size_t i = 0; i < own.size(); ++i) {
      const auto at = std::ranges::find(theirs, own[i]);
      if (at != theirs.end())
        out[w].row(2 * n + static_cast<long>(i)) = states[w].row(2 * n + (at - theirs.begin()));
    }
  }
  return out;
}

}  // namespace rg::diagnosis
