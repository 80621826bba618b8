// ZeroMQ sockets: a router (the coordinator's end) and dealers (everybody else's).
//
//   Context context;                                     // one per process
//   auto router = BindRouter(context, "tcp://*:7341", {.server_key = keys, ...});
//   Poller poller;
//   poller.Add(router->get()); poller.AddFd(signal_fd);
//   while (poller.Wait(1000)) while (router->Receive(&message)) ...
//
// CURVE is on for every endpoint but ipc:// and inproc://: binding or connecting tcp without keys is
// refused (plain TCP on a loopback address only where `allow_plain_loopback` asks for it).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/transport/keys.h"
#include "common/transport/socket.h"

namespace rg::transport {

// The ZeroMQ context and, once an allow-list is set, the ZAP handler thread that enforces it.
class Context {
 public:
  explicit Context(int io_threads = 1);
  ~Context();  // every socket made from it must be gone
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  // Who may connect to encrypted routers of this context. May be called again at any time, from any
  // thread: a key that is gone is refused at once, also on a connection that stands.
  void SetAllowList(AllowList allowed);
  // Handshakes let in and refused so far.
  struct Handshakes {
    uint64_t accepted = 0;
    uint64_t refused = 0;
  };
  Handshakes handshakes() const;

  struct Impl;
  Impl& impl() { return *impl_; }

 private:
  std::unique_ptr<Impl> impl_;
};

struct RouterOptions {
  Sender self;                        // signs the refusals the socket sends by itself
  std::optional<KeyPair> server_key;  // CURVE on; needs Context::SetAllowList before
  bool allow_plain_loopback = false;
  ReceiveLimits limits;
  int high_water_messages = 10'000;  // per peer and direction; > 0
  int linger_ms = 0;                 // what is not sent when the socket closes is lost after this
};

struct DealerOptions {
  Sender self;
  // Stable over reconnects of one process, new with each start. Empty: random.
  std::string routing_id;
  std::optional<KeyPair> key;     // CURVE on, with
  std::string server_public_key;  // the coordinator's, Z85
  bool allow_plain_loopback = false;
  ReceiveLimits limits;
  int high_water_messages = 10'000;
  int linger_ms = 0;
  // A connection whose handshake gets no answer for so long is made anew: the other end may know our key by
  // then, to which it says nothing before.
  int handshake_ms = 3'000;
  // True: messages wait for a connection. False: Send says kUnavailable while there is none.
  bool queue_while_disconnected = false;
};

// What is known of a dealer's connection. kRefused: that we have no key, in the last answer. A key that the
// other end does not know gets no answer: that looks like a wrong server key, and like nobody there.
enum class LinkState { kConnecting, kConnected, kRefused };

class ZmqSocket : public Socket {
 public:
  ~ZmqSocket() override;
  Status Send(const Message& message) override;
  bool Receive(Message* message) override;
  bool Wait(int64_t timeout_ms, int wake_fd = -1) override;
  bool WaitWritable(int64_t timeout_ms, int wake_fd = -1) override;

  // The endpoint as it was really bound: with the port the system chose for tcp://…:*.
  const std::string& endpoint() const;
  LinkState link();  // dealers only
  Status LinkError() override;
  std::string LinkHint() override;
  // For a Poller: the ZeroMQ socket itself.
  void* handle();

  struct Impl;
  explicit ZmqSocket(std::unique_ptr<Impl> impl);

 private:
  std::unique_ptr<Impl> impl_;
};

// tcp://address:port, tcp://*:port, ipc://path (made with mode 0600), inproc://name.
Result<std::unique_ptr<ZmqSocket>> BindRouter(Context& context, const std::string& endpoint,
                                              const RouterOptions& options);
// Returns at once; the connection is made, and made again, behind the scenes.
Result<std::unique_ptr<ZmqSocket>> ConnectDealer(Context& context, const std::string& endpoint,
                                                 const DealerOptions& options);

// Waits for several sockets and plain file descriptors at once. Sockets must outlive it.
class Poller {
 public:
  int Add(ZmqSocket* socket);  // index, in order of adding
  int AddFd(int fd);
  // Indices that may be read; empty when the time is up or a signal came. timeout_ms < 0: for ever.
  const std::vector<int>& Wait(int64_t timeout_ms);

  Poller();
  ~Poller();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
  std::vector<int> ready_;
};

}  // namespace rg::transport
