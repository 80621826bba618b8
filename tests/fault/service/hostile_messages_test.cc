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
#include "google/protobuf/descriptor.h"
#include "google/protobuf/dynamic_message.h"
#include "realitygrad/v1/worker.pb.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

int Asked() {
  const char* asked = std::getenv("RG_HOSTILE");
  return asked != nullptr ? std::atoi(asked) : 10'000;
}

std::string Mutate(std::string bytes, Rng& rng) {
  for (uint64_t i = rng.Index(6); i > 0 && !bytes.empty(); --i) {
    const size_t at = rng.Index(bytes.size());
    switch (rng.Index(4)) {
      case 0:
        bytes[at] = static_cast<char>(rng.Next());
        break;
      case 1:
        bytes.erase(at, 1 + rng.Index(10));
        break;
      case 2:
        bytes.insert(at, 1 + rng.Index(10), static_cast<char>(rng.Next()));
        break;
      default:
        bytes.resize(at);
    }
  }
  return bytes;
}

// A message of this type with fields that may make sense, or not.
void Fill(google::protobuf::Message* message, Rng& rng, int depth) {
  using Field = google::protobuf::FieldDescriptor;
  const auto* reflection = message->GetReflection();
  const auto number = [&] { return rng.Index(3) == 0 ? rng.Next() : rng.Index(4); };
  const auto text = [&] { return std::string(rng.Index(20), static_cast<char>('a' + rng.Index(26))); };
  for (int f = 0; f < message->GetDescriptor()->field_count(); ++f) {
    const Field* field = message->GetDescriptor()->field(f);
    if (rng.Index(2) == 0) continue;
    const bool many = field->is_repeated();
    switch (field->cpp_type()) {
      case Field::CPPTYPE_INT32:
        many ? reflection->AddInt32(message, field, static_cast<int32_t>(number()))
             : reflection->SetInt32(message, field, static_cast<int32_t>(number()));
        break;
      case Field::CPPTYPE_INT64:
        many ? reflection->AddInt64(message, field, static_cast<int64_t>(number()))
             : reflection->SetInt64(message, field, static_cast<int64_t>(number()));
        break;
      case Field::CPPTYPE_UINT32:
        many ? reflection->AddUInt32(message, field, static_cast<uint32_t>(number()))
             : reflection->SetUInt32(message, field, static_cast<uint32_t>(number()));
        break;
      case Field::CPPTYPE_UINT64:
        many ? reflection->AddUInt64(message, field, number())
             : reflection->SetUInt64(message, field, number());
        break;
      case Field::CPPTYPE_DOUBLE:
        if (!many) reflection->SetDouble(message, field, rng.Uniform() < 0.1 ? 0.0 / 0.0 : rng.Uniform());
        break;
      case Field::CPPTYPE_BOOL:
        if (!many) reflection->SetBool(message, field, rng.Index(2) == 0);
        break;
      case Field::CPPTYPE_ENUM:
        many ? reflection->AddEnumValue(message, field, static_cast<int>(rng.Index(9)))
             : reflection->SetEnumValue(message, field, static_cast<int>(rng.Index(9)));
        break;
      case Field::CPPTYPE_STRING:
        many ? reflection->AddString(message, field, text()) : reflection->SetString(message, field, text());
        break;
      case Field::CPPTYPE_MESSAGE:
        if (depth <= 0 || field->is_map()) break;
        Fill(many ? reflection->AddMessage(message, field) : reflection->MutableMessage(message, field), rng,
             depth - 1);
        break;
      default:
        break;
    }
  }
}

const char* const kRequests[] = {
    "SubmitRequest",         "ListJobsRequest",      "GetJobRequest",           "GetLogsRequest",
    "ListWorkersRequest",    "JobActionRequest",     "DrainWorkerRequest",      "ExplainRequest",
    "ListEventsRequest",     "StatusRequest",        "PutArtifactRequest",      "GetArtifactRequest",
    "ShowArtifactRequest",   "ListArtifactsRequest", "ArtifactLineageRequest",  "PinArtifactRequest",
    "GcArtifactsRequest",    "ListRobotsRequest",    "ParameterHistoryRequest", "ShowParametersRequest",
    "DiffParametersRequest", "ArchiveJobsRequest",   "VerifyArtifactsRequest"};

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

  // As anybody might send it, with this role's claim.
  transport::Message Make(pb::Role role, Rng& rng) {
    transport::Message message;
    auto& envelope = message.envelope;
    envelope.set_protocol_version(1);
    envelope.set_sender_id("h" + std::to_string(rng.Index(50)));
    envelope.set_sender_role(rng.Index(20) == 0 ? static_cast<pb::Role>(rng.Index(7)) : role);
    envelope.set_request_id(std::to_string(rng.Index(1000)));
    envelope.set_fencing_token(rng.Index(5));
    const bool is_event = rng.Index(3) == 0;
    envelope.set_kind(is_event ? pb::MESSAGE_KIND_EVENT : pb::MESSAGE_KIND_REQUEST);
    const std::string type = std::string("realitygrad.v1.") +
                             (is_event ? "WorkerMessage" : kRequests[rng.Index(std::size(kRequests))]);
    const auto* descriptor = google::protobuf::DescriptorPool::generated_pool()->FindMessageTypeByName(type);
    std::unique_ptr<google::protobuf::Message> body(
        google::protobuf::MessageFactory::generated_factory()->GetPrototype(descriptor)->New());
    Fill(body.get(), rng, 3);
    envelope.set_type(rng.Index(30) == 0 ? "realitygrad.v1.Nonsense" : type);
    const std::string bytes = body->SerializePartialAsString();
    envelope.set_payload(rng.Index(3) == 0 ? Mutate(bytes, rng) : bytes);
    if (rng.Index(10) == 0) message.attachment.assign(rng.Index(5000), 'a');
    if (rng.Index(2000) == 0) message.attachment.assign(2 << 20, 'a');  // above the limit
    return message;
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
    if (sent.empty() || rng.Index(5) != 0) sent.push_back(Make(role, rng));
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
