#include "common/base/parallel.h"

#include <pthread.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace rg {
namespace {

struct Loop {
  const std::function<void(int, int)>& body;
  const int count, threads;
  std::atomic<int> next{0};
  // The rest under the pool's mutex.
  int workers = 1;  // numbers given out, 0 to the caller
  int helping = 0;  // threads of the pool that are at it
  std::condition_variable left;
  int failed = 0;  // index of `failure`
  std::exception_ptr failure;
};

class Pool {
 public:
  void Run(Loop& loop) {
    Open(loop);
    Work(loop, 0);
    std::unique_lock lock(mutex_);
    Close(loop);
    loop.left.wait(lock, [&] { return loop.helping == 0; });
  }

 private:
  void Open(Loop& loop) {
    const int helpers = loop.threads - 1;
    {
      const std::lock_guard lock(mutex_);
      open_.push_back(&loop);
      while (threads_ < helpers && StartThread()) ++threads_;
    }
    for (int i = 0; i < helpers; ++i) opened_.notify_one();
  }

  void Close(Loop& loop) { std::erase(open_, &loop); }

  // A thread that the system refuses is done without.
  bool StartThread() {
    try {
      std::thread([this] { Help(); }).detach();
      return true;
    } catch (const std::system_error&) {
      return false;
    }
  }

  [[noreturn]] void Help() {
    std::unique_lock lock(mutex_);
    while (true) {
      opened_.wait(lock, [this] { return !open_.empty(); });
      Loop& loop = *open_.front();
      const int worker = loop.workers++;
      if (loop.workers == loop.threads) Close(loop);
      ++loop.helping;
      lock.unlock();
      Work(loop, worker);
      lock.lock();
      Close(loop);  // nothing is left to begin
      // Under the lock: without it the loop could be gone before it is told.
      if (--loop.helping == 0) loop.left.notify_one();
    }
  }

  void Work(Loop& loop, int worker) {
    int index = 0;
    try {
      while ((index = loop.next.fetch_add(1)) < loop.count) loop.body(worker, index);
    } catch (...) {
      // Lower indices were begun before this one, so that theirs are heard too.
      loop.next = loop.count;
      const std::lock_guard lock(mutex_);
      if (loop.failure && loop.failed < index) return;
      loop.failed = index;
      loop.failure = std::current_exception();
    }
  }

  std::mutex mutex_;
  std::condition_variable opened_;
  std::vector<Loop*> open_;  // that a thread may join, the oldest first
  int threads_ = 0;
};

// Never destroyed: its threads live until the process ends.
std::atomic<Pool*> the_pool = nullptr;

// A child by fork has none of the parent's threads, and its copy of the pool may be locked: it begins anew.
[[maybe_unused]] const int at_fork = pthread_atfork(nullptr, nullptr, [] { the_pool = nullptr; });

Pool& ThePool() {
  Pool* pool = the_pool;
  if (pool != nullptr) return *pool;
  auto* fresh = new Pool;
  if (the_pool.compare_exchange_strong(pool, fresh)) return *fresh;
  delete fresh;
  return *pool;
}

}  // namespace

void ParallelFor(int threads, int count, const std::function<void(int, int)>& body) {
  threads = std::min(threads, count);
  if (threads <= 1) {
    for (int i = 0; i < count; ++i) body(0, i);
    return;
  }
  Loop loop{body, count, threads};
  ThePool().Run(loop);
  if (loop.failure) std::rethrow_exception(loop.failure);
}

int ChooseThreads(int wanted) {
  if (wanted > 0) return wanted;
  return std::max(1u, std::thread::hardware_concurrency());
}

}  // namespace rg
