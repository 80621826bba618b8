// Heartbeats as pure state: no thread, no socket, the time is an argument (steady nanoseconds).
#pragma once

#include <cstdint>
#include <string>
#include <unordered_map>
#include <vector>

namespace rg::transport {

struct HeartbeatOptions {
  int64_t interval_ns = 2'000'000'000;  // > 0
  int missed_allowed = 2;               // lost after this many silent intervals, >= 1
  int64_t timeout_ns() const { return interval_ns * missed_allowed; }
};

// The side that speaks: when is the next beat due? Anything sent counts as one.
class HeartbeatSender {
 public:
  HeartbeatSender(const HeartbeatOptions& options, int64_t now)
      : interval_ns_(options.interval_ns), next_(now) {}
  bool Due(int64_t now) const { return now >= next_; }
  void Sent(int64_t now) { next_ = now + interval_ns_; }
  int64_t next() const { return next_; }

 private:
  int64_t interval_ns_;
  int64_t next_;
};

// The side that listens: who has been silent for too long?
class HeartbeatMonitor {
 public:
  explicit HeartbeatMonitor(const HeartbeatOptions& options) : options_(options) {}

  // A sign of life. Time never runs backward for a peer: an older `now` is ignored.
  void Seen(const std::string& peer, int64_t now);
  void Forget(const std::string& peer) { last_seen_.erase(peer); }
  bool Knows(const std::string& peer) const { return last_seen_.count(peer) > 0; }
  // Peers silent for longer than the timeout, sorted by name; they are forgotten, so each is told once.
  std::vector<std::string> TakeExpired(int64_t now);
  // When the next peer can expire; INT64_MAX: nobody is watched.
  int64_t NextDeadline() const;
  int64_t last_seen(const std::string& peer) const;  // -1: unknown
  size_t size() const { return last_seen_.size(); }

 private:
  HeartbeatOptions options_;
  std::unordered_map<std::string, int64_t> last_seen_;
};

}  // namespace rg::transport
