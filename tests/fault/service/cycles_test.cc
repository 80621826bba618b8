// kill -9 of coordinator and workers, at random times and at named points, and power cuts, again and again
// while jobs are submitted and run: what was acknowledged is there and ends, nothing is committed twice,
// every output is what it should be. In batches, each a service of its own under its own seed.
//
// RG_CYCLES and RG_CUTS say how many there are (the suite `full`: 1,000 and 200). With RG_PROGRESS=FILE
// batches that are done are noted there, and a run that was broken off goes on with the next.
#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <set>
#include <thread>

#include "common/base/rng.h"
#include "common/store/database.h"
#include "tests/support/base/batches_done.h"
#include "tests/support/service/cuts.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 120.0;
constexpr int kCyclesPerBatch = 20;
constexpr int kShards = 4;

void SleepMs(uint64_t ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }

class Batch {
 public:
  Batch(uint64_t seed, bool cuts) : rng_(seed), cuts_(cuts) {
    service_.StartWorker("a", 2);
    service_.StartWorker("b", 2);
    if (cuts_) {  // from the first write on, or there would be nothing to go back to
      service_.KillCoordinator();
      std::filesystem::remove(database());
      for (const char* suffix : {"-wal", "-shm"}) std::filesystem::remove(database() + suffix);
      StartCoordinator("");
    }
  }

  void Run(int cycles) {
    for (int cycle = 0; cycle < cycles && !::testing::Test::HasFailure(); ++cycle) RunCycle(cycle);
    if (!::testing::Test::HasFailure()) CheckAll();
  }
  int64_t lost_bytes() const { return lost_bytes_; }
  int named() const { return named_; }

 private:
  std::string database() const { return service_.folder() + "/service.db"; }

  // At a named point it may be killed before it listens.
  void StartCoordinator(const std::string& kill) {
    const UnderShim shim(service_.folder() + "/service.db", kill, cuts_);
    kill.empty() ? service_.StartCoordinator() : (void)service_.TryStartCoordinator();
  }

  static pb::JobSpec Job(int number) {
    pb::JobSpec job;
    for (int i = 0; i < kShards; ++i) {
      AddTask(&job, "t" + std::to_string(i), "echo",
              "{\"text\": \"" + std::to_string(100 * number + i) + ";\"}")
          ->set_stage("s");
    }
    AddStageInput(AddTask(&job, "join", "echo"), "all", "s");
    return job;
  }
  static std::string Expected(int number) {
    std::string text;
    for (int i = 0; i < kShards; ++i) text += std::to_string(100 * number + i) + ";";
    return text;
  }

  // One kill while a job is submitted and the ones before it run.
  void RunCycle(int number) {
    const uint64_t kind = rng_.Index(4);
    const std::string point = std::string(rng_.Index(2) == 0 ? "before_sync" : "after_sync") + ":" +
                              std::to_string(1 + rng_.Index(12));
    const uint64_t delay_ms = rng_.Index(60);
    std::thread killer([&] {
      if (kind == 0 && !cuts_) {
        SleepMs(delay_ms);
        const std::string name = rng_.Index(2) == 0 ? "a" : "b";
        service_.worker(name).KillNow();
        service_.StartWorker(name, 2);
      } else if (kind == 1) {
        service_.KillCoordinator();
        StartCoordinator(point);
        ++named_;
        constexpr double kWork = 3.0;  // unless it comes to the point before
        service_.coordinator().WaitForExit(kWork);
        Restart();
      } else {
        SleepMs(delay_ms);
        Restart();
      }
    });
    const auto client = service_.NewClient();
    const auto id = client->Submit(Job(number), "cycle" + std::to_string(number));
    killer.join();
    ASSERT_TRUE(id.ok()) << id.status().ToString() << service_.Logs();
    jobs_.push_back(*id);
  }

  void Restart() {
    service_.KillCoordinator();
    if (cuts_) lost_bytes_ += RestoreSynced(database());
    StartCoordinator("");
  }

  void CheckAll() {
    auto& client = service_.client();
    EXPECT_EQ(std::set<int64_t>(jobs_.begin(), jobs_.end()).size(), jobs_.size());
    for (size_t n = 0; n < jobs_.size(); ++n) {
      const auto end = client.WaitForJob(jobs_[n], kPatience);
      ASSERT_TRUE(end.ok()) << end.status().ToString() << service_.Logs();
      ASSERT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED) << end->job().reason() << service_.Logs();
      const auto reply = client.GetJob(jobs_[n], true, true);
      ASSERT_TRUE(reply.ok()) << reply.status().ToString();
      for (const pb::TaskInfo& task : reply->tasks()) {
        int succeeded = 0;
        for (const auto& attempt : task.attempt_list())
          succeeded += attempt.outcome() == pb::ATTEMPT_OUTCOME_SUCCEEDED;
        EXPECT_EQ(succeeded, 1) << "job " << jobs_[n] << " task " << task.name();
        EXPECT_EQ(task.outputs_size(), 1);
      }
      EXPECT_EQ(*client.GetArtifact(FindTask(*reply, "join")->outputs(0).sha256()),
                Expected(static_cast<int>(n)));
    }
    EXPECT_EQ(client.ListAllJobs()->size(), jobs_.size()) << "no submit made two jobs";
    const auto damage = client.VerifyArtifacts();
    ASSERT_TRUE(damage.ok()) << damage.status().ToString();
    EXPECT_EQ(damage->damaged_size(), 0);
    service_.KillCoordinator();
    const auto file = store::Database::Open({.path = database()}, {});
    ASSERT_TRUE(file.ok()) << file.status().ToString();
    EXPECT_TRUE((*file)->CheckIntegrity().ok());
  }

  Rng rng_;
  const bool cuts_;
  Service service_{300};
  std::vector<int64_t> jobs_;
  int64_t lost_bytes_ = 0;
  int named_ = 0;
};

void RunBatches(const std::string& suite, int cycles, bool cuts) {
  RG_NEEDS_PRELOADING();
  BatchesDone done(suite);
  int64_t lost = 0;
  int named = 0, batch = 0, played = 0;
  for (int left = cycles; left > 0; left -= kCyclesPerBatch, ++batch) {
    if (done.Find(batch)) continue;
    Batch one(1000 + static_cast<uint64_t>(batch) + (cuts ? 500'000 : 0), cuts);
    one.Run(std::min(left, kCyclesPerBatch));
    if (::testing::Test::HasFailure()) return;
    lost += one.lost_bytes();
    named += one.named();
    played += std::min(left, kCyclesPerBatch);
    done.Note(batch);
  }
  done.Forget();
  std::printf("%d cycles, %d of them at named points, %lld bytes lost with the power\n", played, named,
              static_cast<long long>(lost));
}

TEST(KillCycles, NothingAcknowledgedIsLostOrCommittedTwice) {
  RunBatches("kills", CountAsked("RG_CYCLES", 20), false);
}

TEST(PowerCuts, NothingAcknowledgedIsLostOrCommittedTwice) { RunBatches("cuts", CountAsked("RG_CUTS", 10), true); }

}  // namespace
}  // namespace rg::testing
