// A disk that refuses commits: nobody is told what was not kept, and nothing is lost once it recovers.
#include <gtest/gtest.h>

#include "common/transport/fake_transport.h"
#include "coordinator/core/invariants.h"
#include "coordinator/server/server.h"
#include "realitygrad/v1/worker.pb.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

using transport::MakeEvent;
using transport::MakeRequest;
using transport::Message;
using transport::Unpack;

class Bench {
 public:
  Bench() : network_({}, Rng(1), &clock_) {
    coordinator::ServerOptions options;
    options.database_path = ":memory:";
    auto server =
        coordinator::Server::Open(options, network_.Bind("c"), {"c", pb::ROLE_COORDINATOR}, &clock_);
    EXPECT_TRUE(server.ok()) << server.status().ToString();
    server_ = *std::move(server);
    client_ = network_.Connect("c", "client", Credentials(pb::ROLE_OPERATOR));
    worker_ = network_.Connect("c", "worker", Credentials(pb::ROLE_WORKER));
  }

  static transport::Credentials Credentials(pb::Role role) {
    transport::Credentials credentials;
    credentials.role = role;
    return credentials;
  }

  void Turn() {
    clock_.Advance(10'000'000);
    server_->RunOnce(0);
    const auto broken = coordinator::BrokenInvariants(server_->state());
    EXPECT_TRUE(broken.empty()) << broken.front();
    clock_.Advance(10'000'000);
  }
  void Submit(const std::string& request_id) {
    pb::SubmitRequest request;
    request.set_request_id(request_id);
    AddTask(request.mutable_job(), "t", "echo");
    EXPECT_TRUE(
        client_->Send(MakeRequest(transport::Sender{"client", pb::ROLE_OPERATOR}, request, request_id)).ok());
  }
  void FromWorker(const pb::WorkerMessage& message) {
    EXPECT_TRUE(worker_->Send(MakeEvent(transport::Sender{"w1", pb::ROLE_WORKER}, message)).ok());
  }
  void Hello() {
    pb::WorkerMessage message;
    message.mutable_hello()->set_name("w");
    message.mutable_hello()->set_slots(1);
    message.mutable_hello()->add_kinds("echo");
    FromWorker(message);
  }
  void FailCommits(bool fail) {
    server_->database().set_write_hook([fail](store::WriteKind kind, std::string_view) {
      return fail && kind == store::WriteKind::kCommit ? ResourceExhaustedError("disk full") : Status::Ok();
    });
  }
  std::vector<pb::CoordinatorMessage> WorkerMail() {
    std::vector<pb::CoordinatorMessage> mail;
    Message message;
    while (worker_->Receive(&message)) mail.push_back(*Unpack<pb::CoordinatorMessage>(message));
    return mail;
  }

  FakeClock clock_;
  transport::FakeNetwork network_;
  std::unique_ptr<coordinator::Server> server_;
  std::unique_ptr<transport::Socket> client_, worker_;
};

TEST(CommitFailure, ASubmitThatWasNotKeptIsNotAcknowledged) {
  Bench bench;
  bench.FailCommits(true);
  bench.Submit("r1");
  bench.Turn();
  Message reply;
  EXPECT_FALSE(bench.client_->Receive(&reply));
  EXPECT_TRUE(bench.server_->state().jobs.empty());
  bench.FailCommits(false);
  bench.Submit("r1");  // the client repeats itself
  bench.Turn();
  ASSERT_TRUE(bench.client_->Receive(&reply));
  EXPECT_EQ(Unpack<pb::SubmitReply>(reply)->job(), 1);
}

TEST(CommitFailure, AResultThatWasNotKeptIsAskedForAgain) {
  Bench bench;
  bench.Submit("r1");
  bench.Hello();
  bench.Turn();
  uint64_t token = 0;
  int64_t task = 0;
  for (const auto& mail : bench.WorkerMail()) {
    if (mail.has_assign()) token = mail.assign().token(), task = mail.assign().task();
  }
  ASSERT_NE(token, 0u);
  pb::WorkerMessage finished;
  finished.mutable_finished()->set_token(token);
  finished.mutable_finished()->set_task(task);
  bench.FailCommits(true);
  bench.FromWorker(finished);
  bench.Turn();
  EXPECT_TRUE(bench.WorkerMail().empty());
  bench.FailCommits(false);
  bench.FromWorker(finished);
  bench.Turn();
  bool accepted = false;
  for (const auto& mail : bench.WorkerMail()) accepted = accepted || mail.result_reply().accepted();
  EXPECT_TRUE(accepted);
  EXPECT_EQ(bench.server_->state().jobs.at(1).record.phase, coordinator::JobPhase::kSucceeded);
}

TEST(CommitFailure, NoAssignmentLeavesBeforeItIsKept) {
  Bench bench;
  bench.Hello();
  bench.Turn();
  bench.WorkerMail();
  bench.FailCommits(true);
  bench.Submit("r1");
  bench.Turn();
  EXPECT_TRUE(bench.WorkerMail().empty());
}

}  // namespace
}  // namespace rg::testing
