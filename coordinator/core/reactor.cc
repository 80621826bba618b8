#include "coordinator/core/reactor.h"

#include "coordinator/core/turn.h"

namespace rg::coordinator {

void React(const Event& event, State& state, Now now, Actions& actions) {
  Turn turn(state, now, actions);
  std::visit([&](const auto& e) { turn.Handle(e); }, event);
  if (state.dispatch_needed) {
    state.dispatch_needed = false;
    turn.Dispatch();
  }
}

void Turn::Note(const std::string& kind, JobId job, const std::string& task, const std::string& worker,
                const std::string& detail) {
  Store(AppendEvent{now_.wall_ns, job, task, worker, kind, detail});
}

}  // namespace rg::coordinator
