// Protocol buffers over a stream socket: four bytes of length, little-endian, then the message.
#pragma once

#include <cstdint>
#include <string>

#include "common/base/status.h"
#include "google/protobuf/message_lite.h"

namespace rg::worker {

constexpr size_t kMaxFrameBytes = 256u << 20;

// Blocks until all is written. kUnavailable: the other end is gone. Not thread-safe per descriptor.
Status WriteFrame(int fd, const google::protobuf::MessageLite& message);

// Collects bytes as they come; hands out whole frames.
class FrameReader {
 public:
  enum class State { kOpen, kClosed };
  // Reads what is there (fd may be blocking: then one read). kClosed: end of stream or an error.
  State ReadSome(int fd);
  // The next whole frame's bytes, if there is one.
  bool Next(std::string* frame);

 private:
  std::string buffer_;
  size_t begin_ = 0;
};

}  // namespace rg::worker
