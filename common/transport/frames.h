// From frames to messages and back, with every check a received message must pass. Shared by the
// real and the fake sockets, so that tests in memory meet the same rules. Internal.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/transport/socket.h"

namespace rg::transport {

// One message as ZeroMQ carries it, without routing id.
struct Frames {
  std::string envelope;
  std::string attachment;
  size_t size() const { return envelope.size() + attachment.size(); }
};

// What came off the wire, before anything is believed.
struct RawMessage {
  std::string peer;
  std::string_view envelope;
  std::string_view attachment;
  size_t frame_count = 0;  // without the routing id
  size_t total_bytes = 0;  // of all frames
  Credentials credentials;
  bool key_revoked = false;  // was let in once, is not on the allow-list now
};

// kInvalid: over the limit.
Status CheckOutgoing(const Message& message, size_t bytes, const ReceiveLimits& limits);
Result<Frames> ToFrames(const Message& message, const ReceiveLimits& limits);

// True: `message` holds a message that may be handled. False: dropped and counted in `metrics`; if
// `refusal` is set, it is to be sent back to the peer.
bool FromFrames(const RawMessage& raw, const Sender& self, const ReceiveLimits& limits,
                SocketMetrics* metrics, Message* message, std::optional<Message>* refusal);

}  // namespace rg::transport
