#include "common/transport/fake_transport.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <limits>

#include "tests/unit/transport/messages.h"

namespace rg::transport {
namespace {

using testing::ElementsAre;

// What a server hears of 200 messages, with the time of each.
std::vector<std::pair<int64_t, std::string>> Heard(const FakeNetworkOptions& options, uint64_t seed) {
  FakeClock clock;
  FakeNetwork network(options, Rng(seed), &clock);
  auto server = network.Bind("server");
  auto client = network.Connect("server", "client");
  std::vector<std::pair<int64_t, std::string>> heard;
  const auto listen = [&] {
    Message got;
    while (server->Receive(&got)) heard.emplace_back(clock.SteadyNanos(), TextOf(got));
  };
  for (int i = 0; i < 200; ++i) {
    EXPECT_TRUE(client->Send(Ask(std::to_string(i))).ok());
    clock.Advance(1'000'000);
    listen();
  }
  while (server->Wait(1000)) listen();
  EXPECT_EQ(network.in_flight(), 0u);
  EXPECT_EQ(network.stats().sent - network.stats().dropped + network.stats().repeated, heard.size());
  return heard;
}

constexpr FakeNetworkOptions kChaos{.drop = 0.2, .repeat = 0.2, .delay_min_ms = 1, .delay_max_ms = 20};

TEST(FakeTransport, SameSeedSameHistory) {
  EXPECT_EQ(Heard(kChaos, 7), Heard(kChaos, 7));
  EXPECT_NE(Heard(kChaos, 7), Heard(kChaos, 8));
}

TEST(FakeTransport, ChaosLosesRepeatsAndReorders) {
  const auto heard = Heard(kChaos, 3);
  std::vector<int> numbers;
  for (const auto& [time, text] : heard) numbers.push_back(std::stoi(text));
  EXPECT_FALSE(std::is_sorted(numbers.begin(), numbers.end()));
  std::sort(numbers.begin(), numbers.end());
  const size_t distinct = std::unique(numbers.begin(), numbers.end()) - numbers.begin();
  EXPECT_LT(distinct, 185u);
  EXPECT_GT(distinct, 130u);
  EXPECT_GT(heard.size(), distinct);
}

TEST(FakeTransport, WithoutReorderingNothingOvertakes) {
  const auto heard = Heard({.delay_min_ms = 0, .delay_max_ms = 50, .reorder = false}, 5);
  ASSERT_EQ(heard.size(), 200u);
  for (int i = 0; i < 200; ++i) EXPECT_EQ(heard[i].second, std::to_string(i));
}

TEST(FakeTransport, ACutPeerHearsAndSaysNothing) {
  FakeClock clock;
  FakeNetwork network({.delay_min_ms = 10, .delay_max_ms = 10}, Rng(1), &clock);
  auto server = network.Bind("server");
  auto client = network.Connect("server", "client");
  ASSERT_TRUE(client->Send(Ask("on its way")).ok());
  network.Cut("client", true);
  ASSERT_TRUE(client->Send(Ask("lost")).ok());
  EXPECT_FALSE(server->Wait(1000));
  network.Cut("client", false);
  ASSERT_TRUE(client->Send(Ask("back")).ok());
  Message got;
  ASSERT_TRUE(server->Wait(1000));
  ASSERT_TRUE(server->Receive(&got));
  EXPECT_EQ(TextOf(got), "back");
  EXPECT_EQ(got.peer, "client");
}

TEST(FakeTransport, WaitingMovesTheClockOnlyAsFarAsItMust) {
  FakeClock clock;
  const int64_t start = clock.SteadyNanos();
  FakeNetwork network({.delay_min_ms = 30, .delay_max_ms = 30}, Rng(1), &clock);
  auto server = network.Bind("server");
  auto client = network.Connect("server", "client");
  EXPECT_EQ(network.NextArrival(), std::numeric_limits<int64_t>::max());
  ASSERT_TRUE(client->Send(Ask("x")).ok());
  EXPECT_FALSE(server->Wait(20));
  EXPECT_EQ(clock.SteadyNanos(), start + 20'000'000);
  EXPECT_TRUE(server->Wait(-1));
  EXPECT_EQ(clock.SteadyNanos(), start + 30'000'000);
}

TEST(FakeTransport, TheRulesOfReceivingAreThoseOfRealSockets) {
  FakeClock clock;
  FakeNetwork network({}, Rng(1), &clock);
  auto server = network.Bind("server", {.max_message_bytes = 500});
  auto client = network.Connect("server", "client", {true, pb::ROLE_VIEWER, "anna"});
  Message big = Ask("big", {"anna", pb::ROLE_VIEWER});
  big.attachment.assign(1000, 'x');
  ASSERT_TRUE(client->Send(big).ok());
  ASSERT_TRUE(client->Send(Ask("pretender", kWorker)).ok());
  ASSERT_TRUE(client->Send(Ask("honest", {"anna", pb::ROLE_VIEWER})).ok());
  Message got;
  ASSERT_TRUE(server->Receive(&got));
  EXPECT_EQ(TextOf(got), "honest");
  EXPECT_EQ(server->metrics().oversize, 1u);
  EXPECT_EQ(server->metrics().unauthorized, 1u);
  ASSERT_TRUE(client->Receive(&got));
  EXPECT_EQ(ReplyStatus(got).code(), StatusCode::kPermissionDenied);
}

TEST(FakeTransport, SocketsMayOutliveTheNetwork) {
  FakeClock clock;
  auto network = std::make_unique<FakeNetwork>(FakeNetworkOptions{}, Rng(1), &clock);
  auto server = network->Bind("server");
  auto client = network->Connect("server", "client");
  network.reset();
  EXPECT_EQ(client->Send(Ask("x")).code(), StatusCode::kUnavailable);
}

}  // namespace
}  // namespace rg::transport
