// A structure found in the balance of torques, fitted in the simulator by multiple shooting.
#pragma once

#include <map>
#include <string>

#include "common/base/progress.h"
#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

struct RefitOptions {
  int threads = 1;
  double window_s = 1.0;
  // By parameter: how well an effect's start value is known. Its prior is then the start, tighter.
  std::map<std::string, double> spread;
  const CancelToken* cancel = nullptr;
};

// `specs` hold start values of every effect parameter; base parameters start from a regression with the
// effort shifted by the specs' delays. Of the regression and the rounds of shooting the one is taken whose
// restarted windows of the *fitted* recordings err least. fit.stddev from the shooting (where there is any).
Candidate RefitByShooting(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                          const std::vector<effects::EffectSpec>& specs, bool base,
                          const RefitOptions& options);

}  // namespace rg::diagnosis
