// Messages of hostile or broken peers over real sockets: malformed, oversized, replayed, unauthorised. Each
// is handled, refused or dropped; the coordinator goes on, and nobody gets in.
//
// RG_HOSTILE says how many (the suite `full`: 100,000).
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <deque>
#include <filesystem>
#include <thread>

#include "common/base/ids.h"
#include "common/base/rng.h"
#include "common/transport/zmq_socket.h"
#include "coordinator/client/client.h"
#include "coordinator/core/invariants.h"
#include "coordinator/server/server.h"
#include "tests/support/service/hostile.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

int Asked() {
  const char* asked = std::getenv("RG_HOSTILE");
  return asked != nullptr ? std::atoi(asked) : 10'000;
}

class HostileMessages : public ::testing::Test {
 protected:
  HostileMessages() : folder_("/tmp/rg-hostile-" + RandomHex(6)) {
    std::filesystem::create_directories(folder_);
    for (const auto role : {pb::ROLE_VIEWER, pb::ROLE_WORKER, pb::ROLE_OPERATOR}) {
      keys_[role] = transport::GenerateKeyPair();
      EXPECT_TRUE(allowed_.Add(keys_[role].public_key, role, "k" + std::to_string(role)).ok());
    }
    context_.SetAllowList(allowed_);
    transport::RouterOptions router;
    router.self = {"coordinator", pb::ROLE_COORDINATOR};
    router.server_key = server_key_;
    router.limits.max_message_bytes = 1 << 20;
    auto socket = transport::BindRouter(context_, "tcp://127.0.0.1:*", router);
    RG_CHECK(socket.ok()) << socket.status().ToString();
    endpoint_ = (*socket)->endpoint();
    coordinator::ServerOptions options;
    options.database_path = folder_ + "/service.db";
    auto server = coordinator::Server::Open(options, *std::move(socket), router.self, &RealClock());
    RG_CHECK(server.ok()) << server.status().ToString();
    server_ = *std::move(server);
    thread_ = std::thread([this] {
      while (!stop_.load()) {
        const Status turned = server_->RunOnce(20);
        if (turned.ok()) continue;
        ADD_FAILURE() << turned.ToString();
        return;
      }
    });
  }
  ~HostileMessages() override {
    Stop();
    server_.reset();
    std::filesystem::remove_all(folder_);
  }
  void Stop() {
    stop_.store(true);
    if (thread_.joinable()) thread_.join();
  }
  std::unique_ptr<transport::ZmqSocket> Connect(transport::Context& context, const transport::KeyPair& key) {
    transport::DealerOptions options;
    options.key = key;
    options.server_public_key = server_key_.public_key;
    return *transport::ConnectDealer(context, endpoint_, options);
  }
  std::unique_ptr<coordinator::Client> Operator() {
    coordinator::ClientOptions options;
    options.address = endpoint_;
    options.key = keys_[pb::ROLE_OPERATOR];
    options.server_public_key = server_key_.public_key;
    options.attempt_timeout_ms = 60'000;
    return *coordinator::Client::Connect(options);
  }

  const std::string folder_;
  transport::KeyPair server_key_ = transport::GenerateKeyPair();
  std::map<pb::Role, transport::KeyPair> keys_;
  transport::AllowList allowed_;
  transport::Context context_;
  std::string endpoint_;
  std::unique_ptr<coordinator::Server> server_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

TEST_F(HostileMessages, NoneCrashesBlocksOrEnters) {
  auto client = Operator();
  pb::JobSpec job;
  AddTask(&job, "t", "of-nobody");
  const auto id = client->Submit(job, "mine");
  ASSERT_TRUE(id.ok()) << id.status().ToString();
  transport::Context others;
  std::vector<std::pair<pb::Role, std::unique_ptr<transport::ZmqSocket>>> peers;
  for (const auto role : {pb::ROLE_VIEWER, pb::ROLE_WORKER})
    peers.emplace_back(role, Connect(others, keys_[role]));
  const auto stranger = Connect(others, transport::GenerateKeyPair());
  for (auto& [role, socket] : peers) ASSERT_TRUE(socket->WaitWritable(20'000));
  Rng rng(21);
  std::deque<transport::Message> sent;  // to be replayed
  const int total = Asked();
  uint64_t refused_sends = 0;
  for (int i = 0; i < total; ++i) {
    auto& [role, socket] = peers[rng.Index(peers.size())];
    if (sent.empty() || rng.Index(5) != 0) sent.push_back(HostileMessage(role, rng));
    if (sent.size() > 200) sent.pop_front();
    const transport::Message& message = rng.Index(5) == 0 ? sent[rng.Index(sent.size())] : sent.back();
    if (!socket->Send(message).ok()) ++refused_sends, socket->WaitWritable(1'000);
    (void)stranger->Send(message);
    transport::Message reply;
    while (socket->Receive(&reply)) {
    }
    if (i % 2'500 != 0) continue;
    ASSERT_TRUE(client->CoordinatorStatus().ok()) << "after " << i << " messages";
  }
  const auto status = client->CoordinatorStatus();
  ASSERT_TRUE(status.ok()) << status.status().ToString();
  // Whatever came before it has been handled.
  const auto jobs = client->ListAllJobs();
  ASSERT_TRUE(jobs.ok()) << jobs.status().ToString();
  ASSERT_EQ(jobs->size(), 1u) << "nobody else could submit";
  EXPECT_EQ(jobs->front().id(), *id);
  EXPECT_EQ(jobs->front().state(), pb::JOB_STATE_QUEUED) << "and nobody could touch it";
  EXPECT_EQ(context_.handshakes().accepted, 3u) << "the stranger stayed outside";
  EXPECT_LT(refused_sends, static_cast<uint64_t>(total) / 2);
  Stop();
  EXPECT_TRUE(coordinator::BrokenInvariants(server_->state()).empty());
}

}  // namespace
}  // namespace rg::testing
