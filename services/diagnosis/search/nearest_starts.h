// Selects among many start values, for fits that converge to the nearest of many local minima: one
// Gauss-Newton step from each on a few windows.
#pragma once

#include <functional>
#include <vector>

#include "services/diagnosis/search/fit_requests.h"
#include "services/diagnosis/search/trials.h"

namespace rg::diagnosis {

// The `count` of `starts` with the least cost when added to the effects of `look`. `window_chi2`: of the
// model that they are added to. Stops when late() is true. Adds its cost to `work`.
std::vector<TrialSpecs> NearestStarts(FitExecutor& fits, const FitSetting& setting, FitRequest look,
                                      const std::vector<double>& window_chi2,
                                      const std::vector<TrialSpecs>& starts, size_t count,
                                      const std::function<bool()>& late, double* work);

}  // namespace rg::diagnosis
