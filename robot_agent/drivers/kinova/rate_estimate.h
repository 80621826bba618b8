// How often states arrive: from the times of the last messages. No allocation. One thread.
#pragma once

#include <array>
#include <cstdint>

namespace rg::robot_agent::kinova {

class RateEstimate {
 public:
  void Note(int64_t received_ns);
  void Restart() { count_ = 0; }
  // Intervals noted so far, at most kMost.
  int intervals() const;
  // Mean over those intervals, Hz; 0: fewer than two messages.
  double hz() const;
  // The same without the longest of them: what the rate is beside one silence.
  double hz_without_longest() const;

  static constexpr int kMost = 63;

 private:
  std::array<int64_t, kMost + 1> times_{};
  uint64_t count_ = 0;
};

}  // namespace rg::robot_agent::kinova
