// What a command and its answer take from the agent to the guard and back: through the packet socket that they use,
// and through shared memory with a futex on each side, with which it was to be compared. Two processes, a command
// every 4 ms, as in a control cycle that sleeps in between; once as ordinary processes, once with FIFO priority and
// locked memory (where granted), each with the cores idle and with one busy process per core. Figures as JSON.
#include <linux/futex.h>
#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <functional>
#include <new>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>
#include <vector>

#include "common/base/clock.h"
#include "robot_agent/drivers/packet_socket.h"
#include "robot_agent/guard/guard_protocol.h"
#include "robot_agent/jitter.h"
#include "robot_agent/realtime.h"

namespace rg::robot_agent {
namespace {

constexpr int kRoundTrips = 2500;
constexpr int64_t kEvery = 4'000'000;  // ns

pid_t Child(const std::function<void()>& work) {
  const pid_t child = fork();
  if (child != 0) return child;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  work();
  _exit(0);
}

void End(pid_t child) {
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
}

// One message each way, its number is its signal.
struct Box {
  std::atomic<uint32_t> asked, answered;
  GuardMessage request, reply;
};

void AwaitChange(std::atomic<uint32_t>& word, uint32_t old) {
  while (word.load(std::memory_order_acquire) == old)
    syscall(SYS_futex, reinterpret_cast<uint32_t*>(&word), FUTEX_WAIT, old, nullptr, nullptr, 0);
}
void Signal(std::atomic<uint32_t>& word) {
  word.fetch_add(1, std::memory_order_release);
  syscall(SYS_futex, reinterpret_cast<uint32_t*>(&word), FUTEX_WAKE, 1, nullptr, nullptr, 0);
}

DurationHistogram Measure(bool fifo, const std::function<void()>& round_trip) {
  std::optional<RealtimeScope> on_time;
  if (fifo) on_time.emplace(kLoopPriority);
  DurationHistogram took;
  int64_t next = RealClock().SteadyNanos();
  for (int k = 0; k < kRoundTrips; ++k) {
    next += kEvery;
    const timespec until{next / 1'000'000'000, next % 1'000'000'000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr);
    const int64_t begin = RealClock().SteadyNanos();
    round_trip();
    took.Add(RealClock().SteadyNanos() - begin);
  }
  return took;
}

DurationHistogram ThroughSocket(bool fifo) {
  auto pair = PacketSocket::Pair().value();
  const pid_t guard = Child([&] {
    if (fifo) (void)AskForRealtime(kGuardPriority, false);
    GuardMessage message;
    while (pair.second.Receive(&message, sizeof message, 10.0).code == StatusCode::kOk)
      (void)pair.second.Send(&message, sizeof message).ok();
  });
  GuardMessage request, reply;
  const DurationHistogram took = Measure(fifo, [&] {
    ++request.sequence;
    (void)pair.first.Send(&request, sizeof request).ok();
    (void)pair.first.Receive(&reply, sizeof reply, 10.0);
  });
  End(guard);
  return took;
}

DurationHistogram ThroughMemory(bool fifo) {
  auto* const box = new (mmap(nullptr, sizeof(Box), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0)) Box{};
  const pid_t guard = Child([&] {
    if (fifo) (void)AskForRealtime(kGuardPriority, false);
    for (uint32_t seen = 0;; ++seen) {
      AwaitChange(box->asked, seen);
      box->reply = box->request;
      Signal(box->answered);
    }
  });
  GuardMessage request, reply;
  const DurationHistogram took = Measure(fifo, [&] {
    const uint32_t before = box->answered.load();
    ++request.sequence;
    box->request = request;
    Signal(box->asked);
    AwaitChange(box->answered, before);
    reply = box->reply;
  });
  End(guard);
  munmap(box, sizeof(Box));
  return took;
}

nlohmann::json Row(const char* channel, bool fifo, bool busy, const DurationHistogram& took) {
  return {{"channel", channel}, {"fifo", fifo}, {"busy", busy}, {"p50_us", took.PercentileUs(50)},
          {"p99_us", took.PercentileUs(99)}, {"p999_us", took.PercentileUs(99.9)}, {"max_us", took.max_us()}};
}

}  // namespace
}  // namespace rg::robot_agent

int main() {
  using namespace rg::robot_agent;
  nlohmann::json rows = nlohmann::json::array();
  for (const bool busy : {false, true}) {
    std::vector<pid_t> load;
    for (unsigned i = 0; busy && i < std::thread::hardware_concurrency(); ++i)
      load.push_back(Child([] {
        while (true) asm volatile("");
      }));
    for (const bool fifo : {false, true}) {
      rows.push_back(Row("packet socket", fifo, busy, ThroughSocket(fifo)));
      rows.push_back(Row("shared memory", fifo, busy, ThroughMemory(fifo)));
    }
    for (const pid_t child : load) End(child);
  }
  std::printf("%s\n", rows.dump(1).c_str());
  return 0;
}
