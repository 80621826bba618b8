#include "common/transport/fake_transport.h"

#include <algorithm>
#include <limits>
#include <map>
#include <set>

#include "common/transport/frames.h"

namespace rg::transport {
namespace {

constexpr int64_t kNever = std::numeric_limits<int64_t>::max();

struct InFlight {
  Frames frames;
  std::string peer;  // of the sender, as a router sees it
  Credentials credentials;
};

// Messages on their way to one socket, in the order of their arrival.
using Inbox = std::map<std::pair<int64_t, uint64_t>, InFlight>;

}  // namespace

struct FakeNetwork::Impl {
  FakeNetworkOptions options;
  Rng rng{0};
  FakeClock* clock = nullptr;
  std::function<void()> on_idle;
  bool idling = false;
  Stats stats;
  uint64_t sequence = 0;
  std::map<std::string, Inbox> inboxes;         // by address: "name" or "name/peer"
  std::map<std::string, int64_t> last_arrival;  // by channel, for options.reorder == false
  std::set<std::string> cut;                    // peers
  bool gone = false;

  static std::string DealerAddress(const std::string& name, const std::string& peer) {
    return name + "/" + peer;
  }

  int64_t Delay() {
    const double span = static_cast<double>(options.delay_max_ms - options.delay_min_ms);
    return static_cast<int64_t>((static_cast<double>(options.delay_min_ms) + rng.Uniform() * span) * 1e6);
  }

  void Post(const std::string& to, const std::string& channel, const InFlight& message) {
    int64_t due = clock->SteadyNanos() + Delay();
    int64_t& last = last_arrival[channel];
    if (!options.reorder) due = std::max(due, last);
    last = std::max(last, due);
    inboxes[to].emplace(std::pair(due, sequence++), message);
  }

  void Carry(const std::string& to, const std::string& peer, const InFlight& message) {
    ++stats.sent;
    const std::string channel = to + "<-" + message.peer;
    // Always the same number of draws per message, so that one message's fate never shifts another's.
    const bool dropped = rng.Uniform() < options.drop;
    const bool repeated = rng.Uniform() < options.repeat;
    if (dropped || cut.count(peer)) {
      ++stats.dropped;
      return;
    }
    Post(to, channel, message);
    if (!repeated) return;
    ++stats.repeated;
    Post(to, channel, message);
  }

  bool Readable(const std::string& address) const {
    const auto inbox = inboxes.find(address);
    return inbox != inboxes.end() && !inbox->second.empty() &&
           inbox->second.begin()->first.first <= clock->SteadyNanos();
  }

  int64_t NextArrivalAfter(int64_t now) const {
    int64_t next = kNever;
    for (const auto& [address, inbox] : inboxes)
      for (const auto& [key, message] : inbox)
        if (key.first > now) {
          next = std::min(next, key.first);
          break;
        }
    return next;
  }

  void Idle() {
    if (!on_idle || idling) return;
    idling = true;
    on_idle();
    idling = false;
  }

  // Lets the others run and moves the clock until `address` has something to read.
  bool RunUntilReadable(const std::string& address, int64_t timeout_ms) {
    const int64_t deadline = timeout_ms < 0 ? kNever : clock->SteadyNanos() + timeout_ms * 1'000'000;
    while (true) {
      if (Readable(address)) return true;
      Idle();
      if (Readable(address)) return true;
      const int64_t now = clock->SteadyNanos();
      const int64_t next = NextArrivalAfter(now);
      if (now >= deadline || (next == kNever && deadline == kNever)) return false;
      clock->Advance(std::min(next, deadline) - now);
    }
  }
};

namespace {

class FakeSocket final : public Socket {
 public:
  FakeSocket(std::shared_ptr<FakeNetwork::Impl> network, std::string name, std::string peer,
             Credentials credentials, ReceiveLimits limits)
      : network_(std::move(network)),
        name_(std::move(name)),
        peer_(std::move(peer)),
        address_(router() ? name_ : FakeNetwork::Impl::DealerAddress(name_, peer_)),
        credentials_(std::move(credentials)),
        limits_(std::move(limits)) {
    network_->inboxes[address_].clear();
  }
  ~FakeSocket() override { network_->inboxes.erase(address_); }

  Status Send(const Message& message) override {
    RG_ASSIGN_OR_RETURN(Frames frames, ToFrames(message, limits_));
    const std::string to = router() ? FakeNetwork::Impl::DealerAddress(name_, message.peer) : name_;
    if (network_->gone || !network_->inboxes.count(to)) {
      ++metrics_.send_refused;
      return UnavailableError(to + ": not connected");
    }
    ++metrics_.sent;
    metrics_.sent_bytes += frames.size();
    network_->Carry(to, router() ? message.peer : peer_, {std::move(frames), peer_, credentials_});
    return Status::Ok();
  }

  bool Receive(Message* message) override {
    while (network_->Readable(address_)) {
      Inbox& inbox = network_->inboxes[address_];
      const InFlight arrived = std::move(inbox.begin()->second);
      inbox.erase(inbox.begin());
      ++network_->stats.delivered;
      RawMessage raw;
      raw.peer = arrived.peer;
      raw.envelope = arrived.frames.envelope;
      raw.attachment = arrived.frames.attachment;
      raw.frame_count = arrived.frames.attachment.empty() ? 1 : 2;
      raw.total_bytes = arrived.frames.size();
      if (router()) raw.credentials = arrived.credentials;
      std::optional<Message> refusal;
      if (FromFrames(raw, {name_, pb::ROLE_UNSPECIFIED}, limits_, &metrics_, message, &refusal)) return true;
      if (refusal) (void)Send(*refusal);
    }
    return false;
  }

  bool Wait(int64_t timeout_ms, int) override { return network_->RunUntilReadable(address_, timeout_ms); }

  bool WaitWritable(int64_t timeout_ms, int) override {
    if (router() || network_->inboxes.count(name_)) return true;
    (void)network_->RunUntilReadable(address_, std::max<int64_t>(timeout_ms, 0));
    return network_->inboxes.count(name_) > 0;
  }

 private:
  bool router() const { return peer_.empty(); }

  std::shared_ptr<FakeNetwork::Impl> network_;
  std::string name_;
  std::string peer_;  // empty: the router's end
  std::string address_;
  Credentials credentials_;
  ReceiveLimits limits_;
};

}  // namespace

FakeNetwork::FakeNetwork(const FakeNetworkOptions& options, Rng rng, FakeClock* clock)
    : impl_(std::make_shared<Impl>()) {
  impl_->rng = rng;
  impl_->clock = clock;
  set_options(options);
}

FakeNetwork::~FakeNetwork() { impl_->gone = true; }

void FakeNetwork::set_options(const FakeNetworkOptions& options) {
  RG_CHECK(options.delay_max_ms >= options.delay_min_ms && options.delay_min_ms >= 0);
  impl_->options = options;
}

std::unique_ptr<Socket> FakeNetwork::Bind(const std::string& name, const ReceiveLimits& limits) {
  return std::make_unique<FakeSocket>(impl_, name, "", Credentials(), limits);
}

std::unique_ptr<Socket> FakeNetwork::Connect(const std::string& name, const std::string& peer,
                                             const Credentials& credentials, const ReceiveLimits& limits) {
  RG_CHECK(!peer.empty());
  return std::make_unique<FakeSocket>(impl_, name, peer, credentials, limits);
}

void FakeNetwork::Cut(const std::string& peer, bool cut) {
  if (!cut) {
    impl_->cut.erase(peer);
    return;
  }
  impl_->cut.insert(peer);
  for (auto& [address, inbox] : impl_->inboxes) {
    const size_t slash = address.find('/');
    const bool to_peer = slash != std::string::npos && address.substr(slash + 1) == peer;
    for (auto it = inbox.begin(); it != inbox.end();) {
      const bool lost = it->first.first > impl_->clock->SteadyNanos() && (to_peer || it->second.peer == peer);
      if (lost) ++impl_->stats.dropped;
      it = lost ? inbox.erase(it) : std::next(it);
    }
  }
}

void FakeNetwork::OnIdle(std::function<void()> run) { impl_->on_idle = std::move(run); }
int64_t FakeNetwork::NextArrival() const { return impl_->NextArrivalAfter(impl_->clock->SteadyNanos()); }

size_t FakeNetwork::in_flight() const {
  size_t count = 0;
  for (const auto& [address, inbox] : impl_->inboxes) count += inbox.size();
  return count;
}

const FakeNetwork::Stats& FakeNetwork::stats() const { return impl_->stats; }

}  // namespace rg::transport
