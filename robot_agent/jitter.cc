#include "robot_agent/jitter.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

namespace rg::robot_agent {

int DurationHistogram::Bucket(double us) {
  if (us < 1.0) return 0;
  int exponent = 0;
  const double fraction = std::frexp(us, &exponent);  // us = fraction · 2^exponent, fraction in [0.5, 1)
  const int eighth = static_cast<int>((fraction - 0.5) * 16.0);
  return std::clamp(1 + (exponent - 1) * 8 + eighth, 1, kBuckets - 1);
}

double DurationHistogram::UpperEdge(int bucket) {
  if (bucket == 0) return 1.0;
  const int exponent = (bucket - 1) / 8, eighth = (bucket - 1) % 8;
  return std::ldexp(1.0 + (eighth + 1) / 8.0, exponent);
}

void DurationHistogram::Add(int64_t nanos) {
  const double us = std::max(0.0, 1e-3 * static_cast<double>(nanos));
  ++buckets_[Bucket(us)];
  ++count_;
  sum_us_ += us;
  max_us_ = std::max(max_us_, us);
}

double DurationHistogram::PercentileUs(double p) const {
  if (count_ == 0) return 0.0;
  const auto rank = static_cast<uint64_t>(std::ceil(p / 100.0 * static_cast<double>(count_)));
  uint64_t below = 0;
  for (int b = 0; b < kBuckets; ++b) {
    below += buckets_[b];
    if (below >= std::max<uint64_t>(rank, 1)) return std::min(UpperEdge(b), max_us_);
  }
  return max_us_;
}

namespace {
nlohmann::json Summary(const DurationHistogram& h) {
  return {{"mean", h.mean_us()},
          {"p50", h.PercentileUs(50)},
          {"p90", h.PercentileUs(90)},
          {"p99", h.PercentileUs(99)},
          {"p999", h.PercentileUs(99.9)},
          {"max", h.max_us()}};
}
}  // namespace

std::string JitterReport::ToJson() const {
  return nlohmann::json{{"period_s", period_s},
                        {"lock_step", lock_step},
                        {"ticks", ticks},
                        {"missed_deadlines", missed_deadlines},
                        {"late_2ms", late_2ms},
                        {"lateness_us", Summary(lateness)},
                        {"cycle_us", Summary(cycle)},
                        {"state_age_us", Summary(state_age)},
                        {"realtime", nlohmann::json::parse(realtime.ToJson())}}
      .dump();
}

}  // namespace rg::robot_agent
