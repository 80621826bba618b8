// How many allocations of a cluster to have, and which to ask for or give back: a pure function of what is
// known and what was seen, to a new state and actions. An allocation runs one worker, which has the
// allocation's tag as its name. What is written down before it is done is the caller's part (autoscaler.h).
//
// An allocation is asked for once: until it is known what became of the asking, it counts as pending, and
// there is never more than one pending. It is alive while its worker is connected or the cluster lists it; it
// is gone when the cluster has answered without it several times. One that goes without its worker having
// done anything, though there was work, was in vain; the next waits 0, 1, 15, 30, 60 minutes, and after
// several in a row nothing more is asked for until the coordinator starts again.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rg::coordinator::autoscale {

enum class Phase { kAsking, kQueued, kRunning };  // kAsking: nobody knows yet whether it exists

struct Allocation {
  std::string tag;
  std::string id;  // the cluster's; empty while asking
  Phase phase = Phase::kAsking;
  int64_t asked_ns = 0;    // wall time, as all here: kept over restarts
  int64_t started_ns = 0;  // first seen running; 0: not yet
  int64_t missed_ns = 0;   // its worker was away, or had not come, since; 0: it is there
  bool joined = false;     // its worker was seen
  bool worked = false;     // … and had done a task, or was busy
  bool given_back = false;
  int absences = 0;  // answers of the cluster in a row that did not list it
};

struct Limits {
  int max_allocations = 8;
  uint32_t slots = 1;             // of one worker
  double surplus_grace_s = 15.0;  // demand must be lower for so long before a pending one is given back
  double unknown_s = 30.0;        // an asking that the cluster does not know of is given up after this
  double join_s = 300.0;          // a running one whose worker does not come, or stays away, is given back
  std::vector<double> backoff_s = {0, 60, 15 * 60, 30 * 60, 60 * 60};
  int pause_after = 6;
};

struct State {
  std::vector<Allocation> allocations;
  int64_t next = 1;  // number of the next tag
  int in_vain = 0;   // in a row
  int64_t not_before_ns = 0;
  int64_t surplus_since_ns = 0;
  bool paused = false;
};

struct Listed {  // by the cluster
  std::string tag, id;
  bool pending = false;
  bool ended = false;
};
struct Connected {  // worker
  std::string name;
  uint32_t slots = 0;
  bool busy = false, draining = false;
  uint64_t tasks_done = 0;
};
struct Seen {
  int64_t now_ns = 0;
  uint64_t slots_wanted = 0;
  std::vector<Connected> workers;
  std::optional<std::vector<Listed>>
      cluster;  // nothing: it did not answer; else all whose tag begins with `prefix`
};

struct Actions {
  std::optional<std::string> ask;      // a new tag, in the state already
  std::vector<std::string> give_back;  // ids
  std::vector<std::string> notes;      // what happened, for the log
};

Actions Plan(const std::string& prefix, const Limits& limits, const Seen& seen, State& state);

// What came of asking: an id; a refusal, which is final; or nothing that is known (a time-out).
void NoteAsked(const std::string& tag, const std::string& id, State& state);
void NoteRefused(const std::string& tag, const Limits& limits, int64_t now_ns, State& state);

int CountPending(const State& state);
int CountRunning(const State& state);

}  // namespace rg::coordinator::autoscale
