#include <gmock/gmock.h>

#include "common/transport/request_client.h"
#include "common/transport/zmq_socket.h"
#include "tests/unit/transport/messages.h"

namespace rg::transport {
namespace {

using testing::HasSubstr;

class CurveTest : public testing::Test {
 protected:
  void SetUp() override {
    ASSERT_TRUE(allowed_.Add(worker_.public_key, pb::ROLE_WORKER, "host7").ok());
    ASSERT_TRUE(allowed_.Add(viewer_.public_key, pb::ROLE_VIEWER, "anna").ok());
    server_context_.SetAllowList(allowed_);
    auto bound = BindRouter(server_context_, "tcp://127.0.0.1:*", {.self = kServer, .server_key = server_});
    ASSERT_TRUE(bound.ok()) << bound.status().ToString();
    router_ = std::move(*bound);
  }
  std::unique_ptr<ZmqSocket> Connect(const KeyPair& key, const std::string& server_key,
                                     const Sender& self = kWorker) {
    auto dealer =
        ConnectDealer(client_context_, router_->endpoint(),
                      {.self = self, .key = key, .server_public_key = server_key, .handshake_ms = 400});
    EXPECT_TRUE(dealer.ok()) << dealer.status().ToString();
    return std::move(*dealer);
  }

  KeyPair server_ = GenerateKeyPair(), worker_ = GenerateKeyPair(), viewer_ = GenerateKeyPair();
  AllowList allowed_;
  Context server_context_, client_context_;
  std::unique_ptr<ZmqSocket> router_;
};

TEST_F(CurveTest, AllowedKeyComesInWithItsRole) {
  auto dealer = Connect(worker_, server_.public_key);
  ASSERT_TRUE(dealer->WaitWritable(5000));
  ASSERT_TRUE(dealer->Send(Ask("hello")).ok());
  Message got;
  ASSERT_TRUE(ReceiveWithin(router_.get(), &got));
  EXPECT_TRUE(got.credentials.authenticated);
  EXPECT_EQ(got.credentials.role, pb::ROLE_WORKER);
  EXPECT_EQ(got.credentials.name, "host7");
  ASSERT_TRUE(router_->Send(Answer(got, "x")).ok());
  Message reply;
  ASSERT_TRUE(ReceiveWithin(dealer.get(), &reply));
  EXPECT_EQ(server_context_.handshakes().accepted, 1u);
}

TEST_F(CurveTest, AnUnknownKeyIsToldNothing) {
  auto dealer = Connect(GenerateKeyPair(), server_.public_key);
  EXPECT_TRUE(Eventually([&] { return server_context_.handshakes().refused >= 2; })) << "it tries again";
  EXPECT_EQ(dealer->link(), LinkState::kConnecting);
  EXPECT_TRUE(dealer->LinkError().ok()) << dealer->LinkError().ToString();
  EXPECT_EQ(dealer->Send(Ask("x")).code(), StatusCode::kUnavailable);
  EXPECT_GE(server_context_.handshakes().refused, 1u);
  EXPECT_EQ(server_context_.handshakes().accepted, 0u);
}

TEST_F(CurveTest, WrongServerKeyNeverConnects) {
  auto dealer = Connect(worker_, GenerateKeyPair().public_key);
  EXPECT_FALSE(dealer->WaitWritable(300));
  EXPECT_TRUE(Eventually([&] { return !dealer->LinkHint().empty(); }));
  EXPECT_EQ(server_context_.handshakes().accepted, 0u);
}

TEST_F(CurveTest, PlainPeerIsRefused) {
  auto dealer =
      ConnectDealer(client_context_, router_->endpoint(), {.self = kWorker, .allow_plain_loopback = true});
  ASSERT_TRUE(dealer.ok());
  EXPECT_TRUE(Eventually([&] { return (*dealer)->link() == LinkState::kRefused; }));
  EXPECT_EQ((*dealer)->Send(Ask("x")).code(), StatusCode::kUnavailable);
}

TEST_F(CurveTest, RoleIsBoundToTheKeyNotToTheClaim) {
  auto dealer = Connect(viewer_, server_.public_key);
  ASSERT_TRUE(dealer->WaitWritable(5000));
  ASSERT_TRUE(dealer->Send(Ask("as worker", kWorker)).ok());
  ASSERT_TRUE(dealer->Send(Ask("as viewer", {"anna-1", pb::ROLE_VIEWER})).ok());
  Message got;
  ASSERT_TRUE(ReceiveWithin(router_.get(), &got));
  EXPECT_EQ(TextOf(got), "as viewer");
  EXPECT_EQ(router_->metrics().unauthorized, 1u);
  Message refusal;
  ASSERT_TRUE(ReceiveWithin(dealer.get(), &refusal));
  EXPECT_EQ(ReplyStatus(refusal).code(), StatusCode::kPermissionDenied);
  EXPECT_THAT(ReplyStatus(refusal).message(), HasSubstr("\"anna\" is allowed as viewer, not as worker"));
}

TEST_F(CurveTest, RevokedKeyIsRefusedOnAStandingConnection) {
  auto dealer = Connect(worker_, server_.public_key);
  ASSERT_TRUE(dealer->WaitWritable(5000));
  ASSERT_TRUE(dealer->Send(Ask("before")).ok());
  Message got;
  ASSERT_TRUE(ReceiveWithin(router_.get(), &got));
  ASSERT_TRUE(allowed_.Remove(worker_.public_key));
  server_context_.SetAllowList(allowed_);
  ASSERT_TRUE(dealer->Send(Ask("after")).ok());
  EXPECT_FALSE(ReceiveWithin(router_.get(), &got, 300));
  EXPECT_EQ(router_->metrics().unauthorized, 1u);
}

TEST_F(CurveTest, NewlyAllowedKeyComesInWithoutARestart) {
  const KeyPair late = GenerateKeyPair();
  auto dealer = Connect(late, server_.public_key);
  ASSERT_TRUE(Eventually([&] { return server_context_.handshakes().refused >= 1; }));
  ASSERT_TRUE(allowed_.Add(late.public_key, pb::ROLE_WORKER, "late").ok());
  server_context_.SetAllowList(allowed_);
  EXPECT_TRUE(dealer->WaitWritable(5000));
  EXPECT_EQ(dealer->link(), LinkState::kConnected);
}

TEST_F(CurveTest, AClientWithAnUnknownKeySeesATimeOutAsIfNobodyWereThere) {
  RequestClient client(Connect(GenerateKeyPair(), server_.public_key), kWorker, "coordinator", RealClock(),
                       {.connect_timeout_ms = 900});
  const auto reply = client.Call(Ask("x"));
  EXPECT_EQ(reply.status().code(), StatusCode::kUnavailable);
  EXPECT_THAT(reply.status().message(), HasSubstr("nobody answers there"));
  EXPECT_THAT(reply.status().message(), HasSubstr("ours on its allow-list?")) << "our own guess helps people";
}

TEST(Curve, EncryptedSocketWithoutAnAllowListIsRefused) {
  Context context;
  const auto bound = BindRouter(context, "tcp://127.0.0.1:*", {.server_key = GenerateKeyPair()});
  ASSERT_FALSE(bound.ok());
  EXPECT_EQ(bound.status().code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(bound.status().message(), HasSubstr("allow-list"));
}

TEST(Curve, BadKeysAreNamed) {
  Context context;
  context.SetAllowList({});
  KeyPair bad = GenerateKeyPair();
  bad.secret_key.pop_back();
  EXPECT_THAT(BindRouter(context, "tcp://127.0.0.1:*", {.server_key = bad}).status().message(),
              HasSubstr("server key"));
  EXPECT_THAT(
      ConnectDealer(context, "tcp://127.0.0.1:1", {.key = GenerateKeyPair(), .server_public_key = "x"})
          .status()
          .message(),
      HasSubstr("server's public key"));
}

}  // namespace
}  // namespace rg::transport
