// A bounded queue from one producer thread to one consumer thread, without locks or allocation after
// construction. Push fails when it is full: the producer never waits.
#pragma once

#include <atomic>
#include <cstddef>
#include <type_traits>
#include <vector>

namespace rg::robot_agent {

template <class T>
class SpscRing {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  explicit SpscRing(size_t capacity) : slots_(capacity + 1) {}

  // Producer only. False: full, nothing was stored.
  bool Push(const T& item) {
    const size_t tail = tail_.load(std::memory_order_relaxed);
    const size_t next = Next(tail);
    if (next == head_.load(std::memory_order_acquire)) return false;
    slots_[tail] = item;
    tail_.store(next, std::memory_order_release);
    return true;
  }

  // Consumer only. False: empty.
  bool Pop(T* item) {
    const size_t head = head_.load(std::memory_order_relaxed);
    if (head == tail_.load(std::memory_order_acquire)) return false;
    *item = slots_[head];
    head_.store(Next(head), std::memory_order_release);
    return true;
  }

 private:
  size_t Next(size_t i) const { return i + 1 == slots_.size() ? 0 : i + 1; }

  std::vector<T> slots_;
  alignas(64) std::atomic<size_t> head_{0};
  alignas(64) std::atomic<size_t> tail_{0};
};

}  // namespace rg::robot_agent
