// The robot's time on the host's steady clock.
//
//   host = stamp + min over a window of (received - stamp)
//
// A message is never received before it was sent, so the fastest one of the last `window_s` is nearest to
// the difference of the clocks; the window follows drift. A stamp that leaps (the robot's clock was set)
// starts over. No allocation after construction. One thread.
#pragma once

#include <array>
#include <cstdint>

namespace rg::robot_agent::kinova {

class ClockMap {
 public:
  explicit ClockMap(double window_s = 10.0);

  // A message stamped `stamp_ns` by the robot came at `received_ns`: when it was stamped, host's clock.
  // Grows from call to call (strictly, while messages are received in different nanoseconds), is never later
  // than `received_ns`.
  int64_t ToHost(int64_t stamp_ns, int64_t received_ns);

  int64_t offset_ns() const { return offset_ns_; }

 private:
  static constexpr int kParts = 8;  // of the window, each with its least difference
  static constexpr int64_t kLeap = 500'000'000;

  void Note(int64_t difference_ns, int64_t received_ns);

  const int64_t part_ns_;
  std::array<int64_t, kParts> least_;
  int64_t part_ = -1;  // number of the newest part
  int64_t offset_ns_ = 0, last_host_ns_ = 0;
  bool started_ = false;
};

}  // namespace rg::robot_agent::kinova
