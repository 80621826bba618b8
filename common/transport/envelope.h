// A message between two processes, and the version of the protocol it is written in.
//
// On the wire: [Envelope] or [Envelope][attachment], one ZeroMQ message of one or two frames.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "common/base/status.h"
#include "realitygrad/v1/envelope.pb.h"

namespace rg::transport {

namespace pb = ::realitygrad::v1;

// Raised when an older peer would misread a message; frozen meaning of each number:
//   1  first release
inline constexpr uint32_t kProtocolVersion = 1;
inline constexpr uint32_t kOldestProtocolVersion = 1;  // that this program still speaks

// Who really sent a message, as far as the socket knows.
struct Credentials {
  // The peer's key is on the allow-list (CURVE). False on local sockets, where `role` is the claim.
  bool authenticated = false;
  pb::Role role = pb::ROLE_UNSPECIFIED;
  std::string name;     // of the key on the allow-list; empty on local sockets
  bool robots = false;  // the key may have robots moved
  bool may_move_robots() const { return robots || !authenticated; }
};

struct Message {
  // Routing id of the other end. Set by a router on receipt, read by a router on sending; never a
  // proof of who somebody is.
  std::string peer;
  pb::Envelope envelope;
  std::string attachment;
  Credentials credentials;  // of a received message
};

// Who this process says it is, in every envelope.
struct Sender {
  std::string id;  // unique per start, e.g. "worker-host7-3f2a91"
  pb::Role role = pb::ROLE_UNSPECIFIED;
};

// A message of `kind` whose payload is `body` (any Protobuf message). The request id is 16 random
// bytes for requests; give one to repeat a request.
template <class Body>
Message MakeMessage(const Sender& sender, pb::MessageKind kind, const Body& body,
                    std::string request_id = {});
template <class Body>
Message MakeRequest(const Sender& sender, const Body& body, std::string request_id = {}) {
  return MakeMessage(sender, pb::MESSAGE_KIND_REQUEST, body, std::move(request_id));
}
template <class Body>
Message MakeEvent(const Sender& sender, const Body& body) {
  return MakeMessage(sender, pb::MESSAGE_KIND_EVENT, body);
}
// A reply to `request`: same peer, same request id.
template <class Body>
Message MakeReply(const Sender& sender, const Message& request, const Body& body);
Message MakeErrorReply(const Sender& sender, const Message& request, const Status& error);

// The payload as a Body. kInvalid if the envelope carries another type or the bytes do not parse.
template <class Body>
Result<Body> Unpack(const Message& message);
template <class Body>
bool Is(const Message& message) {
  return message.envelope.type() == Body::descriptor()->full_name();
}

// The outcome a reply carries.
Status ReplyStatus(const Message& reply);
void SetError(pb::ErrorDetail* detail, const Status& status);
Status ToStatus(const pb::ErrorDetail& detail);

// Ok, or kFailedPrecondition with both versions and what to do.
Status CheckProtocolVersion(uint32_t peer_version);

// "worker", "agent", "operator", "viewer", "coordinator".
std::string_view RoleName(pb::Role role);
Result<pb::Role> ParseRole(std::string_view name);

// ---- details ----

namespace internal {
Message StartMessage(const Sender& sender, pb::MessageKind kind, std::string request_id,
                     const std::string& type);
Status UnpackInto(const Message& message, google::protobuf::Message* body);
void PackInto(const google::protobuf::Message& body, Message* message);
}  // namespace internal

template <class Body>
Message MakeMessage(const Sender& sender, pb::MessageKind kind, const Body& body, std::string request_id) {
  Message message =
      internal::StartMessage(sender, kind, std::move(request_id), Body::descriptor()->full_name());
  internal::PackInto(body, &message);
  return message;
}

template <class Body>
Message MakeReply(const Sender& sender, const Message& request, const Body& body) {
  Message reply = MakeMessage(sender, pb::MESSAGE_KIND_REPLY, body, request.envelope.request_id());
  reply.peer = request.peer;
  return reply;
}

template <class Body>
Result<Body> Unpack(const Message& message) {
  Body body;
  RG_RETURN_IF_ERROR(internal::UnpackInto(message, &body));
  return body;
}

}  // namespace rg::transport
