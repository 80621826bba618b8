// `coordinator --autoscale slurm` against a real Slurm: allocations come with the work and go with it,
// nothing is asked for twice, whoever is killed in between.
#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <sstream>
#include <thread>

#include "common/base/clock.h"
#include "common/base/ids.h"
#include "tests/support/service/processes.h"
#include "tests/support/slurm/mini_slurm.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 120.0;

class AutoscaleSlurm : public ::testing::Test {
 protected:
  void SetUp() override {
    const std::string missing = MiniSlurm::Missing();
    if (!missing.empty()) GTEST_SKIP() << missing;
    folder_ = "/tmp/rg-slurm-" + RandomHex(6);
    slurm_ = std::make_unique<MiniSlurm>(folder_);
    ASSERT_TRUE(slurm_->WaitUntilIdle(kPatience)) << slurm_->Logs();
    setenv("REALITYGRAD_WORKER_FOLDER", (folder_ + "/worker").c_str(), 1);
  }
  void TearDown() override {
    service_.reset();
    slurm_.reset();
    unsetenv("REALITYGRAD_WORKER_FOLDER");
    std::error_code ignored;
    if (!folder_.empty()) std::filesystem::remove_all(folder_, ignored);
  }
  void StartService(int max) {
    service_ = std::make_unique<Service>(
        400, std::vector<std::string>{"--autoscale", "slurm", "--autoscale-worker",
                                      BinFolder() + "/synthetic_worker", "--autoscale-max",
                                      std::to_string(max), "--autoscale-idle-s", "2", "--autoscale-period-s",
                                      "0.3", "--autoscale-patience-s", "60"});
  }
  int64_t Submit(int tasks, double seconds) {
    pb::JobSpec job;
    job.set_kind("iteration");
    for (int i = 0; i < tasks; ++i)
      AddTask(&job, "shard-" + std::to_string(i), "sleep", "{\"seconds\": " + std::to_string(seconds) + "}");
    auto* policy = AddTask(&job, "policy", "echo", R"({"text": "x"})");
    for (int i = 0; i < tasks; ++i) policy->add_after("shard-" + std::to_string(i));
    return *service_->client().Submit(job);
  }
  static bool WaitUntil(const std::function<bool()>& holds) {
    const double end = RealClock().SteadySeconds() + kPatience;
    while (!holds()) {
      if (RealClock().SteadySeconds() > end) return false;
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    return true;
  }
  // Allocations that pend or run.
  bool AllGone() {
    return slurm_->Queue("--states=PENDING,RUNNING,COMPLETING").empty() &&
           service_->client().Workers()->empty();
  }
  // Of every allocation that ever was: how often its name occurs.
  std::map<std::string, int> Names() {
    std::map<std::string, int> names;
    std::istringstream lines(slurm_->Queue("--states=all --format=%j"));
    for (std::string name; std::getline(lines, name);) ++names[name];
    return names;
  }
  void ExpectNothingTwice() {
    for (const auto& [name, count] : Names()) EXPECT_EQ(count, 1) << name << "\n" << service_->Logs();
  }
  std::string Logs() { return service_->Logs() + slurm_->Logs(); }

  std::string folder_;
  std::unique_ptr<MiniSlurm> slurm_;
  std::unique_ptr<Service> service_;
};

TEST_F(AutoscaleSlurm, AllocationsComeWithTheWorkAndGoWithItThoughTheControllerIsKilled) {
  StartService(2);
  std::this_thread::sleep_for(std::chrono::seconds(1));
  EXPECT_TRUE(Names().empty()) << "no work, no allocation";
  const int64_t job = Submit(12, 2.0);
  ASSERT_TRUE(WaitUntil([&] { return !slurm_->Queue("").empty(); })) << Logs();
  slurm_->KillController();
  std::this_thread::sleep_for(std::chrono::seconds(1));
  slurm_->StartController();
  ASSERT_TRUE(WaitUntil([&] { return service_->client().Workers()->size() == 2; })) << Logs();
  const auto end = service_->client().WaitForJob(job, kPatience);
  ASSERT_TRUE(end.ok()) << end.status().ToString() << Logs();
  EXPECT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(service_->Counter("tasks_committed_total"), 13.0);
  EXPECT_TRUE(WaitUntil([&] { return AllGone(); })) << slurm_->Queue("--states=all") << Logs();
  ExpectNothingTwice();
  // The controller may have forgotten one whose answer it had given; then a third stands in for it.
  EXPECT_GE(Names().size(), 2u);
  EXPECT_LE(Names().size(), 3u) << Logs();
}

TEST_F(AutoscaleSlurm, AKilledCoordinatorFindsItsAllocationAgain) {
  StartService(1);
  const int64_t job = Submit(4, 1.0);
  ASSERT_TRUE(WaitUntil([&] { return !slurm_->Queue("").empty(); })) << Logs();
  for (int i = 0; i < 2; ++i) {
    service_->KillCoordinator();
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
    service_->StartCoordinator();
    std::this_thread::sleep_for(std::chrono::milliseconds(700));
  }
  const auto end = service_->client().WaitForJob(job, kPatience);
  ASSERT_TRUE(end.ok()) << end.status().ToString() << Logs();
  EXPECT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_TRUE(WaitUntil([&] { return AllGone(); })) << slurm_->Queue("--states=all") << Logs();
  EXPECT_EQ(Names().size(), 1u) << Logs();
  ExpectNothingTwice();
}

TEST_F(AutoscaleSlurm, WhatSlurmWouldRefuseIsSaidAtTheStart) {
  Process coordinator(
      {BinFolder() + "/realitygrad-coordinator", "--listen", "ipc://" + folder_ + "/s", "--db",
       folder_ + "/a.db", "--autoscale", "slurm", "--autoscale-sbatch=--partition=none"},
      folder_ + "/log");
  EXPECT_EQ(coordinator.WaitForExit(kPatience), 2);
  service_ = std::make_unique<Service>();
}

}  // namespace
}  // namespace rg::testing
