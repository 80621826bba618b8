#include "services/diagnosis/nearest_starts.h"

#include <algorithm>
#include <utility>

#include "services/diagnosis/hypotheses.h"

namespace rg::diagnosis {

namespace {

constexpr size_t kWindows = 6;

}  // namespace

std::vector<TrialSpecs> NearestStarts(FitExecutor& fits, const FitSetting& setting, FitRequest look,
                                      const std::vector<double>& window_chi2,
                                      const std::vector<TrialSpecs>& starts, size_t count,
                                      const std::function<bool()>& late, double* work) {
  look.places = SomeWindows(window_chi2, setting.data.windows.size(), kWindows);
  look.options.iterations = look.options.more_iterations = 0;
  std::vector<FitRequest> looks(starts.size(), look);
  for (size_t i = 0; i < looks.size(); ++i) looks[i].specs = Joined(look.specs, starts[i]);
  const auto batch = fits.Start(setting, looks);
  std::vector<std::pair<double, size_t>> seen;
  for (size_t i = 0; i < looks.size() && !late(); ++i) {
    const FitResult fit = batch->Take(i);
    *work += fit.work;
    if (fit.ok) seen.push_back({fit.chi2 / look.options.noise_scale + fit.prior_cost, i});
  }
  std::sort(seen.begin(), seen.end());
  std::vector<TrialSpecs> out;
  for (size_t i = 0; i < std::min(count, seen.size()); ++i) out.push_back(starts[seen[i].second]);
  return out;
}

}  // namespace rg::diagnosis
