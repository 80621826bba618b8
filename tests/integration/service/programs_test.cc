// What the programs say and how they end when they are used wrongly or told to stop.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/transport/keys.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 30.0;

class Programs : public ::testing::Test {
 protected:
  Programs() : folder_("/tmp/rg-programs-" + RandomHex(6)) { std::filesystem::create_directories(folder_); }
  ~Programs() override { std::filesystem::remove_all(folder_); }
  int Run(std::vector<std::string> arguments) {
    arguments[0] = BinFolder() + "/" + arguments[0];
    std::filesystem::remove(folder_ + "/log");
    return Process(arguments, folder_ + "/log").WaitForExit(kPatience);
  }
  static bool WaitFor(const std::function<bool()>& holds) {
    const double end = RealClock().SteadySeconds() + kPatience;
    while (!holds() && RealClock().SteadySeconds() < end)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return holds();
  }
  std::string Said() const { return *ReadFile(folder_ + "/log"); }
  std::string folder_;
};

TEST_F(Programs, AWrongFlagIsUsage) {
  EXPECT_EQ(Run({"realitygrad-coordinator", "--bogus"}), 2);
  EXPECT_EQ(Run({"realitygrad-coordinator", "--heartbeat-ms", "1"}), 2);
  EXPECT_EQ(Run({"realitygrad-coordinator", "--uncertain-s", "nan", "--db", folder_ + "/a.db"}), 2);
  EXPECT_EQ(Run({"synthetic_worker", "--slots", "many"}), 2);
  EXPECT_EQ(Run({"synthetic_worker", "--patience", "nan"}), 2);
  EXPECT_EQ(Run({"synthetic_worker", "--key", folder_ + "/none"}), 2);
  EXPECT_NE(Said().find("--server-key"), std::string::npos) << Said();
  EXPECT_EQ(Run({"realitygrad-coordinator", "--help"}), 0);
}

TEST_F(Programs, WhatIsRefusedLeavesNoDatabaseBehind) {
  Process page({BinFolder() + "/realitygrad-coordinator", "--listen", "ipc://" + folder_ + "/p", "--db",
                folder_ + "/page.db", "--web", "127.0.0.1:0", "--web-address-file", folder_ + "/url"},
               folder_ + "/page.log");
  ASSERT_TRUE(WaitFor([&] { return std::filesystem::exists(folder_ + "/url"); }));
  const std::string taken = ReadFile(folder_ + "/url")->substr(sizeof("http://") - 1);
  const std::vector<std::vector<std::string>> wrong = {
      {"--web", "here"},
      {"--web", "0.0.0.0:0"},
      {"--web", taken.substr(0, taken.find('\n'))},
      {"--may-submit", "nonsense"},
      {"--autoscale", "slurm", "--autoscale-worker-key", "k"}};
  for (const auto& flags : wrong) {
    std::vector<std::string> arguments = {"realitygrad-coordinator", "--listen", "ipc://" + folder_ + "/s",
                                          "--db", folder_ + "/a.db"};
    arguments.insert(arguments.end(), flags.begin(), flags.end());
    const int code = Run(arguments);
    EXPECT_TRUE(code == 1 || code == 2) << code << Said();
    EXPECT_NE(Said().find(flags[0]), std::string::npos) << Said();
    EXPECT_FALSE(std::filesystem::exists(folder_ + "/a.db")) << flags[1];
  }
}

TEST_F(Programs, NothingListensOnAPublicAddressWithoutKeys) {
  EXPECT_EQ(Run({"realitygrad-coordinator", "--listen", "ipc://@name", "--db", folder_ + "/a.db"}), 1);
  EXPECT_NE(Said().find("take a path"), std::string::npos) << Said();
  EXPECT_EQ(Run({"realitygrad-coordinator", "--listen", "tcp://0.0.0.0:0", "--db", folder_ + "/a.db"}), 1);
  EXPECT_NE(Said().find("keys"), std::string::npos) << Said();
}

TEST_F(Programs, AWorkerWithoutACoordinatorGivesUpWhenItsPatienceEnds) {
  EXPECT_EQ(Run({"synthetic_worker", "--coordinator", "ipc://" + folder_ + "/nobody", "--patience", "0.3",
                 "--folder", folder_ + "/w"}),
            6);
}

TEST_F(Programs, AFileThatIsNoDatabaseIsRefusedByName) {
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/a.db", std::string(5000, 'x')).ok());
  EXPECT_EQ(
      Run({"realitygrad-coordinator", "--listen", "ipc://" + folder_ + "/s", "--db", folder_ + "/a.db"}), 1);
  EXPECT_NE(Said().find("a.db"), std::string::npos) << Said();
}

TEST_F(Programs, SignalsStopThemCleanly) {
  Service service;
  service.StartWorker("a");
  ASSERT_TRUE(service.WaitForWorkers(1));
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 60})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForProgress(*id, "t"));
  service.worker("a").Signal(SIGINT);
  EXPECT_EQ(service.worker("a").WaitForExit(0.3), -1) << "the first signal drains";
  service.worker("a").Signal(SIGINT);
  EXPECT_EQ(service.worker("a").WaitForExit(kPatience), 0) << "the second one stops";
  EXPECT_TRUE(service.WaitForTask(*id, "t", pb::TASK_STATE_READY)) << "its task goes back at once";
  service.coordinator().Signal(SIGTERM);
  EXPECT_EQ(service.coordinator().WaitForExit(kPatience), 0);
  EXPECT_FALSE(std::filesystem::exists(service.folder() + "/socket"));
}

TEST_F(Programs, ARevokedKeyIsOutAtOnceAlsoWhereTheClockWasSetBack) {
  const auto own = transport::GenerateKeyFiles(folder_, "coordinator", pb::ROLE_COORDINATOR);
  const auto alice = transport::GenerateKeyFiles(folder_, "alice", pb::ROLE_OPERATOR);
  ASSERT_TRUE(own.ok() && alice.ok());
  const std::string allowed = folder_ + "/allowed", next = folder_ + "/next", address = folder_ + "/address";
  ASSERT_TRUE(transport::AllowKey(allowed, alice->keys.public_key, pb::ROLE_OPERATOR, "alice").ok());
  const Process program(
      {BinFolder() + "/realitygrad-coordinator", "--listen", "tcp://127.0.0.1:0", "--db", folder_ + "/a.db",
       "--key", folder_ + "/coordinator.key", "--allowed-keys", allowed, "--address-file", address},
      folder_ + "/log");
  ASSERT_TRUE(WaitFor([&] { return std::filesystem::exists(address); })) << Said();
  coordinator::ClientOptions options;
  options.address = ReadFile(address)->substr(0, ReadFile(address)->find('\n'));
  options.key = transport::LoadKeyFile(folder_ + "/alice.key")->keys;
  options.server_public_key = own->keys.public_key;
  options.attempts = 1;
  const auto client = coordinator::Client::Connect(options);
  ASSERT_TRUE(client.ok() && (*client)->CoordinatorStatus().ok()) << Said();
  // Written an hour from now, as the clock has it that was right then.
  std::filesystem::copy_file(allowed, next);
  ASSERT_TRUE(transport::RevokeKey(next, "alice").ok());
  std::filesystem::last_write_time(next,
                                   std::filesystem::file_time_type::clock::now() + std::chrono::hours(1));
  std::filesystem::rename(next, allowed);
  options.attempt_timeout_ms = 1'000;
  const auto is_out = [&] { return !(*coordinator::Client::Connect(options))->CoordinatorStatus().ok(); };
  EXPECT_TRUE(is_out()) << "before anything that came after it is looked at: " << Said();
  EXPECT_TRUE(is_out()) << "not because it was slow";
}

TEST_F(Programs, AnIdleWorkerLeavesIfItWasToldTo) {
  Service service;
  EXPECT_EQ(service.StartWorker("a", 1, {"--idle-exit", "0.5"}).WaitForExit(kPatience), 0);
  EXPECT_TRUE(service.client().Workers()->empty());
}

}  // namespace
}  // namespace rg::testing
