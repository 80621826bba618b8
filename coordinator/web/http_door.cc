#include "coordinator/web/http_door.h"

#include <netdb.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>

#include "common/base/clock.h"

namespace rg::coordinator::web {
namespace {

constexpr size_t kProbeThreads = 2, kMaxWaiting = 1024;
constexpr char kEndOfHead[] = "\r\n\r\n";

int64_t Now() { return RealClock().SteadyNanos(); }
int64_t Nanos(double seconds) { return static_cast<int64_t>(1e9 * seconds); }

std::string AddressOf(int socket) {
  sockaddr_storage peer{};
  socklen_t size = sizeof peer;
  char host[NI_MAXHOST] = "";
  if (::getpeername(socket, reinterpret_cast<sockaddr*>(&peer), &size) == 0)
    ::getnameinfo(reinterpret_cast<sockaddr*>(&peer), size, host, sizeof host, nullptr, 0, NI_NUMERICHOST);
  return host;
}

// Bytes of the body that the head announces.
size_t BodyBytes(const std::string& head) {
  constexpr std::string_view kField = "\r\ncontent-length:";
  const auto same = [](char a, char b) { return std::tolower(static_cast<unsigned char>(a)) == b; };
  const auto field = std::search(head.begin(), head.end(), kField.begin(), kField.end(), same);
  if (field == head.end()) return 0;
  size_t at = static_cast<size_t>(field - head.begin()) + kField.size(), bytes = 0;
  while (at < head.size() && head[at] == ' ') ++at;
  const auto [rest, error] = std::from_chars(head.data() + at, head.data() + head.size(), bytes);
  return error == std::errc() ? bytes : 0;
}

bool IsWhole(const std::string& bytes, size_t limit) {
  const size_t head = bytes.find(kEndOfHead);
  if (head == std::string::npos) return false;
  const size_t before = head + sizeof kEndOfHead - 1;
  return bytes.size() - before >= std::min(BodyBytes(bytes.substr(0, head)), limit);  // more is refused by its handler
}

bool IsProbe(const std::string& bytes) {
  for (const char* path : {"/healthz", "/readyz", "/metrics"}) {
    if (bytes.rfind("GET " + std::string(path), 0) == 0) return true;
  }
  return false;
}

// A request that was read, and the socket for the answer, which must be taken in time.
class ReadRequest : public httplib::Stream {
 public:
  ReadRequest(const std::string& bytes, int socket, std::string address, int64_t deadline_ns)
      : bytes_(bytes), socket_(socket), address_(std::move(address)), deadline_ns_(deadline_ns) {}
  bool is_readable() const override { return at_ < bytes_.size(); }
  bool is_writable() const override {
    pollfd waiting{socket_, POLLOUT, 0};
    return ::poll(&waiting, 1, static_cast<int>(std::max<int64_t>(0, (deadline_ns_ - Now()) / 1'000'000))) > 0;
  }
  ssize_t read(char* to, size_t size) override {
    const size_t n = bytes_.copy(to, size, at_);
    at_ += n;
    return static_cast<ssize_t>(n);
  }
  ssize_t write(const char* from, size_t size) override {
    for (size_t done = 0; done < size;) {
      if (!is_writable()) return -1;
      const ssize_t n = ::send(socket_, from + done, size - done, MSG_NOSIGNAL | MSG_DONTWAIT);
      if (n < 0 && errno != EAGAIN && errno != EINTR) return -1;
      done += static_cast<size_t>(std::max<ssize_t>(n, 0));
    }
    return static_cast<ssize_t>(size);
  }
  void get_remote_ip_and_port(std::string& ip, int&) const override { ip = address_; }
  void get_local_ip_and_port(std::string&, int&) const override {}
  socket_t socket() const override { return socket_; }

 private:
  const std::string& bytes_;
  size_t at_ = 0;
  int socket_;
  std::string address_;
  int64_t deadline_ns_;
};

// The library's own queue would give each connection a thread before it has said anything.
class AtOnce : public httplib::TaskQueue {
 public:
  void enqueue(std::function<void()> task) override { task(); }
  void shutdown() override {}
};

}  // namespace

HttpDoor::HttpDoor(const DoorLimits& limits)
    : limits_(limits),
      wake_fd_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
      pages_(std::make_unique<httplib::ThreadPool>(limits.threads)),
      probes_(std::make_unique<httplib::ThreadPool>(kProbeThreads)) {
  new_task_queue = [] { return new AtOnce; };
  reader_ = std::thread([this] { ReadForever(); });
}

HttpDoor::~HttpDoor() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  ::eventfd_write(wake_fd_, 1);
  reader_.join();
  pages_->shutdown();
  probes_->shutdown();
  for (const Visitor& visitor : visitors_) ::close(visitor.socket);
  for (const Visitor& visitor : newcomers_) ::close(visitor.socket);
  ::close(wake_fd_);
}

bool HttpDoor::process_and_close_socket(socket_t socket) {
  const std::lock_guard lock(mutex_);
  newcomers_.push_back({socket, AddressOf(socket), "", Now() + Nanos(limits_.read_s)});
  ::eventfd_write(wake_fd_, 1);
  return true;
}

void HttpDoor::ReadForever() {
  while (true) {
    Wait();
    TakeNewcomers();
    {
      const std::lock_guard lock(mutex_);
      if (stop_) return;
    }
    std::erase_if(visitors_, [&](Visitor& visitor) { return !Read(visitor); });
  }
}

void HttpDoor::Wait() {
  std::vector<pollfd> waiting{{wake_fd_, POLLIN, 0}};
  for (const Visitor& visitor : visitors_) waiting.push_back({visitor.socket, POLLIN, 0});
  constexpr int kLookMs = 200;  // for who has taken too long
  ::poll(waiting.data(), waiting.size(), visitors_.empty() ? -1 : kLookMs);
}

void HttpDoor::TakeNewcomers() {
  eventfd_t count = 0;
  ::eventfd_read(wake_fd_, &count);
  std::vector<Visitor> newcomers;
  {
    const std::lock_guard lock(mutex_);
    newcomers.swap(newcomers_);
  }
  for (Visitor& visitor : newcomers) {
    const auto is_same = [&](const Visitor& other) { return other.address == visitor.address; };
    const auto same = static_cast<size_t>(std::count_if(visitors_.begin(), visitors_.end(), is_same));
    const bool too_many = same >= limits_.waiting_per_address || visitors_.size() >= kMaxWaiting;
    if (too_many) {
      auto oldest = std::find_if(visitors_.begin(), visitors_.end(), is_same);
      if (oldest == visitors_.end()) oldest = visitors_.begin();
      ShowOut(*oldest, "408 Request Timeout");
      visitors_.erase(oldest);
    }
    visitors_.push_back(std::move(visitor));
  }
}

bool HttpDoor::Read(Visitor& visitor) {
  char piece[4096];
  ssize_t n = 0;
  while ((n = ::recv(visitor.socket, piece, sizeof piece, MSG_DONTWAIT)) > 0) {
    visitor.bytes.append(piece, static_cast<size_t>(n));
    if (visitor.bytes.size() > limits_.max_request_bytes || IsWhole(visitor.bytes, limits_.max_request_bytes))
      return HandOn(std::move(visitor)), false;
  }
  const bool waits = n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR);
  if (waits && Now() < visitor.deadline_ns) return true;
  ShowOut(visitor, waits ? "408 Request Timeout" : "");
  return false;
}

void HttpDoor::HandOn(Visitor visitor) {
  const bool is_probe = IsProbe(visitor.bytes);
  if (!is_probe) {
    const std::lock_guard lock(mutex_);
    size_t& answering = answering_[visitor.address];
    if (answering >= limits_.answers_per_address) return ShowOut(visitor, "503 Service Unavailable");
    ++answering;
  }
  auto& threads = is_probe ? probes_ : pages_;
  threads->enqueue([this, is_probe, visitor = std::move(visitor)] {
    Answer(visitor);
    if (is_probe) return;
    const std::lock_guard lock(mutex_);
    const auto answering = answering_.find(visitor.address);
    if (--answering->second == 0) answering_.erase(answering);
  });
}

void HttpDoor::Answer(const Visitor& visitor) {
  ReadRequest request(visitor.bytes, visitor.socket, visitor.address, Now() + Nanos(limits_.write_s));
  bool closed = false;
  process_request(request, true, closed, nullptr);
  ::shutdown(visitor.socket, SHUT_RDWR);
  ::close(visitor.socket);
}

// `status` empty: it has gone by itself.
void HttpDoor::ShowOut(const Visitor& visitor, const char* status) {
  if (*status != 0) {
    const std::string reply = "HTTP/1.1 " + std::string(status) + "\r\nConnection: close\r\nContent-Length: 0\r\n\r\n";
    [[maybe_unused]] const ssize_t sent = ::send(visitor.socket, reply.data(), reply.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  }
  ::shutdown(visitor.socket, SHUT_RDWR);
  ::close(visitor.socket);
}

}  // namespace rg::coordinator::web
