#include "common/transport/zmq_socket.h"

#include <google/protobuf/stubs/logging.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstring>
#include <zmq.hpp>

#include "common/base/clock.h"
#include "common/base/ids.h"
#include "common/base/log.h"
#include "common/transport/endpoint.h"
#include "common/transport/frames.h"
#include "common/transport/zap.h"

namespace rg::transport {

namespace {

// Protobuf writes a line to stderr for each bad byte a peer sends; we count and answer such messages.
void QuietProtobuf() {
  google::protobuf::SetLogHandler(
      [](google::protobuf::LogLevel level, const char*, int, const std::string& what) {
        if (level == google::protobuf::LOGLEVEL_FATAL)
          spdlog::critical("protobuf: {}", what);
        else
          spdlog::debug("protobuf: {}", what);
      });
}

}  // namespace

struct Context::Impl {
  explicit Impl(int io_threads) : context(io_threads) { QuietProtobuf(); }
  zmq::context_t context;
  std::unique_ptr<ZapHandler> zap;  // destroyed before the context
};

Context::Context(int io_threads) : impl_(std::make_unique<Impl>(io_threads)) {}
Context::~Context() = default;

void Context::SetAllowList(AllowList allowed) {
  if (!impl_->zap) impl_->zap = std::make_unique<ZapHandler>(&impl_->context);
  impl_->zap->SetAllowList(std::move(allowed));
}

Context::Handshakes Context::handshakes() const {
  if (!impl_->zap) return {};
  return {impl_->zap->accepted(), impl_->zap->refused()};
}

namespace {

// A receive call gives control back after this many dropped messages, whatever more there is.
constexpr int kMaxDropsPerReceive = 256;
// Handshakes that ended without a reason before we take it for a refusal.
constexpr int kSilentHandshakes = 3;
// libzmq gives a connection up for good once it was refused; we ask again, for the key may be
// allowed by now.
constexpr int64_t kAskAgainNanos = 1'000'000'000;
constexpr int64_t kRefusedSliceMs = 200;

bool PollIn(std::vector<zmq_pollitem_t> items, int64_t timeout_ms) {
  if (zmq_poll(items.data(), static_cast<int>(items.size()), static_cast<long>(timeout_ms)) < 0) return false;
  return items[0].revents != 0;
}

}  // namespace

struct ZmqSocket::Impl {
  ~Impl() {
    // libzmq leaks the events of a monitor that nobody reads any more.
    if (monitor) zmq_socket_monitor(socket.handle(), nullptr, 0);
    if (!path.empty()) ::unlink(path.c_str());  // while it is ours
  }
  zmq::socket_t socket;
  zmq::socket_t monitor;  // of dealers
  Context::Impl* context = nullptr;
  Sender self;
  ReceiveLimits limits;
  std::string endpoint;
  std::string path;  // of a router's socket in the file system; empty: it has none
  bool router = false;
  bool encrypted = false;
  bool immediate = false;  // a dealer that is writable only while connected
  // The allow-list as of `generation`.
  std::shared_ptr<const AllowList> allowed;
  uint64_t generation = ~uint64_t{0};
  LinkState link = LinkState::kConnecting;
  std::string refusal;
  int silent_handshakes = 0;
  int64_t ask_again = 0;  // steady time, while refused

  struct Part {
    zmq::message_t envelope;
    zmq::message_t attachment;
  };
  // False: nothing there. Frames beyond the second are counted and thrown away as they come.
  bool ReceiveRaw(RawMessage* raw, Part* part);
  void Authenticate(zmq::message_t* frame, RawMessage* raw);
  void DrainMonitor();
  void NoteEvent(uint16_t event, uint32_t value);
  void NoteRefusal(std::string why);
  void AskAgainIfRefused();
};

void ZmqSocket::Impl::Authenticate(zmq::message_t* frame, RawMessage* raw) {
  if (!router || !encrypted) return;
  if (generation != context->zap->generation()) {
    generation = context->zap->generation();
    allowed = context->zap->allowed();
  }
  const char* user = zmq_msg_gets(frame->handle(), "User-Id");
  const AllowList::Entry* entry = user ? allowed->Find(user) : nullptr;
  raw->key_revoked = entry == nullptr;
  if (entry) raw->credentials = {true, entry->role, entry->name, entry->robots};
}

bool ZmqSocket::Impl::ReceiveRaw(RawMessage* raw, Part* part) {
  zmq::message_t frame;
  bool more = true;
  bool first = true;
  for (bool expect_id = router; more; first = false) {
    // A message arrives whole: only its first frame can be missing.
    const int size = zmq_msg_recv(frame.handle(), socket.handle(), ZMQ_DONTWAIT);
    if (size < 0 && (zmq_errno() != EINTR || first)) return false;
    if (size < 0) continue;
    more = frame.more();
    if (expect_id) {
      raw->peer = frame.to_string();
      expect_id = false;
      continue;
    }
    ++raw->frame_count;
    raw->total_bytes += frame.size();
    if (raw->frame_count == 1) {
      Authenticate(&frame, raw);
      part->envelope = std::move(frame);
      raw->envelope = part->envelope.to_string_view();
    } else if (raw->frame_count == 2) {
      part->attachment = std::move(frame);
      raw->attachment = part->attachment.to_string_view();
    }
    frame = zmq::message_t();
  }
  return true;
}

void ZmqSocket::Impl::NoteRefusal(std::string why) {
  link = LinkState::kRefused;
  refusal = std::move(why);
  ask_again = RealClock().SteadyNanos() + kAskAgainNanos;
}

void ZmqSocket::Impl::NoteEvent(uint16_t event, uint32_t value) {
  switch (event) {
    case ZMQ_EVENT_HANDSHAKE_SUCCEEDED:
      link = LinkState::kConnected;
      silent_handshakes = 0;
      return;
    case ZMQ_EVENT_HANDSHAKE_FAILED_AUTH:
      return NoteRefusal("our public key is not on the allow-list there (answer " + std::to_string(value) +
                         ")");
    case ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL:
      return NoteRefusal(encrypted ? "that is no encrypted socket, or the wrong server key was given"
                                   : "that is an encrypted socket and we have no key");
    case ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL:
      if (++silent_handshakes >= kSilentHandshakes && !encrypted)
        NoteRefusal("the connection ends in the handshake: is that an encrypted socket?");
      return;
    case ZMQ_EVENT_DISCONNECTED:
      if (link == LinkState::kConnected) link = LinkState::kConnecting;
      return;
    default:
      return;
  }
}

void ZmqSocket::Impl::AskAgainIfRefused() {
  if (link != LinkState::kRefused || RealClock().SteadyNanos() < ask_again) return;
  ask_again = RealClock().SteadyNanos() + kAskAgainNanos;
  // The old connection may be gone already, which disconnecting reports and we do not mind.
  zmq_disconnect(socket.handle(), endpoint.c_str());
  zmq_connect(socket.handle(), endpoint.c_str());
}

void ZmqSocket::Impl::DrainMonitor() {
  if (!monitor) return;
  zmq::message_t event, address;
  while (zmq_msg_recv(event.handle(), monitor.handle(), ZMQ_DONTWAIT) >= 0) {
    if (event.more() && zmq_msg_recv(address.handle(), monitor.handle(), 0) < 0) return;
    if (event.size() < 6) continue;
    uint16_t kind;
    uint32_t value;
    std::memcpy(&kind, event.data(), 2);
    std::memcpy(&value, event.data<char>() + 2, 4);
    NoteEvent(kind, value);
  }
}

ZmqSocket::ZmqSocket(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ZmqSocket::~ZmqSocket() = default;

const std::string& ZmqSocket::endpoint() const { return impl_->endpoint; }
void* ZmqSocket::handle() { return impl_->socket.handle(); }

LinkState ZmqSocket::link() {
  impl_->DrainMonitor();
  // Being writable means being connected, and is known before the event of it arrives; for inproc
  // there is no event.
  if (impl_->immediate && impl_->link != LinkState::kConnected &&
      (impl_->socket.get(zmq::sockopt::events) & ZMQ_POLLOUT) != 0)
    impl_->link = LinkState::kConnected;
  impl_->AskAgainIfRefused();
  return impl_->link;
}

Status ZmqSocket::LinkError() {
  return link() == LinkState::kRefused ? PermissionDeniedError(impl_->refusal) : Status::Ok();
}

std::string ZmqSocket::LinkHint() {
  if (link() == LinkState::kConnected || impl_->silent_handshakes == 0) return {};
  return "the connection ends in the handshake: is the server's public key the right one, and ours on its "
         "allow-list?";
}

Status ZmqSocket::Send(const Message& message) {
  if (impl_->link != LinkState::kConnected && impl_->monitor) (void)link();
  const size_t envelope_bytes = message.envelope.ByteSizeLong();
  const size_t bytes = envelope_bytes + message.attachment.size();
  RG_RETURN_IF_ERROR(CheckOutgoing(message, bytes, impl_->limits));
  zmq::message_t envelope(envelope_bytes);
  RG_CHECK(message.envelope.SerializeToArray(envelope.data(), static_cast<int>(envelope_bytes)));
  void* socket = impl_->socket.handle();
  const auto refuse = [&](int error) {
    ++metrics_.send_refused;
    const std::string to = impl_->router ? "peer " + message.peer.substr(0, 64) : impl_->endpoint;
    return UnavailableError(to + ": " + (error == EHOSTUNREACH ? "not connected" : zmq_strerror(error)));
  };
  // Only the first frame can meet a full queue or an unknown peer; the rest of a message follows it.
  if (impl_->router &&
      zmq_send(socket, message.peer.data(), message.peer.size(), ZMQ_SNDMORE | ZMQ_DONTWAIT) < 0)
    return refuse(zmq_errno());
  const bool attached = !message.attachment.empty();
  if (zmq_msg_send(envelope.handle(), socket, ZMQ_DONTWAIT | (attached ? ZMQ_SNDMORE : 0)) < 0)
    return refuse(zmq_errno());
  if (attached && zmq_send(socket, message.attachment.data(), message.attachment.size(), ZMQ_DONTWAIT) < 0)
    return refuse(zmq_errno());
  ++metrics_.sent;
  metrics_.sent_bytes += bytes;
  return Status::Ok();
}

bool ZmqSocket::Receive(Message* message) {
  for (int drops = 0; drops < kMaxDropsPerReceive; ++drops) {
    RawMessage raw;
    Impl::Part part;
    if (!impl_->ReceiveRaw(&raw, &part)) return false;
    std::optional<Message> refusal;
    if (FromFrames(raw, impl_->self, impl_->limits, &metrics_, message, &refusal)) return true;
    if (refusal) (void)Send(*refusal);  // to a peer that is gone by now: nothing is lost
  }
  return false;
}

bool ZmqSocket::Wait(int64_t timeout_ms, int wake_fd) {
  std::vector<zmq_pollitem_t> items{{impl_->socket.handle(), 0, ZMQ_POLLIN, 0}};
  if (wake_fd >= 0) items.push_back({nullptr, wake_fd, ZMQ_POLLIN, 0});
  return PollIn(std::move(items), timeout_ms);
}

bool ZmqSocket::WaitWritable(int64_t timeout_ms, int wake_fd) {
  std::vector<zmq_pollitem_t> items{{impl_->socket.handle(), 0, ZMQ_POLLOUT, 0}};
  if (wake_fd >= 0) items.push_back({nullptr, wake_fd, ZMQ_POLLIN, 0});
  const int64_t start = RealClock().SteadyNanos();
  while (true) {
    const int64_t left = timeout_ms < 0 ? -1 : timeout_ms - (RealClock().SteadyNanos() - start) / 1'000'000;
    if (timeout_ms >= 0 && left <= 0) return PollIn(items, 0);
    (void)link();  // asks again where we were refused
    const int64_t slice = left < 0 ? kRefusedSliceMs : std::min(left, kRefusedSliceMs);
    for (auto& item : items) item.revents = 0;
    if (zmq_poll(items.data(), static_cast<int>(items.size()), static_cast<long>(slice)) < 0) return false;
    if (items[0].revents != 0) return true;
    if (wake_fd >= 0 && items[1].revents != 0) return false;
  }
}

// ---- making sockets ----

namespace {

void SetCommonOptions(zmq::socket_t* socket, const std::string& endpoint, const ReceiveLimits& limits,
                      int high_water, int linger_ms) {
  RG_CHECK(high_water > 0);
  socket->set(zmq::sockopt::linger, linger_ms);
  socket->set(zmq::sockopt::sndhwm, high_water);
  socket->set(zmq::sockopt::rcvhwm, high_water);
  // Our own limit is checked on whole messages, counted and answered; this one makes libzmq drop the
  // connection before it allocates for a frame beyond all measure.
  socket->set(zmq::sockopt::maxmsgsize, static_cast<int64_t>(4 * limits.max_message_bytes + 65536));
  socket->set(zmq::sockopt::ipv6, endpoint.find('[') != std::string::npos ? 1 : 0);
  socket->set(zmq::sockopt::tcp_keepalive, 1);
  socket->set(zmq::sockopt::heartbeat_ivl, 2000);
  socket->set(zmq::sockopt::heartbeat_timeout, 6000);
  socket->set(zmq::sockopt::handshake_ivl, 10000);
}

Status FromZmq(const std::string& endpoint, const zmq::error_t& e) {
  const StatusCode code = e.num() == EADDRINUSE                   ? StatusCode::kUnavailable
                          : e.num() == EACCES || e.num() == EPERM ? StatusCode::kPermissionDenied
                          : e.num() == EINVAL || e.num() == ENODEV || e.num() == EADDRNOTAVAIL
                              ? StatusCode::kInvalid
                              : StatusCode::kInternal;
  return Status(code, endpoint + ": " + e.what());
}

void SetServerKey(zmq::socket_t* socket, const KeyPair& key) {
  socket->set(zmq::sockopt::curve_server, 1);
  socket->set(zmq::sockopt::curve_secretkey, key.secret_key);
  socket->set(zmq::sockopt::zap_domain, kZapDomain);
}

}  // namespace

Result<std::unique_ptr<ZmqSocket>> BindRouter(Context& context, const std::string& endpoint,
                                              const RouterOptions& options) {
  RG_RETURN_IF_ERROR(CheckEncryption(endpoint, options.server_key.has_value(), options.allow_plain_loopback));
  RG_RETURN_IF_ERROR(PrepareIpcPath(endpoint));
  if (options.server_key) {
    RG_RETURN_IF_ERROR(CheckKeyText(options.server_key->secret_key).WithPrefix("server key"));
    if (!context.impl().zap)
      return FailedPreconditionError(endpoint +
                                     ": an encrypted socket needs an allow-list (Context::SetAllowList)");
  }
  auto impl = std::make_unique<ZmqSocket::Impl>();
  impl->context = &context.impl();
  impl->self = options.self;
  impl->limits = options.limits;
  impl->router = true;
  impl->encrypted = options.server_key.has_value();
  try {
    impl->socket = zmq::socket_t(context.impl().context, zmq::socket_type::router);
    SetCommonOptions(&impl->socket, endpoint, options.limits, options.high_water_messages, options.linger_ms);
    impl->socket.set(zmq::sockopt::router_mandatory, 1);
    // A peer that comes back before its old connection was found dead takes its own place again.
    impl->socket.set(zmq::sockopt::router_handover, 1);
    if (options.server_key) SetServerKey(&impl->socket, *options.server_key);
    impl->socket.bind(endpoint);
    impl->endpoint = impl->socket.get(zmq::sockopt::last_endpoint);
  } catch (const zmq::error_t& e) {
    return FromZmq(endpoint, e);
  }
  if (impl->endpoint.rfind("ipc://", 0) == 0) {
    impl->path = impl->endpoint.substr(6);
    ::chmod(impl->path.c_str(), 0600);
  }
  return std::make_unique<ZmqSocket>(std::move(impl));
}

Result<std::unique_ptr<ZmqSocket>> ConnectDealer(Context& context, const std::string& endpoint,
                                                 const DealerOptions& options) {
  RG_RETURN_IF_ERROR(CheckEncryption(endpoint, options.key.has_value(), options.allow_plain_loopback));
  if (options.key) {
    RG_RETURN_IF_ERROR(CheckKeyText(options.server_public_key).WithPrefix("server's public key"));
    RG_RETURN_IF_ERROR(CheckKeyText(options.key->public_key).WithPrefix("own public key"));
    RG_RETURN_IF_ERROR(CheckKeyText(options.key->secret_key).WithPrefix("own secret key"));
  }
  if (options.routing_id.size() > 255) return InvalidError("routing id longer than 255 bytes");
  auto impl = std::make_unique<ZmqSocket::Impl>();
  impl->context = &context.impl();
  impl->self = options.self;
  impl->limits = options.limits;
  impl->endpoint = endpoint;
  impl->encrypted = options.key.has_value();
  impl->immediate = !options.queue_while_disconnected;
  try {
    impl->socket = zmq::socket_t(context.impl().context, zmq::socket_type::dealer);
    SetCommonOptions(&impl->socket, endpoint, options.limits, options.high_water_messages, options.linger_ms);
    impl->socket.set(zmq::sockopt::routing_id,
                     options.routing_id.empty() ? RandomHex(8) : options.routing_id);
    impl->socket.set(zmq::sockopt::immediate, options.queue_while_disconnected ? 0 : 1);
    impl->socket.set(zmq::sockopt::handshake_ivl, options.handshake_ms);
    impl->socket.set(zmq::sockopt::reconnect_ivl, 50);
    impl->socket.set(zmq::sockopt::reconnect_ivl_max, 2000);
    if (options.key) {
      impl->socket.set(zmq::sockopt::curve_serverkey, options.server_public_key);
      impl->socket.set(zmq::sockopt::curve_publickey, options.key->public_key);
      impl->socket.set(zmq::sockopt::curve_secretkey, options.key->secret_key);
    }
    const std::string watch = "inproc://monitor-" + RandomHex(8);
    RG_CHECK(zmq_socket_monitor(impl->socket.handle(), watch.c_str(),
                                ZMQ_EVENT_DISCONNECTED | ZMQ_EVENT_HANDSHAKE_SUCCEEDED |
                                    ZMQ_EVENT_HANDSHAKE_FAILED_AUTH | ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL |
                                    ZMQ_EVENT_HANDSHAKE_FAILED_NO_DETAIL) == 0);
    impl->monitor = zmq::socket_t(context.impl().context, zmq::socket_type::pair);
    impl->monitor.set(zmq::sockopt::linger, 0);
    impl->monitor.connect(watch);
    impl->socket.connect(endpoint);
  } catch (const zmq::error_t& e) {
    return FromZmq(endpoint, e);
  }
  return std::make_unique<ZmqSocket>(std::move(impl));
}

// ---- Poller ----

struct Poller::Impl {
  std::vector<zmq_pollitem_t> items;
};

Poller::Poller() : impl_(std::make_unique<Impl>()) {}
Poller::~Poller() = default;

int Poller::Add(ZmqSocket* socket) {
  impl_->items.push_back({socket->handle(), 0, ZMQ_POLLIN, 0});
  return static_cast<int>(impl_->items.size()) - 1;
}

int Poller::AddFd(int fd) {
  impl_->items.push_back({nullptr, fd, ZMQ_POLLIN, 0});
  return static_cast<int>(impl_->items.size()) - 1;
}

const std::vector<int>& Poller::Wait(int64_t timeout_ms) {
  ready_.clear();
  auto& items = impl_->items;
  if (zmq_poll(items.data(), static_cast<int>(items.size()), static_cast<long>(timeout_ms)) <= 0)
    return ready_;
  for (size_t i = 0; i < items.size(); ++i)
    if (items[i].revents != 0) ready_.push_back(static_cast<int>(i));
  return ready_;
}

}  // namespace rg::transport
