#include "services/diagnosis/likelihood/fitted_motion.h"

#include <algorithm>
#include <vector>

#include "common/base/check.h"
#include "common/base/parallel.h"
#include "services/diagnosis/likelihood/lineariser.h"

namespace rg::diagnosis {

namespace {

// Rows of a fine motion that belong to a window: of those at t, [first, last).
struct RowRange {
  Eigen::Index first = 0, last = 0;
};

RowRange RowsIn(const NodeWindow& window, const FineMotion& motion) {
  const auto row = [&](double t) { return std::ranges::lower_bound(motion.t, t) - motion.t.begin(); };
  return {row(window.t.front()), row(window.t.back())};
}

// The first row's begin, then each row's time and its end, as far as they are in the window.
std::vector<double> TimesOf(const RowRange& rows, const NodeWindow& window, const FineMotion& motion) {
  const double half = 0.5 * (motion.t[1] - motion.t[0]);
  std::vector<double> out = {std::max(window.t.front(), motion.t[rows.first] - half)};
  for (Eigen::Index k = rows.first; k < rows.last; ++k)
    out.insert(out.end(), {motion.t[k], std::min(window.t.back(), motion.t[k] + half)});
  return out;
}

// Puts the states simulated at these times into the motion, but for prescribed joints.
void Put(const MatrixXd& states, const std::vector<double>& times, const RowRange& rows, const FitData& data,
         FineMotion* motion) {
  for (Eigen::Index k = rows.first, at = 1; k < rows.last; ++k, at += 2) {
    for (int j = 0; j < data.n; ++j) {
      if (!data.Judged(j)) continue;
      motion->q(j, k) = states(j, at), motion->v(j, k) = states(data.n + j, at);
      motion->a(j, k) = (states(data.n + j, at + 1) - states(data.n + j, at - 1)) /
                        (times[static_cast<size_t>(at) + 1] - times[static_cast<size_t>(at) - 1]);
    }
  }
}

}  // namespace

std::vector<FineMotion> FittedMotions(const FitData& data, const FitModel& model, const NodeStates& states,
                                      const LiftedOptions& options) {
  RG_CHECK(states.size() == data.windows.size());
  std::vector<FineMotion> out = data.fine;
  Lineariser lin(data, {model.plant, model.values, {}}, false, options);
  ParallelFor(options.threads, static_cast<int>(data.windows.size()), [&](int worker, int w) {
    const NodeWindow& window = data.windows[w];
    FineMotion& motion = out[window.recording];
    const RowRange rows = RowsIn(window, motion);
    if (rows.first >= rows.last) return;
    const std::vector<double> times = TimesOf(rows, window, motion);
    const sim::Trajectory& simulated = lin.SimulatedAt(worker, w, states[w].col(0), times);
    if (simulated.outcome.ok() && simulated.state.allFinite())
      Put(simulated.state, times, rows, data, &motion);
  });
  return out;
}

}  // namespace rg::diagnosis
