// The way in for HTTP. One thread reads the requests of all who have come and hands on those that are whole, so that
// whoever sends a byte a second holds up nobody; who takes too long, or comes too often at once, is shown out. Answers
// are given by a few threads; those to probes (/healthz, /readyz, /metrics) by threads of their own.
#pragma once

#include <httplib.h>

#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

namespace rg::coordinator::web {

struct DoorLimits {
  double read_s = 10.0;            // for a whole request
  double write_s = 60.0;           // for a whole answer
  size_t max_request_bytes = 24 << 10;
  size_t waiting_per_address = 64;  // requests that are not whole yet: the oldest goes
  size_t answers_per_address = 12;  // at once, of `threads`
  size_t threads = 16;
};

class HttpDoor : public httplib::Server {
 public:
  explicit HttpDoor(const DoorLimits& limits = {});
  ~HttpDoor() override;

 private:
  struct Visitor {
    int socket = -1;
    std::string address, bytes;
    int64_t deadline_ns = 0;
  };
  // Called by the library in the thread that accepts: takes the socket.
  bool process_and_close_socket(socket_t socket) override;
  void ReadForever();
  void TakeNewcomers();
  void Wait();
  // False: it is no longer to be waited for.
  bool Read(Visitor& visitor);
  void HandOn(Visitor visitor);
  void Answer(const Visitor& visitor);
  void ShowOut(const Visitor& visitor, const char* status);

  const DoorLimits limits_;
  int wake_fd_;
  std::vector<Visitor> visitors_;  // the reading thread's; the oldest first
  std::mutex mutex_;               // guards what follows
  std::vector<Visitor> newcomers_;
  std::map<std::string, size_t> answering_;  // by address
  bool stop_ = false;
  std::unique_ptr<httplib::ThreadPool> pages_, probes_;
  std::thread reader_;
};

}  // namespace rg::coordinator::web
