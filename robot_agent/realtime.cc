#include "robot_agent/realtime.h"

#include <sched.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <nlohmann/json.hpp>

namespace rg::robot_agent {
namespace {

bool Off() {
  const char* wish = std::getenv("RG_REALTIME");
  return wish != nullptr && std::strcmp(wish, "off") == 0;
}

void Add(const std::string& words, std::string* why) { *why += (why->empty() ? "" : "; ") + words; }

// Under a limit of locked memory every later allocation could fail: then nothing is locked.
void LockMemory(RealtimeGrant* grant) {
  rlimit limit{};
  const bool unlimited =
      geteuid() == 0 || (getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY);
  if (!unlimited) return Add("memory is not locked: RLIMIT_MEMLOCK", &grant->why);
  grant->memory_locked = mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0;
  if (!grant->memory_locked) Add(std::string("memory is not locked: ") + std::strerror(errno), &grant->why);
}

// The calling thread, and with `heirs` those that it starts.
void RunFirst(int priority, bool heirs, RealtimeGrant* grant) {
  const sched_param parameters{.sched_priority = priority};
  if (sched_setscheduler(0, SCHED_FIFO | (heirs ? 0 : SCHED_RESET_ON_FORK), &parameters) == 0) {
    grant->fifo_priority = priority;
  } else {
    Add(std::string("no FIFO priority: ") + std::strerror(errno), &grant->why);
  }
}

}  // namespace

std::string RealtimeGrant::ToJson() const {
  return nlohmann::json{{"memory_locked", memory_locked}, {"fifo_priority", fifo_priority}, {"why", why}}.dump();
}

RealtimeGrant AskForRealtime(int fifo_priority, bool heirs) {
  RealtimeGrant grant;
  if (Off()) {
    grant.why = "RG_REALTIME=off";
    return grant;
  }
  LockMemory(&grant);
  RunFirst(fifo_priority, heirs, &grant);
  return grant;
}

RealtimeScope::RealtimeScope(int fifo_priority) : grant_(AskForRealtime(fifo_priority, false)) {}

RealtimeScope::~RealtimeScope() {
  const sched_param ordinary{};
  if (grant_.fifo_priority > 0) (void)sched_setscheduler(0, SCHED_OTHER, &ordinary);
  if (grant_.memory_locked) (void)munlockall();
}

}  // namespace rg::robot_agent
