#include "common/base/parallel.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <mutex>
#include <numeric>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace rg {
namespace {

constexpr int kWidest = 5;  // threads of any loop below

// Which threads took part, by the kernel's numbers: those of threads that ended are not soon given out again.
class Threads {
 public:
  void Note() {
    const std::lock_guard lock(mutex_);
    seen_.insert(gettid());
  }
  int count() {
    const std::lock_guard lock(mutex_);
    return static_cast<int>(seen_.size());
  }

 private:
  std::mutex mutex_;
  std::set<pid_t> seen_;
};

// Loops on until so many threads took part in one.
void AwaitWidth(int threads) {
  for (int seen = 0; seen < threads;) {
    Threads took_part;
    ParallelFor(threads, 10 * threads, [&](int, int) {
      took_part.Note();
      usleep(1000);
    });
    seen = took_part.count();
  }
}

TEST(ParallelFor, CallsEveryIndexOnceAndNoWorkerTwiceAtATime) {
  constexpr int kCount = 5000;
  std::vector<std::atomic<int>> calls(kCount), busy(kWidest);
  std::atomic<int> twice{0};
  ParallelFor(kWidest, kCount, [&](int worker, int index) {
    if (++busy.at(static_cast<size_t>(worker)) != 1) ++twice;
    ++calls[static_cast<size_t>(index)];
    --busy[static_cast<size_t>(worker)];
  });
  EXPECT_TRUE(std::ranges::all_of(calls, [](const auto& n) { return n == 1; }));
  EXPECT_EQ(twice, 0);
}

TEST(ParallelFor, OfOneThreadGoesInOrderOnTheCallers) {
  std::vector<int> order;
  ParallelFor(1, 4, [&](int worker, int index) { order.push_back(10 * worker + index); });
  EXPECT_EQ(order, (std::vector<int>{0, 1, 2, 3}));
  ParallelFor(4, 0, [&](int, int) { ADD_FAILURE(); });
}

TEST(ParallelFor, HasAsManyThreadsAsAskedFor) {
  AwaitWidth(2);
  AwaitWidth(kWidest);
}

TEST(ParallelFor, ManySmallLoopsRunOnTheSameThreads) {
  Threads took_part;
  for (int loop = 0; loop < 200; ++loop) {
    ParallelFor(2, 4, [&](int, int) {
      took_part.Note();
      usleep(500);  // so that the caller does not do all of them
    });
  }
  EXPECT_GE(took_part.count(), 2);
  EXPECT_LE(took_part.count(), kWidest);
  std::vector<int> calls(50'000);
  for (int& n : calls) {
    std::atomic<int> count{0};
    ParallelFor(2, 3, [&](int, int) { ++count; });
    n = count;
  }
  EXPECT_TRUE(std::ranges::all_of(calls, [](int n) { return n == 3; }));
}

// Sum over a tree of loops within loops.
int Count(int depth) {
  if (depth == 0) return 1;
  std::vector<int> parts(3);
  ParallelFor(3, 3, [&](int, int i) { parts[static_cast<size_t>(i)] = Count(depth - 1); });
  return std::accumulate(parts.begin(), parts.end(), 0);
}

TEST(ParallelFor, LoopsMayBeNested) { EXPECT_EQ(Count(6), 729); }

TEST(ParallelFor, LoopsOfSeveralThreadsAtOnceKeepApart) {
  std::vector<int> sums(6);
  std::vector<std::thread> callers;
  for (int& sum : sums) {
    callers.emplace_back([&sum] {
      for (int i = 0; i < 50; ++i) sum += Count(3);
    });
  }
  for (std::thread& caller : callers) caller.join();
  EXPECT_EQ(sums, std::vector<int>(6, 50 * 27));
}

// What came out of a loop whose items throw that `fails` names; how many items ended well.
template <class Fails>
std::string Thrown(int threads, int count, const Fails& fails, std::atomic<int>* ended) {
  try {
    ParallelFor(threads, count, [&](int, int i) {
      if (fails(i)) throw std::runtime_error(std::to_string(i));
      ++*ended;
    });
  } catch (const std::runtime_error& e) {
    return e.what();
  }
  return "nothing";
}

TEST(ParallelFor, ThrowsWhatTheLeastIndexThrewAndBeginsNoMore) {
  for (const int threads : {1, 2, kWidest}) {
    for (int round = 0; round < 200; ++round) {
      std::atomic<int> ended{0};
      ASSERT_EQ(Thrown(
                    threads, 100'000, [](int i) { return i >= 7; }, &ended),
                "7");
      ASSERT_EQ(ended, 7);
    }
    std::atomic<int> ended{0};
    EXPECT_EQ(Thrown(
                  threads, 50, [](int) { return false; }, &ended),
              "nothing")
        << "the pool goes on";
    EXPECT_EQ(ended, 50);
  }
}

TEST(ParallelFor, WhatANestedLoopThrowsPassesThroughBoth) {
  const auto nested = [](int outer) {
    ParallelFor(2, 4, [&](int, int inner) {
      if (outer == 2 && inner == 3) throw std::runtime_error("inner");
    });
  };
  EXPECT_THROW(ParallelFor(3, 6, [&](int, int i) { nested(i); }), std::runtime_error);
}

TEST(ParallelFor, AChildByForkHasThreadsOfItsOwn) {
#ifdef __SANITIZE_THREAD__
  GTEST_SKIP() << "ThreadSanitizer starts no threads after a fork";
#endif
  AwaitWidth(2);
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    alarm(120);  // the parent's threads are not here: who waits for them waits forever
    AwaitWidth(2);
    _exit(0);
  }
  int how = 0;
  ASSERT_EQ(waitpid(child, &how, 0), child);
  EXPECT_TRUE(WIFEXITED(how) && WEXITSTATUS(how) == 0) << how;
}

}  // namespace
}  // namespace rg
