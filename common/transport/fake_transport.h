// A network in memory for tests: drops, repeats, delays and reorders messages from a seed, under a
// FakeClock. Same seed and same calls, same history. Single-threaded.
//
//   FakeClock clock;
//   FakeNetwork network({.drop = 0.1, .repeat = 0.1, .delay_max_ms = 50}, Rng(7), &clock);
//   auto server = network.Bind("coordinator");
//   auto worker = network.Connect("coordinator", "worker-1");
//   worker->Send(...); clock.Advance(...); server->Receive(&message);
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "common/base/clock.h"
#include "common/base/rng.h"
#include "common/transport/socket.h"

namespace rg::transport {

struct FakeNetworkOptions {
  double drop = 0.0;         // probability per message
  double repeat = 0.0;       // probability that it arrives twice
  int64_t delay_min_ms = 0;  // each copy is delayed on its own, uniformly;
  int64_t delay_max_ms = 0;  // with reorder = false a later message never overtakes
  bool reorder = true;
};

class FakeNetwork {
 public:
  FakeNetwork(const FakeNetworkOptions& options, Rng rng, FakeClock* clock);
  ~FakeNetwork();  // sockets may outlive it: they are then cut off

  std::unique_ptr<Socket> Bind(const std::string& name, const ReceiveLimits& limits = {});
  // `peer` is the routing id the router sees. `credentials` as if CURVE had bound them.
  std::unique_ptr<Socket> Connect(const std::string& name, const std::string& peer,
                                  const Credentials& credentials = {}, const ReceiveLimits& limits = {});

  void set_options(const FakeNetworkOptions& options);
  // Nothing passes between `name` and `peer` while cut; what was on its way is lost.
  void Cut(const std::string& peer, bool cut);
  // Runs whenever a Wait is about to move the clock: lets the other processes of a test answer.
  void OnIdle(std::function<void()> run);
  // Steady time at which the next message arrives; INT64_MAX: none is on its way.
  int64_t NextArrival() const;
  size_t in_flight() const;

  struct Stats {
    uint64_t sent = 0;
    uint64_t delivered = 0;
    uint64_t dropped = 0;
    uint64_t repeated = 0;
  };
  const Stats& stats() const;

  struct Impl;

 private:
  std::shared_ptr<Impl> impl_;
};

}  // namespace rg::transport
