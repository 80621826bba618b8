#include "robot_agent/drivers/kinova/clock_map.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rg::robot_agent::kinova {
namespace {
constexpr int64_t kNothing = std::numeric_limits<int64_t>::max();
}

ClockMap::ClockMap(double window_s) : part_ns_(std::llround(1e9 * window_s / kParts)) {
  least_.fill(kNothing);
}

void ClockMap::Note(int64_t difference_ns, int64_t received_ns) {
  const int64_t part = received_ns / part_ns_;
  if (!started_ || part - part_ >= kParts) {
    least_.fill(kNothing);
    part_ = part;
  }
  while (part_ < part) least_[++part_ % kParts] = kNothing;
  int64_t& least = least_[part % kParts];
  least = std::min(least, difference_ns);
  started_ = true;
}

int64_t ClockMap::ToHost(int64_t stamp_ns, int64_t received_ns) {
  const int64_t difference = received_ns - stamp_ns;
  if (started_ && std::abs(difference - offset_ns_) > kLeap) started_ = false;
  Note(difference, received_ns);
  offset_ns_ = *std::min_element(least_.begin(), least_.end());
  const int64_t host = std::max(stamp_ns + offset_ns_, last_host_ns_ + 1);
  last_host_ns_ = std::min(host, received_ns);
  return last_host_ns_;
}

}  // namespace rg::robot_agent::kinova
