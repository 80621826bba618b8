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

#include "services/diagnosis/diagnosis.h"
#include "services/diagnosis/search.h"

namespace rg::diagnosis {

// A fitted model that differs from the best one by one kind of effect, exchanged for `effect`.
struct Rival {
  std::string effect;
  const Candidate* candidate = nullptr;
};
// What was tried in the place of effect `id` of the best model, best first; one per kind, the best four.
inline constexpr size_t kMostRivals = 4;
std::vector<Rival> RivalsOf(const SearchResult& search, const std::string& id);

// For the findings whose class holds others: the motion, or none where no motion that was tried is expected
// to bring kSeparable nats. Call where some class does.
std::optional<ProposedMotion> ProposeMotion(const SearchResult& search, const FitData& data,
                                            const sim::Plant& nominal, const MotionScales& scales,
                                            const std::vector<Finding>& findings, double step_s, int threads,
                                            const CancelToken* cancel);

// Nats by which a rival must lie behind to be told apart.
inline constexpr double kSeparable = 3.0;

}  // namespace rg::diagnosis
