// Round trips per second through a router and one dealer, 64 in flight, envelopes and all checks
// included. Figures as JSON: transport_benchmark --benchmark_format=json
#include <benchmark/benchmark.h>

#include <atomic>
#include <thread>

#include "common/base/ids.h"
#include "common/transport/zmq_socket.h"
#include "realitygrad/v1/artifact.pb.h"

namespace rg::transport {
namespace {

const Sender kServer{"server", pb::ROLE_COORDINATOR};
const Sender kClient{"client", pb::ROLE_WORKER};

// Answers every request until told to stop.
class EchoServer {
 public:
  EchoServer(const std::string& endpoint, bool curve) {
    RouterOptions options{.self = kServer, .allow_plain_loopback = true};
    if (curve) {
      AllowList allowed;
      RG_CHECK(allowed.Add(client_keys.public_key, pb::ROLE_WORKER, "client").ok());
      context.SetAllowList(allowed);
      options.server_key = server_keys;
    }
    router = BindRouter(context, endpoint, options).value();
    thread_ = std::thread([this] { Run(); });
  }
  ~EchoServer() {
    stop_.store(true);
    thread_.join();
  }
  KeyPair server_keys = GenerateKeyPair(), client_keys = GenerateKeyPair();
  Context context;
  std::unique_ptr<ZmqSocket> router;

 private:
  void Run() {
    Message request;
    while (!stop_.load()) {
      if (!router->Wait(20)) continue;
      while (router->Receive(&request)) {
        Message reply = MakeReply(kServer, request, pb::PutArtifactReply());
        RG_CHECK(router->Send(reply).ok());
      }
    }
  }
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

void RoundTrips(benchmark::State& state, const std::string& endpoint, bool curve) {
  constexpr int kInFlight = 64;
  EchoServer server(endpoint, curve);
  DealerOptions options{.self = kClient, .allow_plain_loopback = true};
  if (curve) {
    options.key = server.client_keys;
    options.server_public_key = server.server_keys.public_key;
  }
  Context own;
  Context& context = endpoint.rfind("inproc", 0) == 0 ? server.context : own;
  auto dealer = ConnectDealer(context, server.router->endpoint(), options).value();
  RG_CHECK(dealer->WaitWritable(5000));
  pb::PutArtifactRequest body;
  body.set_upload_id("benchmark");
  Message request = MakeRequest(kClient, body);
  request.attachment.assign(state.range(0), 'x');
  int64_t answered = 0;
  Message reply;
  for (auto _ : state) {
    for (int i = 0; i < kInFlight; ++i) RG_CHECK(dealer->Send(request).ok());
    for (int i = 0; i < kInFlight;) {
      if (dealer->Receive(&reply))
        ++i, ++answered;
      else
        dealer->Wait(1000);
    }
  }
  state.counters["round_trips/s"] =
      benchmark::Counter(static_cast<double>(answered), benchmark::Counter::kIsRate);
  state.SetBytesProcessed(answered * state.range(0));
}

void BM_PlainTcp(benchmark::State& state) { RoundTrips(state, "tcp://127.0.0.1:*", false); }
void BM_CurveTcp(benchmark::State& state) { RoundTrips(state, "tcp://127.0.0.1:*", true); }
void BM_Ipc(benchmark::State& state) { RoundTrips(state, "ipc:///tmp/rg_benchmark_" + RandomHex(6), false); }
BENCHMARK(BM_PlainTcp)->ArgName("bytes")->Arg(1024)->Arg(1 << 20)->UseRealTime();
BENCHMARK(BM_CurveTcp)->ArgName("bytes")->Arg(1024)->Arg(1 << 20)->UseRealTime();
BENCHMARK(BM_Ipc)->ArgName("bytes")->Arg(1024)->Arg(1 << 20)->UseRealTime();

void BM_PackAndCheck(benchmark::State& state) {
  pb::PutArtifactRequest body;
  body.set_upload_id("benchmark");
  for (auto _ : state) {
    Message message = MakeRequest(kClient, body);
    benchmark::DoNotOptimize(message.envelope.SerializeAsString());
  }
}
BENCHMARK(BM_PackAndCheck);

}  // namespace
}  // namespace rg::transport

BENCHMARK_MAIN();
