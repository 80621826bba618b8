#include "services/diagnosis/likelihood/some_windows.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <utility>

namespace rg::diagnosis {

std::vector<uint32_t> EvenlySpread(size_t windows, size_t count) {
  std::vector<uint32_t> out;
  const size_t some = std::min(count, windows);
  for (size_t i = 0; i < some; ++i) out.push_back(static_cast<uint32_t>(i * windows / some));
  return out;
}

std::vector<uint32_t> FirstOfEach(const std::vector<int>& recordings, size_t count) {
  std::vector<std::pair<int, uint32_t>> order;  // how many windows of its recording come before it
  std::map<int, int> before;
  for (size_t w = 0; w < recordings.size(); ++w)
    order.push_back({before[recordings[w]]++, static_cast<uint32_t>(w)});
  std::ranges::sort(order);
  order.resize(std::min(count, order.size()));
  std::vector<uint32_t> out;
  for (const auto& [rank, w] : order) out.push_back(w);
  std::ranges::sort(out);
  return out;
}

std::vector<uint32_t> SomeWindows(const std::vector<double>& amiss, size_t all, size_t wanted) {
  wanted = std::min(wanted, all);
  std::vector<uint32_t> places = EvenlySpread(all, wanted);
  if (amiss.size() != all) return places;
  const double total = std::accumulate(amiss.begin(), amiss.end(), 0.0);
  double held = 0;
  for (const uint32_t i : places) held += amiss[i];
  if (held * static_cast<double>(all) >= 0.5 * total * static_cast<double>(wanted)) return places;
  places.clear();
  double passed = 0, next = 0;
  for (size_t i = 0; i < all; ++i) {
    passed += 0.5 / static_cast<double>(all) + 0.5 * amiss[i] / total;
    if (passed <= next) continue;
    places.push_back(static_cast<uint32_t>(i));
    while (next < passed) next += 1.0 / static_cast<double>(wanted);
  }
  return places;
}

}  // namespace rg::diagnosis
