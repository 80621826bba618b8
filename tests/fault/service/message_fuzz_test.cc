// Messages of hostile or broken peers of every role against the decoder and all handlers, in this process and
// under a clock that jumps, so that leases expire between them: under sanitizers nothing is found, the server
// goes on, and its promises hold. In batches, each a server of its own under its own seed.
//
// RG_MESSAGES says how many (deploy/fuzz_messages: 10,000,000). With RG_PROGRESS=FILE batches that are done are
// noted there, and a run that was broken off goes on with the next.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <limits>

#include "common/transport/frames.h"
#include "google/protobuf/stubs/logging.h"
#include "tests/support/service/hostile.h"
#include "tests/support/service/server_bench.h"

namespace rg::testing {
namespace {

constexpr uint64_t kPerBatch = 2'000;

uint64_t Asked() {
  const char* asked = std::getenv("RG_MESSAGES");
  return asked != nullptr ? std::strtoull(asked, nullptr, 10) : 20'000;
}

class Batch {
 public:
  explicit Batch(uint64_t seed) : rng_(seed) {
    const std::tuple<const char*, pb::Role, bool> peers[] = {
        {"viewer", pb::ROLE_VIEWER, false}, {"w1", pb::ROLE_WORKER, false},     {"w2", pb::ROLE_WORKER, false},
        {"agent", pb::ROLE_AGENT, true},    {"op", pb::ROLE_OPERATOR, false},   {"chief", pb::ROLE_OPERATOR, true},
        {"any", pb::ROLE_UNSPECIFIED, false}};
    for (const auto& [name, role, robots] : peers) {
      transport::Credentials credentials;
      credentials.authenticated = role != pb::ROLE_UNSPECIFIED;  // on a local socket anybody claims any role
      credentials.role = role;
      if (credentials.authenticated) credentials.name = name;
      credentials.robots = robots;
      peers_.push_back({role, credentials, bench_.network_.Connect("c", name, credentials, kWide)});
    }
  }

  void Run() {
    for (uint64_t sent = 0; sent < kPerBatch && !::testing::Test::HasFailure();) {
      for (uint64_t n = 1 + rng_.Index(16); n > 0; --n, ++sent) SendOne();
      if (rng_.Index(20) == 0) bench_.Pass(5.0 * rng_.Uniform());
      const Status turned = bench_.Turn();  // looks at the promises too
      ASSERT_TRUE(turned.ok()) << turned.ToString();
      for (Peer& peer : peers_) {
        transport::Message reply;
        while (peer.socket->Receive(&reply)) Take(peer, reply);
      }
    }
  }
  uint64_t replies() const { return replies_; }
  uint64_t attempts() const { return bench_.state().counters.attempts_started; }
  uint64_t results() const { return bench_.state().counters.tasks_committed; }
  uint64_t jobs() const { return bench_.state().counters.jobs_submitted; }

 private:
  struct Peer {
    pb::Role role;
    transport::Credentials credentials;
    std::unique_ptr<transport::Socket> socket;
    std::vector<std::pair<int64_t, uint64_t>> held = {};  // tasks and tokens that it was assigned
  };
  static constexpr size_t kMostBytes = 1 << 20;
  static inline const transport::ReceiveLimits kWide{.max_message_bytes = 64u << 20, .known_types = {}};

  void Take(Peer& peer, const transport::Message& reply) {
    ++replies_;
    const auto body = transport::Unpack<pb::CoordinatorMessage>(reply);
    if (body.ok() && body->has_assign()) peer.held.push_back({body->assign().task(), body->assign().token()});
  }
  // Now and then something that gets far: a job that can run, a worker that can run it, and what such a worker
  // says of its leases, with whatever in it.
  transport::Message Sensible(const Peer& peer) {
    const transport::Sender self{"process-" + peer.credentials.name, peer.role};
    if (peer.role == pb::ROLE_OPERATOR) {
      pb::SubmitRequest submit;
      submit.set_request_id(std::to_string(rng_.Next()));
      for (uint64_t n = 1 + rng_.Index(4); n > 0; --n) {
        pb::TaskSpec* task = submit.mutable_job()->add_tasks();
        if (rng_.Index(4) == 0) Fill(task, rng_, 1);
        task->set_name("t" + std::to_string(n));
        task->set_kind(rng_.Index(4) == 0 ? "rollout" : "echo");
      }
      if (rng_.Index(4) == 0) submit.mutable_job()->add_after_jobs(1 + static_cast<int64_t>(rng_.Index(20)));
      if (rng_.Index(4) == 0) submit.mutable_job()->set_time_limit_s(3.0 * rng_.Uniform());
      return transport::MakeRequest(self, submit);
    }
    pb::WorkerMessage message;
    if (peer.held.empty() || rng_.Index(6) == 0) {
      auto* hello = message.mutable_hello();
      hello->set_name("worker-" + peer.credentials.name);
      hello->set_slots(1 + static_cast<uint32_t>(rng_.Index(3)));
      hello->add_kinds(peer.role == pb::ROLE_AGENT ? "rollout" : "echo");
      return transport::MakeEvent(self, message);
    }
    const auto& [task, token] = peer.held[peer.held.size() - 1 - rng_.Index(std::min<size_t>(4, peer.held.size()))];
    switch (rng_.Index(7)) {
      case 0:
        message.mutable_start_request()->set_token(token);
        break;
      case 1:
        Fill(message.mutable_progress(), rng_, 2);
        message.mutable_progress()->set_token(token);
        break;
      case 2:
        Fill(message.mutable_log(), rng_, 2);
        message.mutable_log()->set_token(token);
        break;
      case 3:
        Fill(message.mutable_checkpoint(), rng_, 2);
        message.mutable_checkpoint()->set_token(token);
        break;
      case 4:
        Fill(message.mutable_failed(), rng_, 2);
        message.mutable_failed()->set_token(token);
        break;
      case 5:
        Fill(message.mutable_heartbeat(), rng_, 2);
        message.mutable_heartbeat()->add_held_tokens(token);
        break;
      default:
        if (rng_.Index(2) == 0) Fill(message.mutable_finished(), rng_, 2);
        message.mutable_finished()->set_token(token);
        message.mutable_finished()->set_task(task);
    }
    return transport::MakeEvent(self, message);
  }

  void SendOne() {
    Peer& peer = peers_[rng_.Index(peers_.size())];
    const bool acts = peer.role == pb::ROLE_WORKER || peer.role == pb::ROLE_AGENT || peer.role == pb::ROLE_OPERATOR;
    if (acts && rng_.Index(4) == 0) return (void)peer.socket->Send(Sensible(peer));
    const pb::Role claim =
        peer.role == pb::ROLE_UNSPECIFIED ? static_cast<pb::Role>(rng_.Index(7)) : peer.role;
    const transport::Message message = HostileMessage(claim, rng_);
    if (rng_.Index(4) == 0) DecodeOne(peer, message);
    (void)peer.socket->Send(message);
  }
  // Its bytes on the wire, changed, as they would come off a socket.
  void DecodeOne(const Peer& peer, const transport::Message& message) {
    auto frames = transport::ToFrames(message, kWide);
    if (!frames.ok()) return;
    const std::string envelope = Mutate(std::move(frames->envelope), rng_);
    transport::RawMessage raw;
    raw.peer = "p";
    raw.envelope = envelope;
    raw.attachment = frames->attachment;
    raw.frame_count = rng_.Index(4);
    raw.total_bytes = envelope.size() + frames->attachment.size();
    raw.credentials = peer.credentials;
    raw.key_revoked = rng_.Index(50) == 0;
    transport::SocketMetrics metrics;
    transport::Message out;
    std::optional<transport::Message> refusal;
    const transport::ReceiveLimits limits{.max_message_bytes = kMostBytes, .known_types = {}};
    const bool taken =
        transport::FromFrames(raw, {"c", pb::ROLE_COORDINATOR}, limits, &metrics, &out, &refusal);
    EXPECT_EQ(taken ? 0u : 1u, metrics.dropped());
    EXPECT_FALSE(taken && raw.key_revoked);
    if (taken && peer.credentials.authenticated) {
      EXPECT_EQ(out.credentials.role, peer.role);
    }
  }

  Rng rng_;
  ServerBench bench_;
  std::vector<Peer> peers_;
  uint64_t replies_ = 0;
};

// Found by the test below: the database has no such number, and the coordinator ended, again with every repeat.
TEST(MessageFuzz, AResultThatTookNoNumberOfSecondsIsKept) {
  ServerBench bench;
  const auto client = bench.Connect("client", pb::ROLE_OPERATOR), worker = bench.Connect("w1", pb::ROLE_WORKER);
  client->Submit(OneTask(), "r1");
  worker->Hello({"echo"});
  ASSERT_TRUE(bench.Turn().ok());
  pb::WorkerMessage progress;
  const auto assignment = AssignmentIn(worker->Mail());
  progress.mutable_progress()->set_token(assignment.token());
  progress.mutable_progress()->mutable_progress()->set_done(std::numeric_limits<double>::infinity());
  progress.mutable_progress()->mutable_progress()->set_total(std::numeric_limits<double>::infinity());
  worker->Tell(progress);
  pb::GetJobRequest show;
  show.set_job(1);
  client->Ask(show);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_TRUE(client->Reply<pb::SubmitReply>().ok());
  EXPECT_EQ(client->Reply<pb::GetJobReply>()->job().progress(), 0.0);
  pb::WorkerMessage finished = FinishedMessage(assignment);
  finished.mutable_finished()->set_seconds(std::numeric_limits<double>::quiet_NaN());
  worker->Tell(finished);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_TRUE(worker->Mail().at(0).result_reply().accepted());
}

// Found under sanitizers: the time from which on artefacts stay was beyond all numbers.
TEST(MessageFuzz, NothingIsCollectedForAnAgeBelowZero) {
  ServerBench bench;
  const auto client = bench.Connect("client", pb::ROLE_OPERATOR);
  pb::GcArtifactsRequest collect;
  collect.set_older_than_ns(std::numeric_limits<int64_t>::min());
  client->Ask(collect);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(client->Reply<pb::GcArtifactsReply>().status().code(), StatusCode::kInvalid);
}

TEST(MessageFuzz, DecoderAndHandlersTakeWhateverComes) {
  google::protobuf::SetLogHandler(nullptr);
  const char* progress = std::getenv("RG_PROGRESS");
  uint64_t first = 0;
  if (progress != nullptr) std::ifstream(progress) >> first;
  const uint64_t batches = (Asked() + kPerBatch - 1) / kPerBatch;
  uint64_t replies = 0, attempts = 0, jobs = 0, results = 0;
  for (uint64_t b = first; b < batches; ++b) {
    Batch batch(b + 1);
    batch.Run();
    ASSERT_FALSE(HasFailure()) << "batch " << b;
    replies += batch.replies(), attempts += batch.attempts(), jobs += batch.jobs();
    results += batch.results();
    if (progress != nullptr && b % 10 == 9) std::ofstream(progress, std::ios::trunc) << b + 1 << "\n";
  }
  if (progress != nullptr) std::ofstream(progress, std::ios::trunc) << "0\n";
  std::printf("%llu messages, %llu replies, %llu jobs, %llu attempts, %llu results\n",
              static_cast<unsigned long long>((batches - first) * kPerBatch),
              static_cast<unsigned long long>(replies), static_cast<unsigned long long>(jobs),
              static_cast<unsigned long long>(attempts), static_cast<unsigned long long>(results));
  if (batches - first < 10) return;
  // They must have had consequences.
  EXPECT_GT(jobs, batches - first);
  EXPECT_GT(attempts, 10 * (batches - first));
  EXPECT_GT(results, batches - first);
}

}  // namespace
}  // namespace rg::testing
