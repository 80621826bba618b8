#include "common/transport/zmq_socket.h"

#include <gmock/gmock.h>
#include <sys/stat.h>

#include <filesystem>
#include <zmq.hpp>

#include "tests/unit/transport/messages.h"

namespace rg::transport {
namespace {

using testing::HasSubstr;

std::string TempIpc() { return "ipc:///tmp/rg_transport_" + RandomHex(6) + "/socket"; }

struct Pair {
  explicit Pair(const std::string& endpoint = TempIpc(), RouterOptions router_options = {},
                DealerOptions options = {}) {
    router_options.self = kServer;
    options.self = kWorker;
    auto bound = BindRouter(context, endpoint, router_options);
    EXPECT_TRUE(bound.ok()) << bound.status().ToString();
    router = std::move(*bound);
    auto connected = ConnectDealer(context, router->endpoint(), options);
    EXPECT_TRUE(connected.ok()) << connected.status().ToString();
    dealer = std::move(*connected);
    EXPECT_TRUE(dealer->WaitWritable(5000));
  }
  ~Pair() {
    if (router && router->endpoint().rfind("ipc://", 0) == 0)
      std::filesystem::remove_all(std::filesystem::path(router->endpoint().substr(6)).parent_path());
  }
  Context context;
  std::unique_ptr<ZmqSocket> router, dealer;
};

TEST(ZmqSocket, RequestAndReplyCarryEnvelopeAndAttachment) {
  for (const std::string& endpoint :
       {TempIpc(), std::string("tcp://127.0.0.1:*"), std::string("inproc://pair")}) {
    Pair pair(endpoint, {.allow_plain_loopback = true}, {.allow_plain_loopback = true});
    Message request = Ask("hello");
    request.attachment = std::string("\0\1\2", 3) + std::string(100000, 'x');
    request.envelope.set_fencing_token(42);
    ASSERT_TRUE(pair.dealer->Send(request).ok());
    Message got;
    ASSERT_TRUE(ReceiveWithin(pair.router.get(), &got)) << endpoint;
    EXPECT_EQ(TextOf(got), "hello");
    EXPECT_EQ(got.attachment, request.attachment);
    EXPECT_EQ(got.envelope.fencing_token(), 42u);
    EXPECT_EQ(got.envelope.sender_id(), "worker-1");
    EXPECT_EQ(got.envelope.protocol_version(), kProtocolVersion);
    EXPECT_FALSE(got.credentials.authenticated);
    EXPECT_EQ(got.credentials.role, pb::ROLE_WORKER) << "the claim, on a plain local socket";

    ASSERT_TRUE(pair.router->Send(Answer(got, "there")).ok());
    Message reply;
    ASSERT_TRUE(ReceiveWithin(pair.dealer.get(), &reply));
    EXPECT_EQ(reply.envelope.request_id(), request.envelope.request_id());
    EXPECT_EQ(Unpack<TestReply>(reply)->info().sha256(), "there");
    EXPECT_EQ(pair.dealer->link(), LinkState::kConnected);
    EXPECT_EQ(pair.router->metrics().dropped(), 0u);
  }
}

TEST(ZmqSocket, PublicOrPlainTcpIsRefusedWithoutKeys) {
  Context context;
  for (const char* endpoint :
       {"tcp://*:*", "tcp://0.0.0.0:7341", "tcp://[::]:7341", "tcp://10.1.2.3:7341", "tcp://eth0:7341"}) {
    const auto bound = BindRouter(context, endpoint, {.allow_plain_loopback = true});
    ASSERT_FALSE(bound.ok()) << endpoint;
    EXPECT_EQ(bound.status().code(), StatusCode::kFailedPrecondition) << endpoint;
    EXPECT_THAT(bound.status().message(), HasSubstr("needs keys"));
  }
  EXPECT_FALSE(BindRouter(context, "tcp://127.0.0.1:*", {}).ok()) << "plain loopback must be asked for";
  EXPECT_FALSE(ConnectDealer(context, "tcp://10.1.2.3:7341", {}).ok());
  EXPECT_EQ(BindRouter(context, "udp://127.0.0.1:1", {}).status().code(), StatusCode::kInvalid);
  EXPECT_EQ(BindRouter(context, "tcp://nonsense", {}).status().code(), StatusCode::kInvalid);
  EXPECT_TRUE(BindRouter(context, "tcp://127.0.0.1:*", {.allow_plain_loopback = true}).ok());
}

TEST(ZmqSocket, LocalSocketFileIsPrivateAndNotTakenOver) {
  Pair pair;
  struct stat info {};
  ASSERT_EQ(::stat(pair.router->endpoint().c_str() + 6, &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600u);
  const auto second = BindRouter(pair.context, pair.router->endpoint(), {});
  ASSERT_FALSE(second.ok());
  EXPECT_EQ(second.status().code(), StatusCode::kUnavailable);
  EXPECT_EQ(BindRouter(pair.context, "ipc:///tmp/" + std::string(200, 'x'), {}).status().code(),
            StatusCode::kInvalid);
}

TEST(ZmqSocket, SendingTooMuchIsRefusedBeforeItLeaves) {
  Pair pair(TempIpc(), {}, {.limits = {.max_message_bytes = 1000}});
  Message big = Ask("x");
  big.attachment.assign(1000, 'x');
  const Status sent = pair.dealer->Send(big);
  EXPECT_EQ(sent.code(), StatusCode::kInvalid);
  EXPECT_THAT(sent.message(), HasSubstr("limit is 1000"));
}

TEST(ZmqSocket, OversizeMessagesAreDroppedAndCounted) {
  Pair pair(TempIpc(), {.limits = {.max_message_bytes = 1000}});
  Message big = Ask("big");
  big.attachment.assign(2000, 'x');
  ASSERT_TRUE(pair.dealer->Send(big).ok());
  ASSERT_TRUE(pair.dealer->Send(Ask("small")).ok());
  Message got;
  ASSERT_TRUE(ReceiveWithin(pair.router.get(), &got));
  EXPECT_EQ(TextOf(got), "small");
  EXPECT_EQ(pair.router->metrics().oversize, 1u);
}

TEST(ZmqSocket, FramesBeyondAllMeasureCostTheirConnectionOnly) {
  Pair pair(TempIpc(), {.limits = {.max_message_bytes = 1000}});
  Message huge = Ask("huge");
  huge.attachment.assign(1 << 20, 'x');
  ASSERT_TRUE(pair.dealer->Send(huge).ok());
  // libzmq ends the connection; the dealer comes back by itself.
  Message got;
  ASSERT_TRUE(Eventually(
      [&] { return pair.dealer->Send(Ask("later")).ok() && ReceiveWithin(pair.router.get(), &got, 200); }));
  EXPECT_EQ(TextOf(got), "later");
}

TEST(ZmqSocket, MalformedMessagesAreDroppedAndCounted) {
  Pair pair;
  zmq::context_t raw_context;
  zmq::socket_t raw(raw_context, zmq::socket_type::dealer);
  raw.set(zmq::sockopt::linger, 0);
  raw.connect(pair.router->endpoint());
  const auto send = [&](std::vector<std::string> frames) {
    for (size_t i = 0; i < frames.size(); ++i)
      raw.send(zmq::buffer(frames[i]),
               i + 1 < frames.size() ? zmq::send_flags::sndmore : zmq::send_flags::none);
  };
  const std::string good = Ask("good").envelope.SerializeAsString();
  send({"not an envelope"});
  send({""});                           // parses, but says no version
  send({good, "attachment", "third"});  // a frame too many
  send({std::string(500, '\xff')});
  for (size_t cut = 1; cut < 10; ++cut) send({good.substr(0, good.size() - cut)});
  send({good});
  Message got;
  ASSERT_TRUE(ReceiveWithin(pair.router.get(), &got));
  // A cut envelope may still parse when it ends at a field: it then has no payload to unpack.
  uint64_t parsed = 0;
  while (TextOf(got) != "good") {
    ++parsed;
    ASSERT_TRUE(ReceiveWithin(pair.router.get(), &got));
  }
  EXPECT_EQ(pair.router->metrics().malformed + parsed, 13u);
  EXPECT_GE(pair.router->metrics().malformed, 4u);
}

TEST(ZmqSocket, UnknownTypesAreCountedAndRequestsOfThemAnswered) {
  Pair pair(TempIpc(), {.limits = {.known_types = {TestReply::descriptor()->full_name()}}});
  ASSERT_TRUE(pair.dealer->Send(MakeEvent(kWorker, TestRequest())).ok());
  const Message request = Ask("x");
  ASSERT_TRUE(pair.dealer->Send(request).ok());
  ASSERT_TRUE(pair.dealer->Send(MakeEvent(kWorker, TestReply())).ok());
  Message got;
  ASSERT_TRUE(ReceiveWithin(pair.router.get(), &got));
  EXPECT_TRUE(Is<TestReply>(got));
  EXPECT_EQ(pair.router->metrics().unknown_type, 2u);
  Message refusal;
  ASSERT_TRUE(ReceiveWithin(pair.dealer.get(), &refusal));
  EXPECT_EQ(refusal.envelope.request_id(), request.envelope.request_id());
  EXPECT_EQ(ReplyStatus(refusal).code(), StatusCode::kInvalid);
  EXPECT_THAT(ReplyStatus(refusal).message(), HasSubstr("ShowArtifactRequest"));
}

TEST(ZmqSocket, OtherProtocolVersionsAreAnsweredWithAClearError) {
  Pair pair;
  Message request = Ask("x");
  request.envelope.set_protocol_version(kProtocolVersion + 6);
  ASSERT_TRUE(pair.dealer->Send(request).ok());
  ASSERT_TRUE(pair.dealer->Send(Ask("current")).ok());
  Message got;
  ASSERT_TRUE(ReceiveWithin(pair.router.get(), &got));
  EXPECT_EQ(TextOf(got), "current");
  EXPECT_EQ(pair.router->metrics().wrong_version, 1u);
  Message refusal;
  ASSERT_TRUE(ReceiveWithin(pair.dealer.get(), &refusal));
  EXPECT_EQ(ReplyStatus(refusal).code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(ReplyStatus(refusal).message(), HasSubstr("protocol version 7"));
  EXPECT_THAT(ReplyStatus(refusal).message(), HasSubstr("update realitygrad"));
}

TEST(ZmqSocket, UnknownPeersAndAbsentServersAreUnavailable) {
  Pair pair;
  Message stray = Answer(Ask("x"), "y");
  stray.peer = "nobody";
  EXPECT_EQ(pair.router->Send(stray).code(), StatusCode::kUnavailable);
  EXPECT_EQ(pair.router->metrics().send_refused, 1u);
  const auto lonely = ConnectDealer(pair.context, TempIpc(), {.self = kWorker});
  ASSERT_TRUE(lonely.ok());
  EXPECT_EQ((*lonely)->Send(Ask("x")).code(), StatusCode::kUnavailable);
  EXPECT_FALSE((*lonely)->WaitWritable(20));
}

TEST(ZmqSocket, AFullQueueIsToldToTheSender) {
  Pair pair("inproc://full", {.high_water_messages = 5}, {.high_water_messages = 5});
  int sent = 0;
  while (sent < 1000 && pair.dealer->Send(Ask("x")).ok()) ++sent;
  EXPECT_GE(sent, 5);
  EXPECT_LT(sent, 1000);
  Message got;
  for (int i = 0; i < sent; ++i)
    ASSERT_TRUE(ReceiveWithin(pair.router.get(), &got)) << "what was taken is kept";
}

TEST(ZmqSocket, AServerThatComesBackIsFoundAgainUnderTheSameRoutingId) {
  Pair pair;
  const std::string endpoint = pair.router->endpoint();
  pair.router.reset();
  ASSERT_TRUE(Eventually([&] { return pair.dealer->link() == LinkState::kConnecting; }));
  auto again = BindRouter(pair.context, endpoint, {.self = kServer});
  ASSERT_TRUE(again.ok()) << again.status().ToString();
  pair.router = std::move(*again);
  ASSERT_TRUE(pair.dealer->WaitWritable(5000));
  ASSERT_TRUE(pair.dealer->Send(Ask("again")).ok());
  Message got;
  ASSERT_TRUE(ReceiveWithin(pair.router.get(), &got));
  EXPECT_TRUE(pair.router->Send(Answer(got, "x")).ok());
}

TEST(Poller, SeesSocketsAndFileDescriptors) {
  Pair pair;
  int fds[2];
  ASSERT_EQ(::pipe(fds), 0);
  Poller poller;
  EXPECT_EQ(poller.Add(pair.router.get()), 0);
  EXPECT_EQ(poller.AddFd(fds[0]), 1);
  EXPECT_TRUE(poller.Wait(0).empty());
  ASSERT_EQ(::write(fds[1], "x", 1), 1);
  EXPECT_THAT(poller.Wait(1000), testing::ElementsAre(1));
  ASSERT_TRUE(pair.dealer->Send(Ask("x")).ok());
  EXPECT_TRUE(Eventually([&] { return poller.Wait(100).size() == 2; }));
  EXPECT_FALSE(pair.dealer->Wait(1000, fds[0])) << "woken, but nothing to receive";
  ::close(fds[0]);
  ::close(fds[1]);
}

}  // namespace
}  // namespace rg::transport
