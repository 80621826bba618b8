// The ZAP handler (ZeroMQ RFC 27): asked by libzmq at every encrypted handshake whether a key may
// come in. Without it CURVE admits any key that knows the server's. Internal to Context.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <zmq.hpp>

#include "common/transport/keys.h"

namespace rg::transport {

inline constexpr char kZapDomain[] = "realitygrad";

class ZapHandler {
 public:
  explicit ZapHandler(zmq::context_t* context);  // starts the thread
  ~ZapHandler();                                 // stops and joins it

  void SetAllowList(AllowList allowed);
  std::shared_ptr<const AllowList> allowed() const;
  // Raised by every SetAllowList: lets sockets keep a copy of the list and know when it is old.
  uint64_t generation() const { return generation_.load(std::memory_order_acquire); }
  uint64_t accepted() const { return accepted_.load(); }
  uint64_t refused() const { return refused_.load(); }

 private:
  void Run();
  void AnswerOne();

  mutable std::mutex mutex_;  // guards allowed_
  std::shared_ptr<const AllowList> allowed_ = std::make_shared<AllowList>();
  std::atomic<uint64_t> generation_{0};
  std::atomic<uint64_t> accepted_{0};
  std::atomic<uint64_t> refused_{0};
  zmq::socket_t socket_;
  int stop_fd_;
  std::thread thread_;
};

}  // namespace rg::transport
