// How punctual a control loop was. Fixed memory, no allocation while counting.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "robot_agent/realtime.h"

namespace rg::robot_agent {

// Histogram over [0, 2^26) µs, eight buckets per power of two: percentiles are upper bounds, at most
// 12.5 % (or 1 µs) too high; the largest value is exact.
class DurationHistogram {
 public:
  void Add(int64_t nanos);
  uint64_t count() const { return count_; }
  double max_us() const { return max_us_; }
  double mean_us() const { return count_ ? sum_us_ / static_cast<double>(count_) : 0.0; }
  // p in [0, 100]; 0 if nothing was counted.
  double PercentileUs(double p) const;

 private:
  static constexpr int kBuckets = 208;
  static int Bucket(double us);
  static double UpperEdge(int bucket);

  std::array<uint64_t, kBuckets> buckets_{};
  uint64_t count_ = 0;
  double max_us_ = 0.0, sum_us_ = 0.0;
};

struct JitterReport {
  double period_s = 0.0;
  bool lock_step = false;         // the robot's time waited for the loop: lateness is zero by construction
  uint64_t ticks = 0;             // control cycles run
  uint64_t missed_deadlines = 0;  // commands later than half a period, and ticks left out
  uint64_t late_2ms = 0;          // ticks that began more than 2 ms late
  DurationHistogram lateness;     // wake-up after its tick
  DurationHistogram cycle;        // from wake-up to the command being sent, machine time
  DurationHistogram state_age;    // age of the state used, driver's time
  RealtimeGrant realtime;         // of the thread that ran the cycles

  // {"period_s", "ticks", "missed_deadlines", "late_2ms", "lateness_us": {"p50", "p99", "p999", "max"},
  // "cycle_us": …, "realtime": {"memory_locked", "fifo_priority", "why"}}
  std::string ToJson() const;
};

}  // namespace rg::robot_agent
