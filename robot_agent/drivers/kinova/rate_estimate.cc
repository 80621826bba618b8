#include "robot_agent/drivers/kinova/rate_estimate.h"

#include <algorithm>

namespace rg::robot_agent::kinova {

void RateEstimate::Note(int64_t received_ns) { times_[count_++ % times_.size()] = received_ns; }

int RateEstimate::intervals() const {
  return count_ == 0 ? 0 : static_cast<int>(std::min<uint64_t>(count_ - 1, kMost));
}

double RateEstimate::hz() const {
  const int n = intervals();
  if (n == 0) return 0.0;
  const int64_t newest = times_[(count_ - 1) % times_.size()];
  const int64_t oldest = times_[(count_ - 1 - n) % times_.size()];
  return newest > oldest ? 1e9 * n / static_cast<double>(newest - oldest) : 0.0;
}

double RateEstimate::hz_without_longest() const {
  const int n = intervals();
  int64_t sum = 0, longest = 0;
  for (int k = 0; k < n; ++k) {
    const int64_t interval = times_[(count_ - 1 - k) % times_.size()] - times_[(count_ - 2 - k) % times_.size()];
    sum += interval;
    longest = std::max(longest, interval);
  }
  return sum > longest ? 1e9 * (n - 1) / static_cast<double>(sum - longest) : 0.0;
}

}  // namespace rg::robot_agent::kinova
