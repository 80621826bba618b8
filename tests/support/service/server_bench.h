// A server in this process, under a clock that a test moves, with clients and workers on a network in memory.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <vector>

#include "common/transport/fake_transport.h"
#include "coordinator/core/invariants.h"
#include "coordinator/server/server.h"
#include "realitygrad/v1/worker.pb.h"
#include "tests/support/service/processes.h"

namespace rg::testing {

// One end of a connection, and who speaks there.
class Peer {
 public:
  Peer(transport::FakeNetwork& network, const std::string& id, pb::Role role, const std::string& key = "",
       bool robots = false)
      : self_{id, role} {
    transport::Credentials credentials;
    credentials.authenticated = !key.empty();
    credentials.role = role;
    credentials.name = key;
    credentials.robots = robots;
    socket_ = network.Connect("c", id, credentials);
  }

  void Tell(const pb::WorkerMessage& message) {
    EXPECT_TRUE(socket_->Send(transport::MakeEvent(self_, message)).ok());
  }
  void Hello(const std::vector<std::string>& kinds, const std::string& name = "w",
             const std::vector<std::string>& tags = {}) {
    pb::WorkerMessage message;
    message.mutable_hello()->set_name(name);
    message.mutable_hello()->set_slots(1);
    for (const std::string& kind : kinds) message.mutable_hello()->add_kinds(kind);
    for (const std::string& tag : tags) message.mutable_hello()->add_tags(tag);
    Tell(message);
  }
  void Beat(const std::vector<uint64_t>& held = {}) {
    pb::WorkerMessage message;
    message.mutable_heartbeat()->mutable_held_tokens()->Assign(held.begin(), held.end());
    Tell(message);
  }
  // The request's id tells its reply.
  template <class Body>
  std::string Ask(const Body& body, uint64_t lease = 0) {
    transport::Message message = transport::MakeRequest(self_, body);
    message.envelope.set_fencing_token(lease);
    const std::string id = message.envelope.request_id();
    EXPECT_TRUE(socket_->Send(message).ok());
    return id;
  }
  void Submit(const pb::JobSpec& job, const std::string& request_id, uint64_t lease = 0) {
    pb::SubmitRequest request;
    request.set_request_id(request_id);
    *request.mutable_job() = job;
    Ask(request, lease);
  }
  // What has arrived since the last call.
  std::vector<pb::CoordinatorMessage> Mail() {
    std::vector<pb::CoordinatorMessage> mail;
    transport::Message message;
    while (socket_->Receive(&message)) {
      auto body = transport::Unpack<pb::CoordinatorMessage>(message);
      if (body.ok()) mail.push_back(*std::move(body));
    }
    return mail;
  }
  // The next reply; kUnavailable: there is none.
  template <class Body>
  Result<Body> Reply() {
    transport::Message message;
    while (socket_->Receive(&message)) {
      if (message.envelope.kind() != pb::MESSAGE_KIND_REPLY) continue;
      RG_RETURN_IF_ERROR(transport::ReplyStatus(message));
      return transport::Unpack<Body>(message);
    }
    return UnavailableError("no reply");
  }

 private:
  transport::Sender self_;
  std::unique_ptr<transport::Socket> socket_;
};

class ServerBench {
 public:
  explicit ServerBench(coordinator::ServerOptions options = {}) : network_({}, Rng(1), &clock_) {
    if (options.database_path.empty()) options.database_path = ":memory:";
    auto server =
        coordinator::Server::Open(options, network_.Bind("c"), {"c", pb::ROLE_COORDINATOR}, &clock_);
    EXPECT_TRUE(server.ok()) << server.status().ToString();
    server_ = *std::move(server);
  }

  std::unique_ptr<Peer> Connect(const std::string& id, pb::Role role, const std::string& key = "",
                                bool robots = false) {
    return std::make_unique<Peer>(network_, id, role, key, robots);
  }
  Status Turn() {
    clock_.Advance(10'000'000);
    const Status status = server_->RunOnce(0);
    if (status.ok()) {
      const auto broken = coordinator::BrokenInvariants(server_->state());
      EXPECT_TRUE(broken.empty()) << broken.front();
    }
    clock_.Advance(10'000'000);
    return status;
  }
  void Pass(double seconds) { clock_.Advance(static_cast<int64_t>(1e9 * seconds)); }
  const coordinator::State& state() const { return server_->state(); }

  FakeClock clock_;
  transport::FakeNetwork network_;
  std::unique_ptr<coordinator::Server> server_;
};

inline pb::JobSpec OneTask(const std::string& kind = "echo") {
  pb::JobSpec job;
  AddTask(&job, "t", kind);
  return job;
}

// The assignment among `mail`; token 0: there is none.
inline pb::TaskAssignment AssignmentIn(const std::vector<pb::CoordinatorMessage>& mail) {
  for (const auto& message : mail) {
    if (message.has_assign()) return message.assign();
  }
  return {};
}

inline pb::WorkerMessage FinishedMessage(const pb::TaskAssignment& assignment) {
  pb::WorkerMessage finished;
  finished.mutable_finished()->set_token(assignment.token());
  finished.mutable_finished()->set_task(assignment.task());
  return finished;
}

}  // namespace rg::testing
