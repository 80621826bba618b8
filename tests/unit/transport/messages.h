// Small messages for tests.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <string>
#include <thread>

#include "common/base/ids.h"
#include "common/transport/envelope.h"
#include "common/transport/socket.h"
#include "realitygrad/v1/artifact.pb.h"

namespace rg::transport {

using TestRequest = pb::ShowArtifactRequest;
using TestReply = pb::ShowArtifactReply;

inline const Sender kServer{"coordinator-1", pb::ROLE_COORDINATOR};
inline const Sender kWorker{"worker-1", pb::ROLE_WORKER};

inline Message Ask(const std::string& text, const Sender& sender = kWorker) {
  TestRequest request;
  request.set_sha256(text);
  return MakeRequest(sender, request);
}

inline std::string TextOf(const Message& message) {
  const auto body = Unpack<TestRequest>(message);
  return body.ok() ? body->sha256() : "(" + body.status().ToString() + ")";
}

inline Message Answer(const Message& request, const std::string& text) {
  TestReply reply;
  reply.mutable_info()->set_sha256(text);
  return MakeReply(kServer, request, reply);
}

// Waits (real time) until a message is there; false after five seconds.
inline bool ReceiveWithin(Socket* socket, Message* message, int64_t timeout_ms = 5000) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::milliseconds(timeout_ms);
  while (std::chrono::steady_clock::now() < deadline) {
    if (socket->Receive(message)) return true;
    socket->Wait(50);
  }
  return false;
}

inline bool Eventually(const std::function<bool()>& condition) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(5);
  while (std::chrono::steady_clock::now() < deadline) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return false;
}

}  // namespace rg::transport
