#include "services/diagnosis/likelihood/own_chi2.h"

#include <cmath>

#include "common/base/parallel.h"
#include "services/diagnosis/likelihood/jumps.h"
#include "services/diagnosis/likelihood/lineariser.h"
#include "services/diagnosis/likelihood/screen.h"

namespace rg::diagnosis {

namespace {

constexpr int kStartIterations = 2;  // of the refit of the windows' starts

}  // namespace

double OwnChi2(const FitData& data, const FitModel& model, const NodeStates& states,
               const LiftedOptions& options, Rng rng) {
  FitData own = data;
  const FitModel fixed{model.plant, model.values, {}};
  Lineariser other(data, fixed, false, OtherStepRule(options));
  const double noise = std::sqrt(options.noise_scale);
  const int n = data.n;
  ParallelFor(options.threads, static_cast<int>(own.windows.size()), [&](int worker, int w) {
    NodeWindow& window = own.windows[w];
    VectorXd by = other.Residuals(worker, w, states[w].col(0));
    if (!by.allFinite()) return;
    Rng stream = rng.Split(static_cast<uint64_t>(w));
    for (double& row : by) row -= noise * stream.Normal();
    if (window.factor.size() > 0) by = (window.factor.triangularView<Eigen::Lower>() * by).eval();
    long row = 0;
    for (size_t node = 0; node < window.t.size(); ++node) {
      if (!window.measured[node]) continue;
      const auto k = static_cast<long>(node);
      const auto move = [&](const MatrixXd& stddev, MatrixXd* rows) {
        for (int j = 0; j < n; ++j, ++row) {
          if (std::isfinite(stddev(j, k))) (*rows)(j, k) -= by[row] * stddev(j, k);
        }
      };
      move(window.q_stddev, &window.q);
      if (data.use_velocity) move(window.v_stddev, &window.v);
    }
  });
  LiftedOptions starts = KeepingStep(options);
  starts.iterations = kStartIterations, starts.more_iterations = 0;
  return Fit(own, fixed, starts, &states).chi2 + TrueJumps(data, model.plant, options.noise_scale);
}

}  // namespace rg::diagnosis
