#include "services/diagnosis/likelihood/fitted_motion.h"

#include <algorithm>
#include <vector>

#include "services/diagnosis/likelihood/lineariser.h"
#include "services/sysid/parallel.h"

namespace rg::diagnosis {

namespace {

constexpr double kSame = 1e-9;  // s, between times that are the same but for rounding

// Of a stretch of a fine motion, [first, last): begin, middle and end of each of its intervals, in turns.
std::vector<double> TimesOf(const FineMotion& motion, Eigen::Index first, Eigen::Index last) {
  const double half = 0.5 * (motion.t[1] - motion.t[0]);
  std::vector<double> out = {motion.t[first] - half};
  for (Eigen::Index k = first; k < last; ++k) out.insert(out.end(), {motion.t[k], motion.t[k] + half});
  out.front() += kSame, out.back() -= kSame;  // within the window, whatever was rounded
  return out;
}

// Puts what was simulated at these times into the motion, but for prescribed joints.
void Put(const sim::Trajectory& simulated, Eigen::Index first, const FitData& data, FineMotion* motion) {
  const Eigen::Index count = simulated.position.cols() / 2;
  const double dt = motion->t[1] - motion->t[0];
  const auto middle = Eigen::seqN(1, count, 2), begin = Eigen::seqN(0, count, 2),
             end = Eigen::seqN(2, count, 2);
  for (int j = 0; j < data.n; ++j) {
    if (!data.Judged(j)) continue;
    const auto own = Eigen::seqN(first, count);
    motion->q(j, own) = simulated.position(j, middle), motion->v(j, own) = simulated.velocity(j, middle);
    motion->a(j, own) = (simulated.velocity(j, end) - simulated.velocity(j, begin)) / dt;
  }
}

}  // namespace

std::vector<FineMotion> FittedMotions(const FitData& data, const FitModel& model, const NodeStates& states,
                                      const LiftedOptions& options) {
  std::vector<FineMotion> out = data.fine;
  Lineariser lin(data, {model.plant, model.values, {}}, false, options);
  sysid::ParallelFor(options.threads, static_cast<int>(data.windows.size()), [&](int worker, int w) {
    const NodeWindow& window = data.windows[w];
    FineMotion& motion = out[window.recording];
    const double half = 0.5 * (motion.t[1] - motion.t[0]);
    const auto row = [&](double t) { return std::ranges::lower_bound(motion.t, t) - motion.t.begin(); };
    const auto first = row(window.t.front() + half - kSame), last = row(window.t.back() - half + kSame);
    if (first >= last) return;
    const sim::Trajectory& simulated = lin.Outputs(worker, w, states[w].col(0), TimesOf(motion, first, last));
    if (simulated.outcome.ok() && simulated.state.allFinite()) Put(simulated, first, data, &motion);
  });
  return out;
}

}  // namespace rg::diagnosis
