// The motion that would tell rivals apart which the recordings cannot.
//
// Of each motion of probe_motions.h: a recording of it is simulated under one rival, without noise, and the
// other one is fitted to that from what it is known to be (posterior of its fit as the prior); and the other
// way round. The nats by which the second then lies behind are what the motion is expected to bring,
//
//   min over A, B   ½ min_θ [ χ²(y_A(motion) | B, θ) + Σ ((θ − θ_B)/σ_B)² ],
//
// T-optimality (Atkinson & Fedorov 1975) with the rival refitted. The motion with the most of it, for the
// pair that it separates least, is proposed.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/sim/plant.h"
#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// For the findings whose class holds others: the motion, or none where no motion that was tried is expected
// to bring kSeparable nats (hypotheses/rivals.h). Call where some class does.
std::optional<ProposedMotion> ProposeMotion(const SearchResult& search, const FitData& data,
                                            const sim::Plant& nominal, const MotionScales& scales,
                                            const std::vector<Finding>& findings, double step_s, int threads,
                                            const CancelToken* cancel);

}  // namespace rg::diagnosis
