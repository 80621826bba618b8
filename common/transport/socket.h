// One end of a connection, as the rest of the program sees it. Real ends: zmq_socket.h; ends in
// memory that lose, repeat, delay and reorder: fake_transport.h.
#pragma once

#include <cstdint>
#include <string>
#include <unordered_set>

#include "common/base/status.h"
#include "common/transport/envelope.h"

namespace rg::transport {

struct SocketMetrics {
  uint64_t sent = 0;
  uint64_t received = 0;
  uint64_t sent_bytes = 0;
  uint64_t received_bytes = 0;
  uint64_t send_refused = 0;  // peer unknown or its queue full; the caller was told
  // Dropped on receipt, by reason:
  uint64_t oversize = 0;
  uint64_t malformed = 0;  // frames or bytes that are no envelope
  uint64_t wrong_version = 0;
  uint64_t unknown_type = 0;
  uint64_t unauthorized = 0;  // key revoked, or the claimed role is not the key's

  uint64_t dropped() const { return oversize + malformed + wrong_version + unknown_type + unauthorized; }
};

// What a socket lets in; the same for real and fake ones.
struct ReceiveLimits {
  size_t max_message_bytes = 8u << 20;  // envelope and attachment together
  // Full names of the payload types this program handles. Empty: all. A request of another type is
  // answered with an error, anything else of another type is dropped.
  std::unordered_set<std::string> known_types;
};

// Not thread-safe: one thread owns a socket.
class Socket {
 public:
  virtual ~Socket() = default;

  // Never blocks. kUnavailable: no such peer (router), not connected or queue full; the message is
  // not sent. kInvalid: larger than the limit.
  virtual Status Send(const Message& message) = 0;
  // Never blocks. False: nothing has arrived. What is malformed, too large, of an unknown type or
  // from a wrong role is dropped and counted, and refused with an error reply where it was a request.
  virtual bool Receive(Message* message) = 0;
  // Until something may be received (true), the time is up (false), or `wake_fd` (an eventfd, or
  // -1) becomes readable (false). timeout_ms < 0: for ever.
  virtual bool Wait(int64_t timeout_ms, int wake_fd = -1) = 0;
  // Until Send has somebody to send to, as far as that can be known; same rules as Wait.
  virtual bool WaitWritable(int64_t timeout_ms, int wake_fd = -1) = 0;

  // kPermissionDenied: the other end has refused our key. Ok: connected, or still trying.
  virtual Status LinkError() { return Status::Ok(); }
  // What may be the matter while nobody answers; empty: nothing is known. Not sure enough for an error.
  virtual std::string LinkHint() { return {}; }

  const SocketMetrics& metrics() const { return metrics_; }

 protected:
  SocketMetrics metrics_;
};

}  // namespace rg::transport
