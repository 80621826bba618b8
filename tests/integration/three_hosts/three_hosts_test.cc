// A coordinator and workers on three hosts: network namespaces with addresses of their own on one
// bridge, encrypted connections, keys per role. A worker joins half-way and takes work; one is killed
// and its shards finish elsewhere; who has no key stays outside.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/transport/keys.h"
#include "tests/integration/three_hosts/hosts.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 60.0;
constexpr char kNetwork[] = "10.77.31.";
constexpr char kAddress[] = "tcp://10.77.31.1:7341";

// While it lives, this thread and the threads it starts are on that host.
class VisitHost {
 public:
  explicit VisitHost(const std::string& name) : home_(open("/proc/self/ns/net", O_RDONLY | O_CLOEXEC)) {
    const int there = open(("/var/run/netns/" + name).c_str(), O_RDONLY | O_CLOEXEC);
    ok_ = there >= 0 && setns(there, CLONE_NEWNET) == 0;
    if (there >= 0) close(there);
  }
  ~VisitHost() {
    if (setns(home_, CLONE_NEWNET) != 0) std::abort();
    close(home_);
  }
  bool ok() const { return ok_; }

 private:
  int home_;
  bool ok_;
};

class ThreeHosts : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!Hosts::WhyNot().empty()) GTEST_SKIP() << Hosts::WhyNot();
    hosts_ = std::make_unique<Hosts>(kNetwork);
    if (!hosts_->ok()) GTEST_SKIP() << "this kernel or container does not let us make network namespaces";
    folder_ = "/tmp/rg-hosts-" + RandomHex(6);
    std::filesystem::create_directories(folder_);
    MakeKeys();
    StartCoordinator();
  }
  void TearDown() override {
    if (folder_.empty()) return;
    std::filesystem::remove_all(folder_);
  }

  std::string KeyPath(const std::string& name, const std::string& suffix = ".key") const {
    return folder_ + "/keys/" + name + suffix;
  }

  void MakeKeys() {
    transport::AllowList allowed;
    const std::pair<const char*, pb::Role> keys[] = {
        {"coordinator", pb::ROLE_COORDINATOR}, {"a", pb::ROLE_WORKER},      {"b", pb::ROLE_WORKER},
        {"operator", pb::ROLE_OPERATOR},       {"viewer", pb::ROLE_VIEWER}, {"stranger", pb::ROLE_OPERATOR}};
    for (const auto& [name, role] : keys) {
      const auto key = transport::GenerateKeyFiles(folder_ + "/keys", name, role);
      ASSERT_TRUE(key.ok()) << key.status().ToString();
      if (std::string(name) == "stranger" || role == pb::ROLE_COORDINATOR) continue;
      ASSERT_TRUE(allowed.Add(key->keys.public_key, role, name).ok());
    }
    ASSERT_TRUE(WriteFileAtomically(folder_ + "/allowed_keys", allowed.Format()).ok());
  }

  void StartCoordinator() {
    const std::string address_file = folder_ + "/address";
    coordinator_ = std::make_unique<Process>(
        hosts_->On(1, {BinFolder() + "/realitygrad-coordinator", "--listen", kAddress, "--db",
                       folder_ + "/service.db", "--heartbeat-ms", "400", "--address-file", address_file,
                       "--key", KeyPath("coordinator"), "--allowed-keys", folder_ + "/allowed_keys"}),
        folder_ + "/coordinator.log");
    const double end = RealClock().SteadySeconds() + 20.0;
    while (!std::filesystem::exists(address_file) && RealClock().SteadySeconds() < end) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  }

  std::unique_ptr<Process> StartWorker(int host, const std::string& name) {
    return std::make_unique<Process>(
        hosts_->On(host, {BinFolder() + "/synthetic_worker", "--coordinator", kAddress, "--name", name,
                          "--slots", "2", "--folder", folder_ + "/worker-" + name, "--key", KeyPath(name),
                          "--server-key", KeyPath("coordinator", ".pub")}),
        folder_ + "/" + name + ".log");
  }

  std::unique_ptr<coordinator::Client> Connect(const std::string& key_name) {
    coordinator::ClientOptions options;
    options.address = kAddress;
    options.key = transport::LoadKeyFile(KeyPath(key_name))->keys;
    options.server_public_key = transport::LoadPublicKeyFile(KeyPath("coordinator", ".pub"))->keys.public_key;
    options.read_only = key_name == "viewer";
    options.connect_timeout_ms = key_name == "stranger" ? 2'000 : 20'000;
    options.attempts = key_name == "stranger" ? 1 : 5;
    auto client = coordinator::Client::Connect(options);
    EXPECT_TRUE(client.ok()) << client.status().ToString();
    return *std::move(client);
  }

  std::string Logs() const {
    std::string text;
    for (const char* name : {"coordinator", "a", "b"})
      text += ReadFile(folder_ + "/" + name + ".log").ok() ? *ReadFile(folder_ + "/" + name + ".log") : "";
    return text;
  }

  std::unique_ptr<Hosts> hosts_;
  std::string folder_;
  std::unique_ptr<Process> coordinator_;
};

TEST_F(ThreeHosts, AWorkerJoinsHalfWayAndAKilledOnesShardsFinishElsewhere) {
  const VisitHost here(hosts_->Name(3));
  ASSERT_TRUE(here.ok());
  auto client = Connect("operator");
  auto a = StartWorker(2, "a");
  pb::JobSpec job;
  constexpr int kShards = 40;
  for (int i = 0; i < kShards; ++i) {
    AddTask(&job, "shard" + std::to_string(i), "sleep", R"({"seconds": 0.15})")->set_stage("shards");
  }
  AddStageInput(AddTask(&job, "join", "echo"), "shards", "shards");
  const auto id = client->Submit(job);
  ASSERT_TRUE(id.ok()) << id.status().ToString() << Logs();

  std::unique_ptr<Process> b;
  const auto end = client->WaitForJob(*id, kPatience, [&](const pb::GetJobReply& now) {
    if (b == nullptr && now.job().tasks_done() >= kShards / 4) b = StartWorker(3, "b");
    if (a == nullptr || now.job().tasks_done() < kShards / 2) return;
    const auto workers = client->Workers();
    for (const auto& worker : *workers) {
      if (worker.name() == "b" && worker.tasks_done() >= 2) a.reset();  // kill -9
    }
  });
  ASSERT_TRUE(end.ok()) << end.status().ToString() << Logs();
  ASSERT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED) << end->job().reason() << Logs();
  ASSERT_EQ(a, nullptr) << "worker a was to be killed on the way";

  const auto reply = client->GetJob(*id, true, true);
  int by_b = 0, lost_by_a = 0;
  for (const pb::TaskInfo& task : reply->tasks()) {
    int committed = 0;
    for (const auto& attempt : task.attempt_list()) {
      committed += attempt.outcome() == pb::ATTEMPT_OUTCOME_SUCCEEDED;
      by_b += attempt.outcome() == pb::ATTEMPT_OUTCOME_SUCCEEDED && attempt.worker() == "b";
      lost_by_a += attempt.outcome() == pb::ATTEMPT_OUTCOME_LOST && attempt.worker() == "a";
    }
    EXPECT_EQ(committed, 1) << task.name();
  }
  EXPECT_GT(by_b, 2);
  EXPECT_GT(lost_by_a, 0) << "it held shards when it was killed";
  std::string expected;
  for (int i = 0; i < kShards; ++i) expected += "shard" + std::to_string(i) + " slept";
  EXPECT_EQ(*client->GetArtifact(FindTask(*reply, "join")->outputs(0).sha256()), expected);
}

TEST_F(ThreeHosts, APartitionedWorkersTaskFinishesElsewhereAndItsLateResultIsRefused) {
  const VisitHost here(hosts_->Name(3));
  ASSERT_TRUE(here.ok());
  auto client = Connect("operator");
  auto a = StartWorker(2, "a");
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 1.0})");
  const auto id = client->Submit(job);
  ASSERT_TRUE(id.ok()) << id.status().ToString();
  const auto until = [](const std::function<bool()>& holds) {
    const double end = RealClock().SteadySeconds() + kPatience;
    while (!holds() && RealClock().SteadySeconds() < end)
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return holds();
  };
  ASSERT_TRUE(until([&] { return client->GetJob(*id)->tasks(0).state() == pb::TASK_STATE_LEASED; }));
  hosts_->Plug(2, false);
  auto b = StartWorker(3, "b");
  const auto end = client->WaitForJob(*id, kPatience);
  ASSERT_TRUE(end.ok() && end->job().state() == pb::JOB_STATE_SUCCEEDED) << Logs();
  EXPECT_EQ(client->GetJob(*id, true, true)->tasks(0).attempt_list(1).worker(), "b");
  hosts_->Plug(2, true);
  EXPECT_TRUE(until([&] { return client->CoordinatorStatus()->workers() == 2; }))
      << "it joins again" << Logs();
  EXPECT_TRUE(until([&] {
    return client->CoordinatorStatus()->counters().at("results_refused_total") >= 1.0;
  })) << Logs();
}

TEST_F(ThreeHosts, ARevokedKeysSessionEndsAtOnceAndItsTaskGoesElsewhere) {
  const VisitHost here(hosts_->Name(3));
  ASSERT_TRUE(here.ok());
  auto client = Connect("operator");
  auto a = StartWorker(2, "a");
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 2})");
  const auto id = client->Submit(job);
  ASSERT_TRUE(id.ok()) << id.status().ToString();
  const auto worker_of_t = [&] { return client->GetJob(*id)->tasks(0).worker(); };
  const auto until = [](const std::function<bool()>& holds) {
    const double end = RealClock().SteadySeconds() + kPatience;
    while (!holds() && RealClock().SteadySeconds() < end)
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return holds();
  };
  ASSERT_TRUE(until([&] { return worker_of_t() == "a"; })) << Logs();
  auto b = StartWorker(3, "b");
  ASSERT_TRUE(until([&] { return client->CoordinatorStatus()->workers() == 2; }));
  std::filesystem::rename(folder_ + "/allowed_keys", folder_ + "/being_edited");
  std::this_thread::sleep_for(std::chrono::milliseconds(600));
  EXPECT_EQ(client->CoordinatorStatus()->workers(), 2u) << "a file that is gone for a moment revokes nobody";
  std::filesystem::rename(folder_ + "/being_edited", folder_ + "/allowed_keys");
  ASSERT_TRUE(transport::RevokeKey(folder_ + "/allowed_keys", "a").ok());
  ASSERT_TRUE(until([&] { return worker_of_t() == "b"; })) << Logs();
  EXPECT_EQ(client->CoordinatorStatus()->counters().at("workers_lost_total"), 0.0)
      << "not because it was silent";
  EXPECT_EQ(client->WaitForJob(*id, kPatience)->job().state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(client->CoordinatorStatus()->workers(), 1u) << "nor does it come back";
  EXPECT_EQ(Connect("stranger")->ListJobs().status().code(), StatusCode::kUnavailable)
      << "an unknown key sees a time-out";
}

TEST_F(ThreeHosts, KeysDecideWhoMayDoWhat) {
  const VisitHost here(hosts_->Name(2));
  ASSERT_TRUE(here.ok());
  pb::JobSpec job;
  AddTask(&job, "t", "echo");
  auto viewer = Connect("viewer");
  EXPECT_TRUE(viewer->ListJobs().ok());
  EXPECT_EQ(viewer->Submit(job).status().code(), StatusCode::kPermissionDenied);
  Process impostor(
      hosts_->On(2, {BinFolder() + "/synthetic_worker", "--coordinator", kAddress, "--folder", folder_ + "/w",
                     "--key", KeyPath("operator"), "--server-key", KeyPath("coordinator", ".pub")}),
      folder_ + "/impostor.log");
  EXPECT_EQ(impostor.WaitForExit(kPatience), 2) << "an operator's key makes no worker";
  auto stranger = Connect("stranger");
  EXPECT_FALSE(stranger->ListJobs().ok());
}

}  // namespace
}  // namespace rg::testing
