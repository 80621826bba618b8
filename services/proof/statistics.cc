#include "services/proof/statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rg::proof {

Share ShareOf(double hits, int n) {
  Share s;
  s.n = n;
  if (n == 0) {
    s.value = std::numeric_limits<double>::quiet_NaN();
    return s;
  }
  constexpr double z = 1.959964;
  s.value = hits / n;
  const double middle = s.value + z * z / (2 * n),
               width = z * std::sqrt(s.value * (1 - s.value) / n + z * z / (4.0 * n * n));
  s.low = std::max(0.0, (middle - width) / (1 + z * z / n));
  s.high = std::min(1.0, (middle + width) / (1 + z * z / n));
  return s;
}

double Mean(const std::vector<double>& v) {
  double sum = 0;
  for (const double x : v) sum += x;
  return v.empty() ? std::numeric_limits<double>::quiet_NaN() : sum / static_cast<double>(v.size());
}

double Median(std::vector<double> v) {
  if (v.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::sort(v.begin(), v.end());
  const size_t middle = v.size() / 2;
  return v.size() % 2 == 1 ? v[middle] : 0.5 * (v[middle - 1] + v[middle]);
}

double McNemarExact(int won, int lost) {
  const int n = won + lost, fewer = std::min(won, lost);
  double tail = 0, term = std::pow(0.5, n);  // P(X = k) of a fair coin thrown n times
  for (int k = 0; k <= fewer; ++k) {
    tail += term;
    term *= static_cast<double>(n - k) / (k + 1);
  }
  return std::min(1.0, 2 * tail);
}

}  // namespace rg::proof
