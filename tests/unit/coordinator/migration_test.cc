// Databases of every earlier version (fixtures/README.md) open with this program: with a copy made before,
// nothing lost, and what was under way goes on.
#include <gtest/gtest.h>
#include <sqlite3.h>

#include <cstdlib>
#include <filesystem>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/store/artifact_store.h"
#include "common/store/parameter_store.h"
#include "common/store/restore.h"
#include "coordinator/core/invariants.h"
#include "coordinator/server/past_jobs.h"
#include "coordinator/store/job_store.h"
#include "coordinator/store/schema.h"

namespace rg::coordinator {
namespace {

class Migration : public ::testing::TestWithParam<int> {
 protected:
  Migration() : folder_("/tmp/rg-migration-" + RandomHex(6)), path_(folder_ + "/service.db") {
    std::filesystem::create_directories(folder_);
  }
  ~Migration() override { std::filesystem::remove_all(folder_); }

  void Write(const std::string& name) {
    const char* source = std::getenv("RG_SOURCE_DIR");
    const std::string fixtures =
        std::string(source != nullptr ? source : ".") + "/tests/unit/coordinator/fixtures/v";
    std::string sql;
    for (int v = 1; v <= GetParam(); ++v) sql += ReadFile(fixtures + std::to_string(v) + ".sql").value();
    sql += ReadFile(fixtures + std::to_string(GetParam()) + "_" + name + ".sql").value() + "COMMIT;";
    sqlite3* raw = nullptr;
    ASSERT_EQ(sqlite3_open(path_.c_str(), &raw), SQLITE_OK);
    char* error = nullptr;
    EXPECT_EQ(sqlite3_exec(raw, sql.c_str(), nullptr, nullptr, &error), SQLITE_OK) << error;
    sqlite3_close(raw);
  }
  std::unique_ptr<store::Database> Open() {
    auto database = store::Database::Open(
        {.path = path_},
        {store::ArtifactStore::Schema(), store::ParameterStore::Schema(), CoordinatorSchema()});
    EXPECT_TRUE(database.ok()) << database.status().ToString();
    return database.ok() ? *std::move(database) : nullptr;
  }
  std::vector<std::string> Copies() const {
    std::vector<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder_)) {
      const std::string name = entry.path().filename().string();
      if (name.find(".before-") != std::string::npos) names.push_back(name);
    }
    return names;
  }

  std::string folder_, path_;
};

TEST_P(Migration, JobsThatAreOverAreListedAndShownAsTheyWere) {
  Write("ended");
  const auto database = Open();
  ASSERT_NE(database, nullptr);
  EXPECT_TRUE(database->CheckIntegrity().ok());
  EXPECT_EQ(database->identity().size(), 32u);
  JobStore store(database.get());
  const auto loaded = store.Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status().ToString();
  EXPECT_TRUE(loaded->jobs.empty());
  EXPECT_EQ(loaded->last_job, 3);
  EXPECT_GE(loaded->last_token, 6u);
  std::vector<JobRow> rows;
  ASSERT_TRUE(store.ListJobs({}, [&](const JobRow& row) { return rows.push_back(row), true; }).ok());
  ASSERT_EQ(rows.size(), 3u);
  EXPECT_EQ(rows[2].record.phase, JobPhase::kSucceeded);
  EXPECT_EQ(rows[2].total, 1u);
  EXPECT_EQ(rows[2].counts.succeeded, 1u);
  EXPECT_EQ(rows[2].counts.progress, 1.0);
  EXPECT_EQ(rows[1].record.phase, JobPhase::kFailed);
  EXPECT_EQ(rows[1].total, 2u);
  EXPECT_EQ(rows[1].counts.failed, 1u);
  realitygrad::v1::GetJobRequest request;
  request.set_job(2);
  request.set_with_tasks(true);
  request.set_with_attempts(true);
  const auto shown = DescribePastJob(store, request, 1 << 20);
  ASSERT_TRUE(shown.ok()) << shown.status().ToString();
  ASSERT_EQ(shown->tasks_size(), 2);
  EXPECT_GT(shown->tasks(0).attempt_list_size(), 0);
  EXPECT_FALSE(shown->tasks(0).attempt_list(0).error().empty());
  EXPECT_EQ(store.Logs(MakeTaskId(1, 0), MakeTaskId(3, 100), 0, 100)->size(), 6u);
}

TEST_P(Migration, WhatWasUnderWayGoesOn) {
  Write("running");
  const auto database = Open();
  ASSERT_NE(database, nullptr);
  JobStore store(database.get());
  ASSERT_TRUE(store.ListMissingInputs().ok());
  const auto loaded = store.Load();
  ASSERT_TRUE(loaded.ok()) << loaded.status().ToString();
  ASSERT_EQ(loaded->jobs.size(), 1u);
  State state = Restore(*loaded, Options{}, Now{});
  EXPECT_TRUE(BrokenInvariants(state).empty());
  const Job& job = state.jobs.at(1);
  EXPECT_EQ(job.succeeded, 3u);
  EXPECT_EQ(state.leases.size(), 1u);
  const auto artifacts = store::ArtifactStore::Open(database.get(), &RealClock());
  ASSERT_TRUE(artifacts.ok());
  EXPECT_EQ((*artifacts)->List()->size(), 3u);
  EXPECT_TRUE((*artifacts)->Verify()->damaged.empty());
}

TEST_P(Migration, ACopyIsMadeBeforeAndOpensWithTheOldTables) {
  Write("ended");
  ASSERT_NE(Open(), nullptr);
  const auto copies = Copies();
  ASSERT_EQ(copies.size(), 1u);
  const std::string changed = GetParam() < 4 ? "artifacts-2-parameters-3-coordinator-" : "parameters-3-coordinator-";
  EXPECT_EQ(copies[0].rfind("service.db.before-" + changed, 0), 0u) << copies[0];
  const auto old = store::Database::Open({.path = folder_ + "/" + copies[0], .read_only = true}, {});
  ASSERT_TRUE(old.ok()) << old.status().ToString();
  EXPECT_EQ(*(*old)->ModuleVersion("coordinator"), GetParam());
  EXPECT_EQ((*old)->identity(), "");
  ASSERT_NE(Open(), nullptr);
  EXPECT_EQ(Copies().size(), 1u) << "only when something is changed";
}

TEST_P(Migration, ABackupIsRestoredWithThisVersionsTables) {
  Write("ended");
  const std::string backup = folder_ + "/backup.db";
  std::filesystem::rename(path_, backup);
  const std::vector<store::Module> modules = {store::ArtifactStore::Schema(), store::ParameterStore::Schema(),
                                              CoordinatorSchema()};
  const Status restored = store::RestoreDatabase({backup, path_}, modules);
  ASSERT_TRUE(restored.ok()) << restored.ToString();
  EXPECT_TRUE(Copies().empty()) << "the backup is there";
  const auto database = store::Database::Open({.path = path_, .read_only = true}, modules);
  ASSERT_TRUE(database.ok()) << database.status().ToString();
  EXPECT_EQ((*database)->identity().size(), 32u);
  int jobs = 0;
  ASSERT_TRUE(JobStore(database->get()).ListJobs({}, [&](const JobRow&) { return ++jobs, true; }).ok());
  EXPECT_EQ(jobs, 3);
  EXPECT_EQ(*(*store::Database::Open({.path = backup, .read_only = true}, {}))->ModuleVersion("coordinator"), GetParam())
      << "the backup stays as it was";
}

INSTANTIATE_TEST_SUITE_P(FromVersion, Migration, ::testing::Values(1, 2, 3, 4),
                         [](const auto& info) { return "V" + std::to_string(info.param); });

}  // namespace
}  // namespace rg::coordinator
