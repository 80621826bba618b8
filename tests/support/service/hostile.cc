#include "tests/support/service/hostile.h"

#include <memory>

#include "google/protobuf/descriptor.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "realitygrad/v1/parameters.pb.h"
#include "realitygrad/v1/worker.pb.h"

namespace rg::testing {

namespace pb = realitygrad::v1;

void Fill(google::protobuf::Message* message, Rng& rng, int depth) {
  using Field = google::protobuf::FieldDescriptor;
  const auto* reflection = message->GetReflection();
  const auto number = [&] { return rng.Index(3) == 0 ? rng.Next() : rng.Index(4); };
  // Names that others use too, so that some of it has consequences.
  static const char* const words[] = {"t",    "u",       "echo",     "rollout", "diagnose", "fit", "w", "a",
                                      "last", "robot:x", "realitygrad", "model",   "{}",       ""};
  const auto text = [&] {
    return rng.Index(2) == 0 ? std::string(words[rng.Index(std::size(words))])
                             : std::string(rng.Index(20), static_cast<char>('a' + rng.Index(26)));
  };
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

namespace {

const char* const kRequests[] = {
    "SubmitRequest",         "ListJobsRequest",      "GetJobRequest",           "GetLogsRequest",
    "ListWorkersRequest",    "JobActionRequest",     "DrainWorkerRequest",      "ExplainRequest",
    "ListEventsRequest",     "StatusRequest",        "PutArtifactRequest",      "GetArtifactRequest",
    "ShowArtifactRequest",   "ListArtifactsRequest", "ArtifactLineageRequest",  "PinArtifactRequest",
    "GcArtifactsRequest",    "ListRobotsRequest",    "ParameterHistoryRequest", "ShowParametersRequest",
    "DiffParametersRequest", "ArchiveJobsRequest",   "VerifyArtifactsRequest", "PromoteParametersRequest", "BackupRequest"};

}  // namespace

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

transport::Message HostileMessage(pb::Role role, Rng& rng) {
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

}  // namespace rg::testing
