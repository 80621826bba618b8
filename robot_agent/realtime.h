// What the kernel grants a process or thread that has to be on time: its memory stays in RAM, and it runs before
// everything ordinary (SCHED_FIFO). Without the right to it (root, CAP_SYS_NICE and CAP_IPC_LOCK, or limits.conf's
// rtprio and memlock) everything works as before; recordings say which it was.
#pragma once

#include <string>

namespace rg::robot_agent {

inline constexpr int kGuardPriority = 30;  // above the control loop: it has to see the loop hang
inline constexpr int kLoopPriority = 20;

struct RealtimeGrant {
  bool memory_locked = false;
  int fifo_priority = 0;  // 0: not granted
  std::string why;        // what was not granted, in words; empty: all of it
  std::string ToJson() const;
};

// The calling thread for good; with `heirs` the threads (and processes) that it starts from now on too.
// RG_REALTIME=off in the environment: nothing.
RealtimeGrant AskForRealtime(int fifo_priority, bool heirs);

// The calling thread alone, while it lives. Memory as above.
class RealtimeScope {
 public:
  explicit RealtimeScope(int fifo_priority);
  ~RealtimeScope();
  RealtimeScope(const RealtimeScope&) = delete;
  const RealtimeGrant& grant() const { return grant_; }

 private:
  RealtimeGrant grant_;
};

}  // namespace rg::robot_agent
