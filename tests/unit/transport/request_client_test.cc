#include "common/transport/request_client.h"

#include <gmock/gmock.h>

#include <map>

#include "common/transport/fake_transport.h"
#include "common/transport/zmq_socket.h"
#include "tests/unit/transport/messages.h"

namespace rg::transport {
namespace {

using testing::HasSubstr;

// A server that answers each request with how often it has seen its id.
class RequestClientTest : public testing::Test {
 protected:
  void Start(const FakeNetworkOptions& options, RequestOptions request_options = {}, uint64_t seed = 1) {
    network_ = std::make_unique<FakeNetwork>(options, Rng(seed), &clock_);
    server_ = network_->Bind("server");
    network_->OnIdle([this] { Serve(); });
    client_ = std::make_unique<RequestClient>(network_->Connect("server", "me"), kWorker, "coordinator",
                                              clock_, request_options, [this](Message) { ++events_; });
  }
  void Serve() {
    Message got;
    while (server_ && server_->Receive(&got)) {
      if (silent_) continue;
      const int times = ++seen_[got.envelope.request_id()];
      (void)server_->Send(Answer(got, TextOf(got) + "#" + std::to_string(times)));
    }
  }

  FakeClock clock_;
  std::unique_ptr<FakeNetwork> network_;
  std::unique_ptr<Socket> server_;
  std::unique_ptr<RequestClient> client_;
  std::map<std::string, int> seen_;
  bool silent_ = false;
  int events_ = 0;
};

TEST_F(RequestClientTest, AnswersComeBackTyped) {
  Start({.delay_min_ms = 5, .delay_max_ms = 10});
  TestRequest request;
  request.set_sha256("abc");
  const auto reply = client_->Call<TestReply>(request);
  ASSERT_TRUE(reply.ok()) << reply.status().ToString();
  EXPECT_EQ(reply->info().sha256(), "abc#1");
}

TEST_F(RequestClientTest, GetsThroughALossyNetworkWithOneIdPerRequest) {
  Start({.drop = 0.3, .repeat = 0.3, .delay_min_ms = 1, .delay_max_ms = 3000},
        {.attempt_timeout_ms = 2000, .attempts = 50});
  for (int i = 0; i < 50; ++i) {
    const Message request = Ask(std::to_string(i));
    const auto reply = client_->Call(request);
    ASSERT_TRUE(reply.ok()) << i << ": " << reply.status().ToString();
    EXPECT_THAT(Unpack<TestReply>(*reply)->info().sha256(), HasSubstr(std::to_string(i) + "#"));
  }
  EXPECT_EQ(seen_.size(), 50u) << "repeats carry the id of their request";
  EXPECT_GT(client_->repeats(), 10u);
  EXPECT_GT(client_->late_replies(), 10u);
}

TEST_F(RequestClientTest, ASilentServerIsUnavailableAfterAllAttempts) {
  Start({}, {.attempt_timeout_ms = 1000, .attempts = 3});
  silent_ = true;
  const int64_t start = clock_.SteadyNanos();
  const auto reply = client_->Call(Ask("x"));
  EXPECT_EQ(reply.status().code(), StatusCode::kUnavailable);
  EXPECT_THAT(reply.status().message(), HasSubstr("coordinator: no answer within 1000 ms, asked 3 times"));
  EXPECT_EQ(clock_.SteadyNanos() - start, 3'000'000'000);
}

TEST_F(RequestClientTest, AnAbsentServerIsUnavailableAfterTheConnectTimeout) {
  Start({}, {.connect_timeout_ms = 700});
  server_.reset();
  const int64_t start = clock_.SteadyNanos();
  const auto reply = client_->Call(Ask("x"));
  EXPECT_EQ(reply.status().code(), StatusCode::kUnavailable);
  EXPECT_THAT(reply.status().message(), HasSubstr("nobody answers there"));
  EXPECT_EQ(clock_.SteadyNanos() - start, 700'000'000);
}

TEST_F(RequestClientTest, ErrorsOfTheServerAreReturnedAndNotRepeated) {
  Start({});
  network_->OnIdle([this] {
    Message got;
    while (server_->Receive(&got)) {
      (void)server_->Send(MakeEvent(kServer, TestRequest()));  // to nobody
      Message event = MakeEvent(kServer, TestRequest());
      event.peer = got.peer;
      (void)server_->Send(event);
      (void)server_->Send(MakeErrorReply(kServer, got, NotFoundError("job 7: no such job")));
    }
  });
  const auto reply = client_->Call(Ask("x"));
  EXPECT_EQ(reply.status().code(), StatusCode::kNotFound);
  EXPECT_EQ(reply.status().message(), "job 7: no such job");
  EXPECT_EQ(client_->repeats(), 0u);
  EXPECT_EQ(events_, 1);
}

TEST(RequestClient, CancelFromAnotherThreadEndsTheCall) {
  Context context;
  auto router = BindRouter(context, "inproc://silent", {.self = kServer});
  auto dealer = ConnectDealer(context, "inproc://silent", {.self = kWorker});
  RequestClient client(std::move(*dealer), kWorker, "coordinator", RealClock(),
                       {.attempt_timeout_ms = 3'600'000});
  std::thread canceller([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    client.Cancel();
  });
  EXPECT_EQ(client.Call(Ask("x")).status().code(), StatusCode::kCancelled);
  canceller.join();
  EXPECT_EQ(client.Call(Ask("x")).status().code(), StatusCode::kCancelled);
}

TEST(RequestClient, AnAbsentRealServerIsUnavailable) {
  Context context;
  auto dealer = ConnectDealer(context, "ipc:///tmp/rg_absent_" + RandomHex(6), {.self = kWorker});
  ASSERT_TRUE(dealer.ok());
  RequestClient client(std::move(*dealer), kWorker, "coordinator", RealClock(), {.connect_timeout_ms = 50});
  EXPECT_EQ(client.Call(Ask("x")).status().code(), StatusCode::kUnavailable);
}

}  // namespace
}  // namespace rg::transport
