#include "common/transport/envelope.h"

#include <array>

#include "common/base/clock.h"
#include "common/base/ids.h"

namespace rg::transport {
namespace {

constexpr std::array<std::pair<pb::Role, std::string_view>, 5> kRoleNames{{
    {pb::ROLE_COORDINATOR, "coordinator"},
    {pb::ROLE_WORKER, "worker"},
    {pb::ROLE_AGENT, "agent"},
    {pb::ROLE_OPERATOR, "operator"},
    {pb::ROLE_VIEWER, "viewer"},
}};

}  // namespace

namespace internal {

Message StartMessage(const Sender& sender, pb::MessageKind kind, std::string request_id,
                     const std::string& type) {
  Message message;
  pb::Envelope& envelope = message.envelope;
  envelope.set_protocol_version(kProtocolVersion);
  envelope.set_kind(kind);
  envelope.set_type(type);
  if (request_id.empty() && kind == pb::MESSAGE_KIND_REQUEST) request_id = RandomHex(16);
  envelope.set_request_id(std::move(request_id));
  envelope.set_sender_id(sender.id);
  envelope.set_sender_role(sender.role);
  envelope.set_stamp_ns(RealClock().WallNanos());
  return message;
}

void PackInto(const google::protobuf::Message& body, Message* message) {
  RG_CHECK(body.SerializeToString(message->envelope.mutable_payload())) << message->envelope.type();
}

Status UnpackInto(const Message& message, google::protobuf::Message* body) {
  const std::string& wanted = body->GetDescriptor()->full_name();
  if (message.envelope.type() != wanted)
    return InvalidError("message of type \"" + message.envelope.type().substr(0, 200) + "\" where " + wanted +
                        " was expected");
  if (!body->ParseFromString(message.envelope.payload()))
    return InvalidError(wanted + ": its bytes do not parse");
  return Status::Ok();
}

}  // namespace internal

Message MakeErrorReply(const Sender& sender, const Message& request, const Status& error) {
  Message reply = internal::StartMessage(sender, pb::MESSAGE_KIND_REPLY, request.envelope.request_id(), "");
  reply.peer = request.peer;
  SetError(reply.envelope.mutable_error(), error);
  return reply;
}

Status ReplyStatus(const Message& reply) {
  return reply.envelope.has_error() ? ToStatus(reply.envelope.error()) : Status::Ok();
}

void SetError(pb::ErrorDetail* detail, const Status& status) {
  detail->set_code(static_cast<uint32_t>(status.code()));
  detail->set_message(status.message());
}

Status ToStatus(const pb::ErrorDetail& detail) {
  if (detail.code() == 0) return Status::Ok();
  const bool known = detail.code() <= static_cast<uint32_t>(StatusCode::kInternal);
  return Status(known ? static_cast<StatusCode>(detail.code()) : StatusCode::kInternal, detail.message());
}

Status CheckProtocolVersion(uint32_t peer_version) {
  if (peer_version >= kOldestProtocolVersion && peer_version <= kProtocolVersion) return Status::Ok();
  const bool peer_is_newer = peer_version > kProtocolVersion;
  return FailedPreconditionError("protocol version " + std::to_string(peer_version) +
                                 " meets a program that speaks " + std::to_string(kOldestProtocolVersion) +
                                 " to " + std::to_string(kProtocolVersion) + ": update realitygrad on " +
                                 (peer_is_newer ? "the receiving" : "the sending") + " side");
}

std::string_view RoleName(pb::Role role) {
  for (const auto& [value, name] : kRoleNames)
    if (value == role) return name;
  return "unknown";
}

Result<pb::Role> ParseRole(std::string_view name) {
  for (const auto& [value, known] : kRoleNames)
    if (known == name) return value;
  return InvalidError("role \"" + std::string(name.substr(0, 80)) +
                      "\": must be coordinator, worker, agent, operator or viewer");
}

}  // namespace rg::transport
