// First rollouts are short and slow, and grow with trust: how far an arm has been seen to do what it was asked for.
//
//   trust 0   nobody has seen it move: FirstRollouts' duration and share of the speed
//   trust 1   as long and as fast as the agent's configuration and the job allow
//
// Trust is not stored but follows from the parameter history: each version names the recording it was identified
// from, and that says how its rollout ended. A rollout that ran to its end adds a quarter; one that the fence ended
// halves it; a stop that was not confirmed takes all of it; others (a stop by a person, a lost driver) say nothing.
#pragma once

#include <string_view>

namespace rg::rollouts {

inline constexpr double kTrustStep = 0.25;

// Whether a rollout that ended so may be made again, slower: the fence ended what a controller asked for, or this machine
// was late; not where the arm, its sensors or a person ended it.
bool MayBeMadeAgain(std::string_view end_reason);

double TrustAfter(double trust, std::string_view end_reason, bool stop_confirmed);

struct FirstRollouts {
  double duration_s = 0.0;  // of a rollout with trust 0; 0: full trust from the first
  double speed = 1.0;       // its share of the velocity limits, > 0
  bool on() const { return duration_s > 0.0; }
  // What a rollout of `asked_s` may take, and its share of the velocity limits.
  double DurationOf(double asked_s, double trust) const;
  double SpeedOf(double trust) const;
};

}  // namespace rg::rollouts
