// Refit of a hypothesis from the balance of torques in the simulator, by multiple shooting.
#pragma once

#include <map>
#include <string>

#include "common/base/progress.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

struct RefitOptions {
  int threads = 1;
  double window_s = 1.0;
  // Stddev of an effect's start value, by parameter. It becomes the prior, tightened.
  std::map<std::string, double> spread;
  const CancelToken* cancel = nullptr;
};

// `specs`: with start values of all their parameters. Base parameters start from a regression of the inverse
// dynamics with the effort shifted by the specs' delays. Of start, regression and shooting the result with
// the least error in restarted windows of the *fitted* recordings is returned, with fit.stddev of the
// shooting.
Candidate RefitByShooting(const FitSetting& setting, const std::vector<EffectSpec>& specs, bool base,
                          const RefitOptions& options);

}  // namespace rg::diagnosis
