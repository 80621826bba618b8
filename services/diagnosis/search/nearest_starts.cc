#include "services/diagnosis/search/nearest_starts.h"

#include <algorithm>
#include <utility>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/jumps.h"
#include "services/diagnosis/likelihood/some_windows.h"

namespace rg::diagnosis {

namespace {

constexpr size_t kWindows = 6;     // on which starts are compared
constexpr size_t kSecondPass = 3;  // times `count`: starts of play compared again after more iterations
constexpr int kSecondPassIterations = 4;  // of that second pass

}  // namespace

std::vector<TrialSpecs> NearestStarts(FitExecutor& fits, const FitSetting& setting, FitRequest look,
                                      const std::vector<double>& window_chi2,
                                      const std::vector<TrialSpecs>& starts, size_t count,
                                      const std::function<bool()>& late, double* work) {
  const std::vector<effects::EffectSpec> held = look.specs;
  look.places = SomeWindows(window_chi2, setting.data.windows.size(), setting.data.WindowsFor(kWindows));
  // The best of `of` after one step and so many more.
  const auto nearest = [&](const std::vector<TrialSpecs>& of, int iterations, size_t most) {
    look.options.iterations = iterations, look.options.more_iterations = 0;
    std::vector<FitRequest> looks(of.size(), look);
    for (size_t i = 0; i < looks.size(); ++i) looks[i].specs = Joined(held, of[i]);
    const auto batch = fits.Start(setting, looks);
    std::vector<std::pair<double, size_t>> seen;
    for (size_t i = 0; i < looks.size() && !late(); ++i) {
      const FitResult fit = batch->Take(i);
      *work += fit.work;
      if (fit.ok) seen.push_back({fit.chi2 / look.options.noise_scale + fit.prior_cost, i});
    }
    std::ranges::sort(seen);
    std::vector<TrialSpecs> out;
    for (size_t i = 0; i < std::min(most, seen.size()); ++i) out.push_back(of[seen[i].second]);
    return out;
  };
  if (starts.empty() || !HasPlay(starts.front()) || setting.data.n > kLightRobot)
    return nearest(starts, 0, count);
  std::vector<TrialSpecs> near = nearest(starts, 0, kSecondPass * count);
  std::vector<TrialSpecs> again = nearest(near, kSecondPassIterations, count);
  if (again.size() == std::min(count, near.size())) return again;
  near.resize(std::min(count, near.size()));
  return near;
}

}  // namespace rg::diagnosis
