// Which of many starts are worth a trial, where fits end near where they start: one step from each, on a few
// windows, tells.
#pragma once

#include <functional>
#include <vector>

#include "services/diagnosis/search/fit_requests.h"
#include "services/diagnosis/search/trials.h"

namespace rg::diagnosis {

// The `count` of `starts` that are nearest to the record when they are added to `look`'s effects.
// `window_chi2`: of the model that they are added to. No more are looked at once `late` says so. `work`: what
// it costs is added.
std::vector<TrialSpecs> NearestStarts(FitExecutor& fits, const FitSetting& setting, FitRequest look,
                                      const std::vector<double>& window_chi2,
                                      const std::vector<TrialSpecs>& starts, size_t count,
                                      const std::function<bool()>& late, double* work);

}  // namespace rg::diagnosis
