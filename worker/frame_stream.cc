#include "worker/frame_stream.h"

#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace rg::worker {

Status WriteFrame(int fd, const google::protobuf::MessageLite& message) {
  std::string bytes(4, '\0');
  message.AppendToString(&bytes);
  const size_t length = bytes.size() - 4;
  if (length > kMaxFrameBytes) {
    return ResourceExhaustedError("message of " + std::to_string(length) + " bytes is above the limit of " +
                                  std::to_string(kMaxFrameBytes));
  }
  for (size_t i = 0; i < 4; ++i) bytes[i] = static_cast<char>((length >> (8 * i)) & 0xff);
  size_t sent = 0;
  while (sent < bytes.size()) {
    const ssize_t n = send(fd, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return UnavailableError(std::string("the other end is gone: ") + std::strerror(errno));
    sent += static_cast<size_t>(n);
  }
  return Status::Ok();
}

FrameReader::State FrameReader::ReadSome(int fd) {
  char chunk[1 << 16];
  ssize_t n;
  do {
    n = read(fd, chunk, sizeof(chunk));
  } while (n < 0 && errno == EINTR);
  if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return State::kOpen;
  if (n <= 0) return State::kClosed;
  buffer_.append(chunk, static_cast<size_t>(n));
  return State::kOpen;
}

bool FrameReader::Next(std::string* frame) {
  if (buffer_.size() - begin_ < 4) return false;
  size_t length = 0;
  for (size_t i = 0; i < 4; ++i) length |= size_t{static_cast<unsigned char>(buffer_[begin_ + i])} << (8 * i);
  if (buffer_.size() - begin_ < 4 + length) {
    if (begin_ > 0) buffer_.erase(0, begin_), begin_ = 0;
    return false;
  }
  frame->assign(buffer_, begin_ + 4, length);
  begin_ += 4 + length;
  if (begin_ == buffer_.size()) buffer_.clear(), begin_ = 0;
  return true;
}

}  // namespace rg::worker
