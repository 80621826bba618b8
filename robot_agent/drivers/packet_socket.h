// Unix sockets that keep message boundaries (SOCK_SEQPACKET) and notice when the peer is gone.
#pragma once

#include <cstddef>
#include <string>
#include <utility>

#include "common/base/status.h"

namespace rg::robot_agent {

class PacketSocket {
 public:
  PacketSocket() = default;
  explicit PacketSocket(int file) : file_(file) {}
  ~PacketSocket() { Close(); }
  PacketSocket(PacketSocket&& other) noexcept : file_(std::exchange(other.file_, -1)) {}
  PacketSocket& operator=(PacketSocket&& other) noexcept {
    if (this != &other) Close(), file_ = std::exchange(other.file_, -1);
    return *this;
  }

  static Result<std::pair<PacketSocket, PacketSocket>> Pair();
  static Result<PacketSocket> ConnectTo(const std::string& path);
  // Replaces a stale socket file at `path`.
  static Result<PacketSocket> Listen(const std::string& path);
  Result<PacketSocket> Accept() const;  // waits

  bool open() const { return file_ >= 0; }
  int file() const { return file_; }
  void Close();

  // Neither waits nor allocates on success. kUnavailable: the peer is gone; kResourceExhausted: it
  // does not read.
  Status Send(const void* bytes, size_t count) const;
  // Waits up to timeout_s (0: not at all). The number of bytes; kDeadlineExceeded: nothing came;
  // kUnavailable: the peer is gone. Longer messages are cut to `capacity`. Allocates only on errors
  // other than kDeadlineExceeded.
  struct Received {
    StatusCode code = StatusCode::kOk;
    size_t bytes = 0;
  };
  Received Receive(void* bytes, size_t capacity, double timeout_s) const;

 private:
  int file_ = -1;
};

}  // namespace rg::robot_agent
