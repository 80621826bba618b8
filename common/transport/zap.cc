#include "common/transport/zap.h"

#include <sys/eventfd.h>
#include <unistd.h>

#include <vector>

#include "common/base/log.h"

namespace rg::transport {
namespace {

// Positions in a request, RFC 27.
enum Field { kVersion, kRequestId, kDomain, kAddress, kRoutingId, kMechanism, kCredentials, kFieldCount };

std::string EncodeKey(const zmq::message_t& key) {
  char text[41];
  if (key.size() != 32 || zmq_z85_encode(text, key.data<uint8_t>(), 32) == nullptr) return {};
  return text;
}

// A key that may not come in is told nothing: "300" ends the connection without a word (RFC 26, 27), and
// the other end sees a time-out as if nobody were here.
void Reply(zmq::socket_t* socket, const std::vector<zmq::message_t>& request, bool accept,
           const std::string& user) {
  const auto send = [&](std::string_view text, bool more) {
    socket->send(zmq::buffer(text), more ? zmq::send_flags::sndmore : zmq::send_flags::none);
  };
  send("1.0", true);
  send(request[kRequestId].to_string_view(), true);
  send(accept ? "200" : "300", true);
  send(accept ? "OK" : "", true);
  send(accept ? user : "", true);
  send("", false);
}

}  // namespace

ZapHandler::ZapHandler(zmq::context_t* context)
    : socket_(*context, zmq::socket_type::rep), stop_fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
  socket_.set(zmq::sockopt::linger, 0);
  socket_.bind("inproc://zeromq.zap.01");
  thread_ = std::thread([this] { Run(); });
}

ZapHandler::~ZapHandler() {
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t n = ::write(stop_fd_, &one, sizeof one);
  thread_.join();
  ::close(stop_fd_);
}

void ZapHandler::SetAllowList(AllowList allowed) {
  auto list = std::make_shared<const AllowList>(std::move(allowed));
  {
    const std::lock_guard lock(mutex_);
    allowed_ = std::move(list);
  }
  generation_.fetch_add(1, std::memory_order_release);
}

std::shared_ptr<const AllowList> ZapHandler::allowed() const {
  const std::lock_guard lock(mutex_);
  return allowed_;
}

void ZapHandler::Run() {
  while (true) {
    zmq_pollitem_t items[] = {{socket_.handle(), 0, ZMQ_POLLIN, 0}, {nullptr, stop_fd_, ZMQ_POLLIN, 0}};
    if (zmq_poll(items, 2, -1) < 0 && zmq_errno() != EINTR) return;
    if (items[1].revents != 0) return;
    if (items[0].revents == 0) continue;
    try {
      AnswerOne();
    } catch (const zmq::error_t& e) {
      if (e.num() == ETERM) return;
      spdlog::warn("handshake not answered: {}", e.what());
    }
  }
}

void ZapHandler::AnswerOne() {
  std::vector<zmq::message_t> request;
  do {
    request.emplace_back();
    if (!socket_.recv(request.back())) return;
  } while (request.back().more());
  if (request.size() < kCredentials) return;  // libzmq itself asks; it would not
  std::string key;
  if (request.size() == kFieldCount && request[kMechanism].to_string_view() == "CURVE" &&
      request[kDomain].to_string_view() == kZapDomain)
    key = EncodeKey(request[kCredentials]);
  const bool accept = !key.empty() && allowed()->Find(key) != nullptr;
  accept ? ++accepted_ : ++refused_;
  if (!accept)
    spdlog::warn("connection from {} refused: key {} is not on the allow-list",
                 request[kAddress].to_string_view(), key.empty() ? "(none)" : key);
  Reply(&socket_, request, accept, key);
}

}  // namespace rg::transport
