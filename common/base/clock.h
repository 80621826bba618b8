// Time as an argument. Leases, budgets and deadlines use the steady time; only what a person reads
// uses the wall time. FakeClock lets a test move both by hand.
#pragma once

#include <cstdint>
#include <string>

namespace rg {

class Clock {
 public:
  virtual ~Clock() = default;
  virtual int64_t SteadyNanos() const = 0;  // monotonic, arbitrary origin
  virtual int64_t WallNanos() const = 0;    // since 1970-01-01 UTC
  double SteadySeconds() const { return 1e-9 * static_cast<double>(SteadyNanos()); }
};

// The machine's clocks. Thread-safe.
const Clock& RealClock();

class FakeClock final : public Clock {
 public:
  int64_t SteadyNanos() const override { return steady_; }
  int64_t WallNanos() const override { return wall_; }
  void Advance(int64_t nanos) { steady_ += nanos, wall_ += nanos; }
  void JumpWall(int64_t nanos) { wall_ += nanos; }

 private:
  int64_t steady_ = 1'000'000'000;
  int64_t wall_ = 1'700'000'000'000'000'000;
};

// ISO 8601, UTC, milliseconds: "2026-01-31T12:00:00.000Z".
std::string FormatWallTime(int64_t wall_nanos);

}  // namespace rg
