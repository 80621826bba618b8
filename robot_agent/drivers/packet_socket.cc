#include "robot_agent/drivers/packet_socket.h"

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <cstring>

namespace rg::robot_agent {
namespace {

Status Failure(const std::string& what) { return UnavailableError(what + ": " + std::strerror(errno)); }

Result<sockaddr_un> AddressOf(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.empty() || path.size() >= sizeof address.sun_path)
    return InvalidError("socket path \"" + path + "\": needs 1 to " +
                        std::to_string(sizeof address.sun_path - 1) + " characters");
  std::memcpy(address.sun_path, path.data(), path.size());
  return address;
}

}  // namespace

Result<std::pair<PacketSocket, PacketSocket>> PacketSocket::Pair() {
  int files[2];
  if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, files) != 0) return Failure("socketpair");
  return std::pair(PacketSocket(files[0]), PacketSocket(files[1]));
}

Result<PacketSocket> PacketSocket::ConnectTo(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const sockaddr_un address, AddressOf(path));
  PacketSocket made(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  if (!made.open()) return Failure("socket");
  if (connect(made.file_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return Failure("cannot reach the robot at " + path);
  return made;
}

Result<PacketSocket> PacketSocket::Listen(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const sockaddr_un address, AddressOf(path));
  PacketSocket made(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  if (!made.open()) return Failure("socket");
  unlink(path.c_str());
  if (bind(made.file_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      listen(made.file_, 1) != 0)
    return Failure("cannot listen at " + path);
  return made;
}

Result<PacketSocket> PacketSocket::Accept() const {
  int file;
  do {
    file = accept4(file_, nullptr, nullptr, SOCK_CLOEXEC);
  } while (file < 0 && errno == EINTR);
  if (file < 0) return Failure("accept");
  return PacketSocket(file);
}

void PacketSocket::Close() {
  if (file_ >= 0) close(file_);
  file_ = -1;
}

Status PacketSocket::Send(const void* bytes, size_t count) const {
  while (true) {
    if (send(file_, bytes, count, MSG_DONTWAIT | MSG_NOSIGNAL) >= 0) return Status::Ok();
    if (errno == EINTR) continue;
    if (errno == EAGAIN || errno == ENOBUFS)
      return ResourceExhaustedError("the robot does not read its messages");
    return Failure("the robot is gone");
  }
}

PacketSocket::Received PacketSocket::Receive(void* bytes, size_t capacity, double timeout_s) const {
  if (file_ < 0) return {StatusCode::kUnavailable, 0};
  while (true) {
    const ssize_t count = recv(file_, bytes, capacity, MSG_DONTWAIT);
    if (count > 0) return {StatusCode::kOk, static_cast<size_t>(count)};
    if (count == 0) return {StatusCode::kUnavailable, 0};
    if (errno == EINTR) continue;
    if (errno != EAGAIN && errno != EWOULDBLOCK) return {StatusCode::kUnavailable, 0};
    if (timeout_s <= 0) return {StatusCode::kDeadlineExceeded, 0};
    // In nanoseconds: a guard's patience is not rounded up to the next millisecond.
    const auto nanos = static_cast<int64_t>(std::ceil(1e9 * timeout_s));
    const timespec at_most{nanos / 1'000'000'000, nanos % 1'000'000'000};
    pollfd waiting{file_, POLLIN, 0};
    const int ready = ppoll(&waiting, 1, &at_most, nullptr);
    if (ready == 0) return {StatusCode::kDeadlineExceeded, 0};
    if (ready < 0 && errno != EINTR) return {StatusCode::kUnavailable, 0};
  }
}

}  // namespace rg::robot_agent
