#include "common/transport/heartbeat.h"

#include <algorithm>
#include <cstdint>
#include <limits>

namespace rg::transport {

void HeartbeatMonitor::Seen(const std::string& peer, int64_t now) {
  int64_t& last = last_seen_.try_emplace(peer, now).first->second;
  last = std::max(last, now);
}

std::vector<std::string> HeartbeatMonitor::TakeExpired(int64_t now) {
  std::vector<std::string> expired;
  for (const auto& [peer, last] : last_seen_)
    if (now - last > options_.timeout_ns()) expired.push_back(peer);
  for (const std::string& peer : expired) last_seen_.erase(peer);
  std::sort(expired.begin(), expired.end());
  return expired;
}

int64_t HeartbeatMonitor::NextDeadline() const {
  int64_t next = std::numeric_limits<int64_t>::max();
  for (const auto& [peer, last] : last_seen_) next = std::min(next, last + options_.timeout_ns() + 1);
  return next;
}

int64_t HeartbeatMonitor::last_seen(const std::string& peer) const {
  const auto found = last_seen_.find(peer);
  return found == last_seen_.end() ? -1 : found->second;
}

}  // namespace rg::transport
