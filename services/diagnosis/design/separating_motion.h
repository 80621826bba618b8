// Optimal experiment design: the motion that is expected to separate rivals which the recordings cannot.
//
// For each motion of probe_motions.h a recording is simulated under one rival, without noise, and the other
// one is fitted to it with its posterior as prior; and the reverse. The expected log evidence of the motion
// is
//
//   min over A, B   ½ min_θ [ χ²(y_A(motion) | B, θ) + Σ ((θ − θ_B)/σ_B)² ],
//
// T-optimality (Atkinson & Fedorov 1975) with the rival refitted. The motion with the largest minimum over
// the pairs of rivals is proposed.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/sim/plant.h"
#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"
#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

// The motion for the findings whose class has more than one effect; none where no motion is expected to bring
// kSeparable nats (hypotheses/rivals.h).
std::optional<ProposedMotion> ProposeMotion(const SearchResult& search, const FitSetting& setting,
                                            const std::vector<Finding>& findings, double step_s, int threads,
                                            const CancelToken* cancel);

}  // namespace rg::diagnosis
