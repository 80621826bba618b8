// The coordinator's brain: a pure function of an event, the state and the time. No I/O, no clock, no
// randomness; the same history gives the same state. Any event may come at any time, repeated, late
// or from a process nobody knows: that is answered or ignored, never a failure.
//
// The caller must make `actions.rows` durable before any of `actions.messages` leaves.
#pragma once

#include "coordinator/core/events.h"
#include "coordinator/core/state.h"

namespace rg::coordinator {

// Appends what follows from the event; free slots are filled before it returns.
void React(const Event& event, State& state, Now now, Actions& actions);
// The two halves of it, for a batch of events that fills free slots once, at its end.
void Absorb(const Event& event, State& state, Now now, Actions& actions);
void DispatchIfNeeded(State& state, Now now, Actions& actions);
inline Actions On(const Event& event, State& state, Now now) {
  Actions actions;
  React(event, state, now, actions);
  return actions;
}

}  // namespace rg::coordinator
