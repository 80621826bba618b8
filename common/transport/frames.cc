#include "common/transport/frames.h"

namespace rg::transport {
namespace {

// Only a request is answered: refusing replies or events could go back and forth for ever.
void Refuse(const Message& message, const Sender& self, const Status& why, std::optional<Message>* refusal) {
  if (message.envelope.kind() == pb::MESSAGE_KIND_REQUEST) *refusal = MakeErrorReply(self, message, why);
}

bool Parses(const RawMessage& raw, Message* message) {
  if (raw.frame_count < 1 || raw.frame_count > 2) return false;
  if (!message->envelope.ParseFromArray(raw.envelope.data(), static_cast<int>(raw.envelope.size())))
    return false;
  // Every version sets these, so their absence means bytes of another protocol.
  return message->envelope.protocol_version() != 0 &&
         message->envelope.kind() != pb::MESSAGE_KIND_UNSPECIFIED &&
         pb::MessageKind_IsValid(message->envelope.kind());
}

bool TypeIsKnown(const Message& message, const ReceiveLimits& limits) {
  if (limits.known_types.empty() || message.envelope.has_error()) return true;
  return limits.known_types.count(message.envelope.type()) > 0;
}

Status CheckRole(const RawMessage& raw, const Message& message) {
  if (raw.key_revoked) return PermissionDeniedError("this key is no longer on the allow-list");
  if (!raw.credentials.authenticated || message.envelope.sender_role() == raw.credentials.role)
    return Status::Ok();
  return PermissionDeniedError("the key of \"" + raw.credentials.name + "\" is allowed as " +
                               std::string(RoleName(raw.credentials.role)) + ", not as " +
                               std::string(RoleName(message.envelope.sender_role())));
}

}  // namespace

Status CheckOutgoing(const Message& message, size_t bytes, const ReceiveLimits& limits) {
  if (bytes <= limits.max_message_bytes) return Status::Ok();
  return InvalidError("message " + message.envelope.type() + " of " + std::to_string(bytes) +
                      " bytes: the limit is " + std::to_string(limits.max_message_bytes));
}

Result<Frames> ToFrames(const Message& message, const ReceiveLimits& limits) {
  Frames frames;
  RG_CHECK(message.envelope.SerializeToString(&frames.envelope));
  frames.attachment = message.attachment;
  RG_RETURN_IF_ERROR(CheckOutgoing(message, frames.size(), limits));
  return frames;
}

bool FromFrames(const RawMessage& raw, const Sender& self, const ReceiveLimits& limits,
                SocketMetrics* metrics, Message* message, std::optional<Message>* refusal) {
  if (raw.total_bytes > limits.max_message_bytes) {
    ++metrics->oversize;
    return false;
  }
  *message = Message();
  message->peer = raw.peer;
  if (!Parses(raw, message)) {
    ++metrics->malformed;
    return false;
  }
  const Status version = CheckProtocolVersion(message->envelope.protocol_version());
  // A refusal from a newer or older peer still says why.
  if (!version.ok() && !message->envelope.has_error()) {
    ++metrics->wrong_version;
    Refuse(*message, self, version, refusal);
    return false;
  }
  if (const Status role = CheckRole(raw, *message); !role.ok()) {
    ++metrics->unauthorized;
    Refuse(*message, self, role, refusal);
    return false;
  }
  if (!TypeIsKnown(*message, limits)) {
    ++metrics->unknown_type;
    Refuse(*message, self,
           InvalidError("message type \"" + message->envelope.type().substr(0, 200) + "\" is not known here"),
           refusal);
    return false;
  }
  message->attachment.assign(raw.attachment);
  message->credentials = raw.credentials;
  if (!raw.credentials.authenticated) message->credentials.role = message->envelope.sender_role();
  ++metrics->received;
  metrics->received_bytes += raw.total_bytes;
  return true;
}

}  // namespace rg::transport
