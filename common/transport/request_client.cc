#include "common/transport/request_client.h"

#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>

namespace rg::transport {

RequestClient::RequestClient(std::unique_ptr<Socket> socket, Sender self, std::string server,
                             const Clock& clock, RequestOptions options,
                             std::function<void(Message)> on_event)
    : socket_(std::move(socket)),
      self_(std::move(self)),
      server_(std::move(server)),
      clock_(clock),
      options_(options),
      on_event_(std::move(on_event)),
      wake_fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  RG_CHECK(options_.attempts >= 1);
  RG_CHECK(wake_fd_ >= 0);
}

RequestClient::~RequestClient() { ::close(wake_fd_); }

void RequestClient::Cancel() {
  cancelled_.store(true);
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t n = ::write(wake_fd_, &one, sizeof one);
}

Status RequestClient::CheckNotCancelled() const {
  return cancelled_.load() ? CancelledError("request to " + server_ + " cancelled") : Status::Ok();
}

Status RequestClient::WaitForServer() {
  const int64_t deadline = clock_.SteadyNanos() + options_.connect_timeout_ms * 1'000'000;
  while (true) {
    RG_RETURN_IF_ERROR(CheckNotCancelled());
    const Status link = socket_->LinkError();
    if (!link.ok()) return link.WithPrefix(server_);
    const int64_t left_ms = (deadline - clock_.SteadyNanos() + 999'999) / 1'000'000;
    // In slices, because a refusal shows in the link's state and not as writable.
    if (socket_->WaitWritable(std::clamp<int64_t>(left_ms, 0, 100), wake_fd_)) return Status::Ok();
    if (left_ms > 0) continue;
    const std::string hint = socket_->LinkHint();
    return UnavailableError(server_ + ": nobody answers there" + (hint.empty() ? "" : " (" + hint + ")"));
  }
}

Status RequestClient::SendOnce(const Message& request) {
  RG_RETURN_IF_ERROR(WaitForServer());
  return socket_->Send(request);
}

Result<Message> RequestClient::AwaitReply(const std::string& request_id, bool* timed_out) {
  *timed_out = false;
  const int64_t deadline = clock_.SteadyNanos() + options_.attempt_timeout_ms * 1'000'000;
  while (true) {
    RG_RETURN_IF_ERROR(CheckNotCancelled());
    Message message;
    while (socket_->Receive(&message)) {
      if (message.envelope.kind() == pb::MESSAGE_KIND_REPLY && message.envelope.request_id() == request_id)
        return message;
      if (message.envelope.kind() == pb::MESSAGE_KIND_REPLY)
        ++late_replies_;
      else if (on_event_)
        on_event_(std::move(message));
    }
    const int64_t left_ms = (deadline - clock_.SteadyNanos() + 999'999) / 1'000'000;
    if (left_ms <= 0) {
      *timed_out = true;
      return UnavailableError(server_ + ": no answer within " + std::to_string(options_.attempt_timeout_ms) +
                              " ms");
    }
    socket_->Wait(left_ms, wake_fd_);
  }
}

Result<Message> RequestClient::Call(Message request) {
  const std::string& id = request.envelope.request_id();
  RG_CHECK(!id.empty()) << "a request needs an id";
  for (int attempt = 1;; ++attempt) {
    Status sent = SendOnce(request);
    bool timed_out = false;
    if (sent.ok()) {
      auto reply = AwaitReply(id, &timed_out);
      if (reply.ok()) {
        RG_RETURN_IF_ERROR(ReplyStatus(*reply));
        return reply;
      }
      sent = reply.status();
    }
    const bool retry = timed_out && sent.code() == StatusCode::kUnavailable && attempt < options_.attempts;
    if (!retry && sent.code() == StatusCode::kUnavailable && attempt > 1)
      return UnavailableError(sent.message() + ", asked " + std::to_string(attempt) + " times");
    if (!retry) return sent;
    ++repeats_;
  }
}

}  // namespace rg::transport
