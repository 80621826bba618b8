#include "coordinator/autoscale/plan.h"

#include <algorithm>

namespace rg::coordinator::autoscale {
namespace {

constexpr int kAbsencesOfTheGone = 2, kAbsencesOfTheUnknown = 3;

double Since(int64_t then_ns, int64_t now_ns) { return 1e-9 * static_cast<double>(now_ns - then_ns); }

Allocation* Find(State& state, const std::string& tag) {
  const auto found = std::find_if(state.allocations.begin(), state.allocations.end(),
                                  [&](const Allocation& a) { return a.tag == tag; });
  return found == state.allocations.end() ? nullptr : &*found;
}

void NoteInVain(const Limits& limits, int64_t now_ns, State& state) {
  ++state.in_vain;
  const size_t step = std::min<size_t>(static_cast<size_t>(state.in_vain), limits.backoff_s.size()) - 1;
  state.not_before_ns = now_ns + static_cast<int64_t>(1e9 * limits.backoff_s[step]);
  state.paused = state.paused || state.in_vain >= limits.pause_after;
}

// The worker's connection is the real signal.
void SeeWorkers(const Seen& seen, State& state) {
  for (Allocation& a : state.allocations) {
    const auto worker = std::find_if(seen.workers.begin(), seen.workers.end(),
                                     [&](const Connected& w) { return w.name == a.tag; });
    if (worker == seen.workers.end()) {
      if (a.phase == Phase::kRunning && a.missed_ns == 0) a.missed_ns = seen.now_ns;
      continue;
    }
    a.phase = Phase::kRunning;
    a.joined = true;
    a.missed_ns = 0;
    a.absences = 0;
    if (a.started_ns == 0) a.started_ns = seen.now_ns;
    if (worker->busy || worker->tasks_done > 0) a.worked = true;
    if (a.worked) state.in_vain = 0, state.not_before_ns = 0;
  }
}

bool IsConnected(const Seen& seen, const Allocation& a) {
  return std::any_of(seen.workers.begin(), seen.workers.end(),
                     [&](const Connected& w) { return w.name == a.tag; });
}

// What the cluster lists is adopted; what bears our prefix and is no longer ours came late, and is given
// back.
void SeeCluster(const std::string& prefix, const Seen& seen, State& state, Actions& actions) {
  if (!seen.cluster) return;
  for (Allocation& a : state.allocations) ++a.absences;
  for (const Listed& listed : *seen.cluster) {
    if (listed.tag.rfind(prefix, 0) != 0) continue;
    Allocation* a = Find(state, listed.tag);
    if (a == nullptr) {
      if (!listed.ended) {
        actions.give_back.push_back(listed.id);
        actions.notes.push_back("allocation " + listed.id + " (" + listed.tag + ") came late: given back");
      }
      continue;
    }
    a->id = listed.id;
    if (listed.ended) {
      a->absences = std::max(a->absences, kAbsencesOfTheGone);  // gone, as soon as its worker is
      if (a->phase == Phase::kAsking) a->phase = Phase::kQueued;
      continue;
    }
    a->absences = 0;
    if (a->phase != Phase::kRunning) a->phase = listed.pending ? Phase::kQueued : Phase::kRunning;
    if (a->phase == Phase::kRunning && a->started_ns == 0) a->started_ns = seen.now_ns;
  }
}

bool IsGone(const Allocation& a, const Limits& limits, const Seen& seen) {
  if (IsConnected(seen, a)) return false;
  if (a.phase == Phase::kAsking)
    return a.absences >= kAbsencesOfTheUnknown && Since(a.asked_ns, seen.now_ns) > limits.unknown_s;
  return a.absences >= kAbsencesOfTheGone;
}

void ForgetTheGone(const Limits& limits, const Seen& seen, State& state, Actions& actions) {
  std::erase_if(state.allocations, [&](const Allocation& a) {
    if (!IsGone(a, limits, seen)) return false;
    const bool in_vain = !a.worked && !a.given_back && seen.slots_wanted > 0;
    actions.notes.push_back("allocation " + (a.id.empty() ? a.tag : a.id) + " is gone" +
                            (!in_vain       ? ""
                             : a.joined     ? ", its worker did nothing"
                             : a.id.empty() ? ", the cluster never knew of it"
                                            : ", its worker never came"));
    if (in_vain) NoteInVain(limits, seen.now_ns, state);
    return true;
  });
}

void GiveBackTheSilent(const Limits& limits, const Seen& seen, State& state, Actions& actions) {
  for (Allocation& a : state.allocations) {
    if (a.phase != Phase::kRunning || a.given_back || a.missed_ns == 0) continue;
    if (Since(a.missed_ns, seen.now_ns) < limits.join_s || a.id.empty()) continue;
    a.given_back = true;
    a.worked = false;
    actions.give_back.push_back(a.id);
    actions.notes.push_back("allocation " + a.id + " runs without its worker: given back");
    if (!a.joined && seen.slots_wanted > 0) NoteInVain(limits, seen.now_ns, state);
  }
}

int Needed(const Limits& limits, const Seen& seen, const State& state) {
  uint64_t others = 0;  // slots of workers that somebody else started
  for (const Connected& w : seen.workers) {
    const bool ours = std::any_of(state.allocations.begin(), state.allocations.end(),
                                  [&](const Allocation& a) { return a.tag == w.name; });
    if (!ours && !w.draining) others += w.slots;
  }
  const uint64_t open = seen.slots_wanted > others ? seen.slots_wanted - others : 0;
  const uint64_t workers = (open + limits.slots - 1) / limits.slots;
  return static_cast<int>(std::min<uint64_t>(workers, static_cast<uint64_t>(limits.max_allocations)));
}

int CountActive(const State& state) {
  return static_cast<int>(std::count_if(state.allocations.begin(), state.allocations.end(),
                                        [](const Allocation& a) { return !a.given_back; }));
}

// Running ones leave by themselves when they are idle.
void GiveBackSurplus(const Limits& limits, const Seen& seen, int surplus, State& state, Actions& actions) {
  if (surplus <= 0) return state.surplus_since_ns = 0, void();
  if (state.surplus_since_ns == 0) state.surplus_since_ns = seen.now_ns;
  if (Since(state.surplus_since_ns, seen.now_ns) < limits.surplus_grace_s) return;
  for (auto a = state.allocations.rbegin(); a != state.allocations.rend() && surplus > 0; ++a) {
    if (a->phase != Phase::kQueued || a->given_back) continue;
    a->given_back = true;
    actions.give_back.push_back(a->id);
    actions.notes.push_back("allocation " + a->id + " is no longer wanted: given back");
    --surplus;
  }
}

bool MayAsk(const Seen& seen, const State& state) {
  const bool is_asking = std::any_of(state.allocations.begin(), state.allocations.end(),
                                     [](const Allocation& a) { return a.phase == Phase::kAsking; });
  // A cluster that does not answer is not asked for more.
  return seen.cluster && !is_asking && CountPending(state) < 1 && !state.paused &&
         seen.now_ns >= state.not_before_ns;
}

}  // namespace

int CountPending(const State& state) {
  return static_cast<int>(
      std::count_if(state.allocations.begin(), state.allocations.end(),
                    [](const Allocation& a) { return a.phase != Phase::kRunning && !a.given_back; }));
}

int CountRunning(const State& state) {
  return static_cast<int>(std::count_if(state.allocations.begin(), state.allocations.end(),
                                        [](const Allocation& a) { return a.phase == Phase::kRunning; }));
}

void NoteAsked(const std::string& tag, const std::string& id, State& state) {
  Allocation* a = Find(state, tag);
  if (a == nullptr) return;
  a->id = id;
  if (a->phase == Phase::kAsking) a->phase = Phase::kQueued;
}

void NoteRefused(const std::string& tag, const Limits& limits, int64_t now_ns, State& state) {
  std::erase_if(state.allocations, [&](const Allocation& a) { return a.tag == tag; });
  NoteInVain(limits, now_ns, state);
}

Actions Plan(const std::string& prefix, const Limits& limits, const Seen& seen, State& state) {
  Actions actions;
  SeeCluster(prefix, seen, state, actions);
  SeeWorkers(seen, state);
  ForgetTheGone(limits, seen, state, actions);
  GiveBackTheSilent(limits, seen, state, actions);
  const int needed = Needed(limits, seen, state), active = CountActive(state);
  GiveBackSurplus(limits, seen, active - needed, state, actions);
  if (active < needed && MayAsk(seen, state)) {
    Allocation a;
    a.tag = prefix + std::to_string(state.next++);
    a.asked_ns = seen.now_ns;
    actions.ask = a.tag;
    state.allocations.push_back(a);
  }
  return actions;
}

}  // namespace rg::coordinator::autoscale
