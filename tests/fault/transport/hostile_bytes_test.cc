// Bytes from a hostile or broken peer: every message is handled, or dropped and counted; nothing else.
#include <gmock/gmock.h>

#include "common/base/rng.h"
#include "common/transport/frames.h"
#include "common/transport/zmq_socket.h"
#include "tests/unit/transport/messages.h"

namespace rg::transport {
namespace {

std::string Mutate(std::string bytes, Rng* rng) {
  const uint64_t changes = rng->Index(8);
  for (uint64_t i = 0; i < changes && !bytes.empty(); ++i) {
    const size_t at = rng->Index(bytes.size());
    switch (rng->Index(4)) {
      case 0:
        bytes[at] = static_cast<char>(rng->Next());
        break;
      case 1:
        bytes.erase(at, 1 + rng->Index(10));
        break;
      case 2:
        bytes.insert(at, 1 + rng->Index(10), static_cast<char>(rng->Next()));
        break;
      default:
        bytes.resize(at);
    }
  }
  return bytes;
}

TEST(HostileBytes, EveryMessageIsHandledOrCountedOnce) {
  const Context context;  // as in a program: Protobuf keeps quiet about bad bytes
  Rng rng(5);
  SocketMetrics metrics;
  const ReceiveLimits limits{.max_message_bytes = 400,
                             .known_types = {TestRequest::descriptor()->full_name()}};
  const uint64_t total = 200'000;
  uint64_t handled = 0, answered = 0;
  for (uint64_t i = 0; i < total; ++i) {
    const std::string bytes =
        Mutate(Ask(std::string(rng.Index(100), 'q')).envelope.SerializeAsString(), &rng);
    const std::string attachment(rng.Index(300), 'a');
    RawMessage raw;
    raw.peer = "peer";
    raw.envelope = bytes;
    raw.attachment = attachment;
    raw.frame_count = 1 + rng.Index(3);
    raw.total_bytes = bytes.size() + attachment.size();
    raw.credentials = {rng.Uniform() < 0.5, pb::ROLE_WORKER, "host7"};
    raw.key_revoked = rng.Uniform() < 0.1;
    Message message;
    std::optional<Message> refusal;
    const bool ok = FromFrames(raw, kServer, limits, &metrics, &message, &refusal);
    handled += ok;
    if (ok) {
      (void)Unpack<TestRequest>(message);
      EXPECT_FALSE(refusal.has_value());
    }
    if (refusal) {
      ++answered;
      EXPECT_FALSE(ReplyStatus(*refusal).ok());
      EXPECT_LT(refusal->envelope.ByteSizeLong(), 4000u) << "a refusal never grows with what was sent";
    }
  }
  EXPECT_EQ(handled, metrics.received);
  EXPECT_EQ(handled + metrics.dropped(), total);
  EXPECT_GT(handled, total / 20);
  EXPECT_GT(answered, 1000u);
  for (const uint64_t count : {metrics.oversize, metrics.malformed, metrics.wrong_version,
                               metrics.unknown_type, metrics.unauthorized})
    EXPECT_GT(count, 100u);
}

TEST(HostileBytes, RefusalsAreNeverRefused) {
  // Two peers of different versions must not answer each other for ever.
  Message refusal = MakeErrorReply(kServer, Ask("x"), InvalidError("no"));
  refusal.envelope.set_protocol_version(99);
  const std::string bytes = refusal.envelope.SerializeAsString();
  RawMessage raw;
  raw.envelope = bytes;
  raw.frame_count = 1;
  raw.total_bytes = bytes.size();
  SocketMetrics metrics;
  Message message;
  std::optional<Message> answer;
  EXPECT_TRUE(FromFrames(raw, kServer, {}, &metrics, &message, &answer))
      << "an error of any version is readable";
  EXPECT_FALSE(answer.has_value());
}

}  // namespace
}  // namespace rg::transport
