// What the coordinator can do: durable tasks per second through real sockets and a real database file
// (every assignment and every result is on the disk before anybody is told), the time from a submit
// to the worker's hands, and how fast it is back with a million tasks.
//
//   service_benchmark --benchmark_format=json
//
// The workers here compute nothing and run in this process: they answer each assignment at once.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <thread>

#include "common/base/ids.h"
#include "common/transport/keys.h"
#include "coordinator/client/client.h"
#include "coordinator/server/server.h"
#include "coordinator/store/schema.h"
#include "tests/support/service/processes.h"

namespace rg::coordinator {
namespace {

namespace testing = ::rg::testing;

constexpr uint32_t kSlots = 256;

struct Keys {
  transport::KeyPair server = transport::GenerateKeyPair();
  transport::KeyPair peer = transport::GenerateKeyPair();
};

// A coordinator on a thread of its own, on TCP, with its database in a file.
class Bench {
 public:
  explicit Bench(bool curve) : curve_(curve), folder_("/var/tmp/rg-bench-" + RandomHex(6)) {
    std::filesystem::create_directories(folder_);
    transport::RouterOptions router;
    router.self = {"coordinator", pb::ROLE_COORDINATOR};
    router.limits.max_message_bytes = 256u << 20;
    router.high_water_messages = 100'000;
    router.allow_plain_loopback = !curve;
    if (curve) {
      router.server_key = keys_.server;
      transport::AllowList allowed;
      RG_CHECK(allowed.Add(keys_.peer.public_key, pb::ROLE_WORKER, "peer").ok());
      RG_CHECK(allowed.Add(client_key_.public_key, pb::ROLE_OPERATOR, "operator").ok());
      context_.SetAllowList(std::move(allowed));
    }
    auto socket = transport::BindRouter(context_, "tcp://127.0.0.1:*", router);
    RG_CHECK(socket.ok()) << socket.status().ToString();
    endpoint_ = (*socket)->endpoint();
    ServerOptions options;
    options.database_path = folder_ + "/service.db";
    auto server = Server::Open(options, *std::move(socket), router.self, &RealClock());
    RG_CHECK(server.ok()) << server.status().ToString();
    server_ = *std::move(server);
    thread_ = std::thread([this] {
      while (!stop_.load()) RG_CHECK(server_->RunOnce(20).ok());
    });
  }
  ~Bench() {
    stop_.store(true);
    thread_.join();
    server_.reset();
    std::filesystem::remove_all(folder_);
  }

  std::unique_ptr<Client> NewClient() {
    ClientOptions options;
    options.address = endpoint_;
    options.attempt_timeout_ms = 120'000;
    if (curve_) options.key = client_key_, options.server_public_key = keys_.server.public_key;
    return *Client::Connect(options);
  }
  transport::DealerOptions WorkerSocket() const {
    transport::DealerOptions options;
    options.allow_plain_loopback = true;
    if (curve_) options.key = keys_.peer, options.server_public_key = keys_.server.public_key;
    return options;
  }
  const std::string& endpoint() const { return endpoint_; }

 private:
  bool curve_;
  std::string folder_, endpoint_;
  Keys keys_;
  transport::KeyPair client_key_ = transport::GenerateKeyPair();
  transport::Context context_;
  std::unique_ptr<Server> server_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

// Answers every assignment at once.
class InstantWorker {
 public:
  InstantWorker(Bench& bench, const std::string& name) : name_(name) {
    auto socket = transport::ConnectDealer(context_, bench.endpoint(), bench.WorkerSocket());
    RG_CHECK(socket.ok()) << socket.status().ToString();
    socket_ = *std::move(socket);
    thread_ = std::thread([this] { Run(); });
  }
  ~InstantWorker() {
    stop_.store(true);
    thread_.join();
  }
  std::atomic<int64_t> last_assigned_ns{0};

 private:
  void Send(const pb::WorkerMessage& message) {
    const Status sent =
        socket_->Send(transport::MakeEvent(transport::Sender{name_, pb::ROLE_WORKER}, message));
    (void)sent;
  }
  void Run() {
    socket_->WaitWritable(5'000);
    bool joined = false;
    int64_t next_beat = 0;
    while (!stop_.load()) {
      if (RealClock().SteadyNanos() > next_beat) {
        next_beat = RealClock().SteadyNanos() + 500'000'000;
        pb::WorkerMessage message;
        if (joined) {
          message.mutable_heartbeat();
        } else {
          message.mutable_hello()->set_name(name_);
          message.mutable_hello()->set_slots(kSlots);
          message.mutable_hello()->add_kinds("work");
        }
        Send(message);
      }
      socket_->Wait(50);
      transport::Message message;
      while (socket_->Receive(&message)) {
        const auto body = transport::Unpack<pb::CoordinatorMessage>(message);
        if (body->has_welcome()) joined = true;
        if (!body->has_assign()) continue;
        last_assigned_ns.store(RealClock().SteadyNanos());
        pb::WorkerMessage answer;
        answer.mutable_finished()->set_token(body->assign().token());
        answer.mutable_finished()->set_task(body->assign().task());
        Send(answer);
      }
    }
  }
  std::string name_;
  transport::Context context_;
  std::unique_ptr<transport::ZmqSocket> socket_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

pb::JobSpec ManyTasks(int count) {
  pb::JobSpec job;
  for (int i = 0; i < count; ++i) {
    pb::TaskSpec* task = job.add_tasks();
    task->set_name("t" + std::to_string(i));
    task->set_kind("work");
    task->set_payload(std::string(100, 'p'));
  }
  return job;
}

void DurableTasks(benchmark::State& state) {
  Bench bench(state.range(0) == 1);
  InstantWorker a(bench, "a"), b(bench, "b");
  auto client = bench.NewClient();
  constexpr int kTasks = 30'000;
  for (auto _ : state) {
    const pb::JobSpec job = ManyTasks(kTasks);
    const auto id = client->Submit(job);
    RG_CHECK(id.ok()) << id.status().ToString();
    const double begin = RealClock().SteadySeconds();
    const auto end = client->WaitForJob(*id);
    RG_CHECK(end.ok() && end->job().state() == pb::JOB_STATE_SUCCEEDED);
    state.SetIterationTime(RealClock().SteadySeconds() - begin);
  }
  state.SetItemsProcessed(state.iterations() * kTasks);
  state.SetLabel(state.range(0) == 1 ? "CURVE" : "plain");
}
BENCHMARK(DurableTasks)->Arg(0)->Arg(1)->UseManualTime()->Iterations(3)->Unit(benchmark::kMillisecond);

// The whole way with real programs: two workers with two executors each, one small output per task.
void TasksThroughExecutors(benchmark::State& state) {
  testing::Service service(1000);
  service.StartWorker("a", 2);
  service.StartWorker("b", 2);
  RG_CHECK(service.WaitForWorkers(2));
  constexpr int kTasks = 1'000;
  for (auto _ : state) {
    pb::JobSpec job;
    for (int i = 0; i < kTasks; ++i) {
      testing::AddTask(&job, "t" + std::to_string(i), "echo", "{\"text\": \"" + std::to_string(i) + "\"}");
    }
    const auto id = service.client().Submit(job);
    RG_CHECK(id.ok());
    const double begin = RealClock().SteadySeconds();
    RG_CHECK(service.client().WaitForJob(*id).ok());
    state.SetIterationTime(RealClock().SteadySeconds() - begin);
  }
  state.SetItemsProcessed(state.iterations() * kTasks);
}
BENCHMARK(TasksThroughExecutors)->UseManualTime()->Iterations(2)->Unit(benchmark::kMillisecond);

// From the submit's call to the assignment in the worker's hands, on an idle service; p50 and p99.
void Dispatch(benchmark::State& state) {
  Bench bench(true);
  InstantWorker worker(bench, "a");
  auto client = bench.NewClient();
  const pb::JobSpec job = ManyTasks(1);
  std::vector<double> ms;
  for (auto _ : state) {
    worker.last_assigned_ns.store(0);
    const int64_t begin = RealClock().SteadyNanos();
    const auto id = client->Submit(job);
    RG_CHECK(id.ok() && client->WaitForJob(*id).ok());
    const double elapsed = 1e-6 * static_cast<double>(worker.last_assigned_ns.load() - begin);
    ms.push_back(elapsed);
    state.SetIterationTime(1e-3 * elapsed);
  }
  std::sort(ms.begin(), ms.end());
  state.counters["p50_ms"] = ms[ms.size() / 2];
  state.counters["p99_ms"] = ms[ms.size() * 99 / 100];
}
BENCHMARK(Dispatch)->UseManualTime()->Iterations(300)->Unit(benchmark::kMillisecond);

// Opening the database and rebuilding the state, with a million tasks in it.
void Restart(benchmark::State& state) {
  const std::string path = "/var/tmp/rg-bench-" + RandomHex(6) + ".db";
  {
    auto database = store::Database::Open({.path = path}, {CoordinatorSchema()});
    RG_CHECK(database.ok());
    JobStore store(database->get());
    auto plan = std::make_shared<JobPlan>();
    for (int i = 0; i < 100'000; ++i) {
      TaskPlan& task = plan->tasks.emplace_back();
      task.name = "task" + std::to_string(i);
      task.kind = task.stage = "work";
      if (i > 0) task.parents.push_back({static_cast<uint32_t>(i / 10), false});
    }
    for (JobId job = 1; job <= 10; ++job) {
      auto transaction = (*database)->Begin();
      RG_CHECK(store.Apply({InsertJob{job, "r" + std::to_string(job), 1, plan, nullptr}}, {}).ok());
      RG_CHECK(transaction->Commit().ok());
    }
  }
  for (auto _ : state) {
    auto database = store::Database::Open({.path = path}, {CoordinatorSchema()});
    RG_CHECK(database.ok());
    JobStore store(database->get());
    const auto stored = store.Load();
    RG_CHECK(stored.ok());
    const State restored = Restore(*stored, Options{}, Now{});
    RG_CHECK(restored.jobs.size() == 10);
  }
  for (const char* suffix : {"", "-wal", "-shm"}) std::filesystem::remove(path + suffix);
}
BENCHMARK(Restart)->Iterations(3)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace rg::coordinator

BENCHMARK_MAIN();
