#include "coordinator/core/reactor.h"

#include "coordinator/core/turn.h"

namespace rg::coordinator {

void Absorb(const Event& event, State& state, Now now, Actions& actions) {
  Turn turn(state, now, actions);
  std::visit([&](const auto& e) { turn.Handle(e); }, event);
}

void DispatchIfNeeded(State& state, Now now, Actions& actions) {
  if (!state.dispatch_needed) return;
  state.dispatch_needed = false;
  Turn(state, now, actions).Dispatch();
}

void React(const Event& event, State& state, Now now, Actions& actions) {
  Absorb(event, state, now, actions);
  DispatchIfNeeded(state, now, actions);
}

void Turn::Note(const std::string& kind, JobId job, const std::string& task, const std::string& worker,
                const std::string& detail) {
  const std::string by = by_.empty() ? "" : "by " + by_ + (detail.empty() ? "" : ": ");
  Store(AppendEvent{now_.wall_ns, job, task, worker, kind, by + detail});
}

}  // namespace rg::coordinator
