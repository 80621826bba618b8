#include "services/sysid/parallel.h"

#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

namespace rg::sysid {

void ParallelFor(int threads, int count, const std::function<void(int, int)>& body) {
  threads = std::min(threads, count);
  if (threads <= 1) {
    for (int i = 0; i < count; ++i) body(0, i);
    return;
  }
  std::atomic<int> next{0};
  const auto work = [&](int worker) {
    for (int i = next.fetch_add(1); i < count; i = next.fetch_add(1)) body(worker, i);
  };
  std::vector<std::thread> pool;
  for (int w = 1; w < threads; ++w) pool.emplace_back(work, w);
  work(0);
  for (std::thread& t : pool) t.join();
}

int ChooseThreads(int wanted) {
  if (wanted > 0) return wanted;
  return std::max(1u, std::thread::hardware_concurrency());
}

}  // namespace rg::sysid
