// Peers that are killed, stopped, or come in crowds.
#include <gmock/gmock.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>

#include "common/transport/request_client.h"
#include "common/transport/zmq_socket.h"
#include "tests/unit/transport/messages.h"

namespace rg::transport {
namespace {

class PeerDeath : public testing::Test {
 protected:
  ~PeerDeath() override { std::filesystem::remove_all(folder_); }
  // `run` in a process of its own; sockets must be made there, never inherited.
  template <class Fn>
  pid_t Spawn(Fn run) {
    const pid_t child = ::fork();
    if (child == 0) {
      ::alarm(30);
      run();
      ::_exit(0);
    }
    return child;
  }
  static void Kill(pid_t child) {
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
  }
  std::string folder_ = "/tmp/rg_peer_" + RandomHex(6);
  std::string endpoint_ = "ipc://" + folder_ + "/socket";
};

TEST_F(PeerDeath, AKilledPeerLeavesWholeMessagesAndFallsSilent) {
  const pid_t child = Spawn([&] {
    Context context;
    auto dealer = ConnectDealer(context, endpoint_, {.self = kWorker, .routing_id = "w1"});
    if (!(*dealer)->WaitWritable(10'000)) return;
    for (int i = 0;; ++i) {
      Message message = Ask(std::to_string(i));
      message.attachment.assign(100'000, static_cast<char>(i));
      if (!(*dealer)->Send(message).ok()) ::usleep(100);
    }
  });
  Context context;
  auto router = BindRouter(context, endpoint_, {.self = kServer, .high_water_messages = 10});
  ASSERT_TRUE(router.ok()) << router.status().ToString();
  Message got;
  int received = 0;
  while (received < 50 && ReceiveWithin(router->get(), &got)) {
    ++received;
    ASSERT_EQ(got.attachment, std::string(100'000, static_cast<char>(std::stoi(TextOf(got)))));
  }
  ASSERT_EQ(received, 50);
  Kill(child);
  while (ReceiveWithin(router->get(), &got, 200)) EXPECT_EQ(got.peer, "w1");
  EXPECT_EQ((*router)->metrics().malformed, 0u) << "half a message never arrives";
  Message farewell = Answer(Ask("x"), "y");
  farewell.peer = "w1";
  EXPECT_TRUE(Eventually([&] { return (*router)->Send(farewell).code() == StatusCode::kUnavailable; }));
}

TEST_F(PeerDeath, AStoppedServerIsUnavailableAndItsLateAnswersAreKnownAsLate) {
  const pid_t server = Spawn([&] {
    Context context;
    auto router = BindRouter(context, endpoint_, {.self = kServer});
    Message got;
    while (true) {
      (*router)->Wait(1000);
      while ((*router)->Receive(&got)) (void)(*router)->Send(Answer(got, TextOf(got)));
    }
  });
  Context context;
  auto dealer = ConnectDealer(context, endpoint_, {.self = kWorker});
  RequestClient client(std::move(*dealer), kWorker, "coordinator", RealClock(),
                       {.attempt_timeout_ms = 300, .attempts = 2});
  ASSERT_TRUE(client.Call(Ask("first")).ok());
  ASSERT_EQ(::kill(server, SIGSTOP), 0);
  EXPECT_EQ(client.Call(Ask("second")).status().code(), StatusCode::kUnavailable);
  ASSERT_EQ(::kill(server, SIGCONT), 0);
  const auto third = client.Call(Ask("third"));
  ASSERT_TRUE(third.ok()) << third.status().ToString();
  EXPECT_EQ(Unpack<TestReply>(*third)->info().sha256(), "third");
  EXPECT_EQ(client.late_replies(), 2u) << "both repeats of the second request were answered";
  Kill(server);
}

TEST_F(PeerDeath, AServerKilledAndStartedAgainAnswersTheRequestUnderWay) {
  const auto serve = [&](bool answer) {
    Context context;
    auto router = BindRouter(context, endpoint_, {.self = kServer});
    Message got;
    while (router.ok()) {
      (*router)->Wait(1000);
      while ((*router)->Receive(&got)) {
        if (!answer) ::raise(SIGKILL);  // dies with the request in its hands
        (void)(*router)->Send(Answer(got, TextOf(got)));
      }
    }
  };
  const pid_t first = Spawn([&] { serve(false); });
  std::atomic<pid_t> second{0};
  std::thread restarter([&] {
    ::waitpid(first, nullptr, 0);
    second = Spawn([&] { serve(true); });
  });
  Context context;
  auto dealer = ConnectDealer(context, endpoint_, {.self = kWorker});
  RequestClient client(std::move(*dealer), kWorker, "coordinator", RealClock(),
                       {.attempt_timeout_ms = 500, .attempts = 20});
  const auto reply = client.Call(Ask("x"));
  EXPECT_TRUE(reply.ok()) << reply.status().ToString();
  EXPECT_GE(client.repeats(), 1u);
  restarter.join();
  Kill(second);
}

TEST_F(PeerDeath, ACrowdOfEncryptedClientsIsServedAndStrangersAreNot) {
  constexpr int kClients = 12, kStrangers = 4, kCalls = 20;
  Context server_context, client_context(2);
  const KeyPair server_key = GenerateKeyPair();
  std::vector<KeyPair> keys;
  AllowList allowed;
  for (int i = 0; i < kClients + kStrangers; ++i) {
    keys.push_back(GenerateKeyPair());
    if (i < kClients) {
      ASSERT_TRUE(allowed.Add(keys[i].public_key, pb::ROLE_WORKER, "w" + std::to_string(i)).ok());
    }
  }
  server_context.SetAllowList(allowed);
  auto router = BindRouter(server_context, "tcp://127.0.0.1:*", {.self = kServer, .server_key = server_key});
  ASSERT_TRUE(router.ok());
  const std::string endpoint = (*router)->endpoint();
  std::atomic<int> served{0}, unanswered{0}, running{kClients + kStrangers};
  std::vector<std::thread> threads;
  for (int i = 0; i < kClients + kStrangers; ++i) {
    threads.emplace_back([&, i] {
      auto dealer =
          ConnectDealer(client_context, endpoint,
                        {.self = kWorker, .key = keys[i], .server_public_key = server_key.public_key});
      // A stranger is told nothing, not even that it is one: it sees a time-out.
      const bool stranger = i >= kClients;
      RequestOptions options;
      if (stranger) options = {.attempt_timeout_ms = 300, .attempts = 2};
      RequestClient client(std::move(*dealer), kWorker, "coordinator", RealClock(), options);
      for (int k = 0; k < (stranger ? 1 : kCalls); ++k) {
        const auto reply = client.Call(Ask(std::to_string(i)));
        served += reply.ok() && Unpack<TestReply>(*reply)->info().sha256() == "w" + std::to_string(i);
        unanswered += stranger && (reply.status().code() == StatusCode::kDeadlineExceeded ||
                                   reply.status().code() == StatusCode::kUnavailable);
      }
      --running;
    });
  }
  Message got;
  while (running > 0) {
    (*router)->Wait(20);
    while ((*router)->Receive(&got)) (void)(*router)->Send(Answer(got, got.credentials.name));
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(served, kClients * kCalls) << "each under the name of its key";
  EXPECT_EQ(unanswered, kStrangers);
}

}  // namespace
}  // namespace rg::transport
