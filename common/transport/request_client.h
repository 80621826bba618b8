// Request and reply with a timeout and repeats, for the command line and the workers.
//
// One request at a time per client, from one thread. A repeat carries the same request id, so that
// the server can know it for one; late replies to earlier requests are dropped.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "common/base/clock.h"
#include "common/base/status.h"
#include "common/transport/socket.h"

namespace rg::transport {

struct RequestOptions {
  int64_t connect_timeout_ms = 5'000;  // until somebody is there to send to
  int64_t attempt_timeout_ms = 5'000;  // then the request is sent again
  int attempts = 3;                    // >= 1
};

class RequestClient {
 public:
  // `server` is what a person calls the other end in errors: "coordinator at tcp://10.0.0.1:7341".
  // Events that arrive while a reply is awaited go to `on_event` (may be empty).
  RequestClient(std::unique_ptr<Socket> socket, Sender self, std::string server, const Clock& clock,
                RequestOptions options = {}, std::function<void(Message)> on_event = {});
  ~RequestClient();

  // kUnavailable: nobody there, or no answer after all attempts. kPermissionDenied: our key was
  // refused. kCancelled. Otherwise what the server said.
  Result<Message> Call(Message request);
  template <class Reply, class Body>
  Result<Reply> Call(const Body& body) {
    auto reply = Call(MakeRequest(self_, body));
    if (!reply.ok()) return reply.status();
    return Unpack<Reply>(*reply);
  }

  // From any thread or a signal handler: the call under way and all later ones return kCancelled.
  void Cancel();

  const Sender& self() const { return self_; }
  Socket& socket() { return *socket_; }
  uint64_t repeats() const { return repeats_; }
  uint64_t late_replies() const { return late_replies_; }

 private:
  Status CheckNotCancelled() const;
  Status WaitForServer();
  Status SendOnce(const Message& request);
  Result<Message> AwaitReply(const std::string& request_id, bool* timed_out);

  std::unique_ptr<Socket> socket_;
  Sender self_;
  std::string server_;
  const Clock& clock_;
  RequestOptions options_;
  std::function<void(Message)> on_event_;
  std::atomic<bool> cancelled_{false};
  int wake_fd_ = -1;
  uint64_t repeats_ = 0;
  uint64_t late_replies_ = 0;
};

}  // namespace rg::transport
