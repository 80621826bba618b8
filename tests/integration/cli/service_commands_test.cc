// The commands about jobs, artefacts and the database against a real service.
#include <gtest/gtest.h>
#include <signal.h>

#include <nlohmann/json.hpp>

#include "tests/integration/cli/program.h"
#include "tests/support/service/processes.h"

namespace rg {
namespace {

using nlohmann::json;
namespace pb = realitygrad::v1;

class ServiceCommands : public ::testing::Test {
 protected:
  Said Run(const std::string& arguments) {
    return RunProgram(scratch_, "--coordinator " + service_.endpoint() + " " + arguments);
  }
  json RunJson(const std::string& arguments) {
    const Said said = Run(arguments + " --output json");
    EXPECT_EQ(said.code, 0) << arguments << ": " << said.err;
    return json::parse(said.out, nullptr, false);
  }
  int64_t Submit(const std::string& label = "") {
    pb::JobSpec job;
    testing::AddTask(&job, "t", "echo", R"({"text": "x"})");
    if (!label.empty()) (*job.mutable_labels())["robot"] = label;
    return *service_.client().Submit(job);
  }

  ScratchFolder scratch_;
  testing::Service service_;
};

TEST_F(ServiceCommands, CancelAllReachesEveryJob) {
  constexpr int kJobs = 130;
  for (int i = 0; i < kJobs; ++i) Submit();
  const json cancelled = RunJson("job cancel all --reason 'the night is over'");
  EXPECT_EQ(cancelled["jobs"].size(), static_cast<size_t>(kJobs));
  EXPECT_EQ(service_.client().GetJob(1)->job().state(), pb::JOB_STATE_CANCELLED);
  EXPECT_EQ(service_.client().GetJob(1)->job().reason(), "the night is over");
}

TEST_F(ServiceCommands, JobsAreFilteredAndPaged) {
  for (const char* robot : {"arm", "leg", "arm"}) Submit(robot);
  service_.client().Act(3, pb::JOB_ACTION_CANCEL).status().ok();
  const auto ids = [&](const std::string& flags) {
    std::vector<int64_t> found;
    const json listed = RunJson("jobs " + flags);
    for (const auto& job : listed["jobs"]) found.push_back(job["id"]);
    return found;
  };
  using Ids = std::vector<int64_t>;
  EXPECT_EQ(ids("--label robot=arm"), (Ids{3, 1}));
  EXPECT_EQ(ids("--label robot --state queued"), (Ids{2, 1}));
  EXPECT_EQ(ids("--state queued --state cancelled --limit 2"), (Ids{3, 2}));
  EXPECT_EQ(ids("--before 2"), (Ids{1}));
  EXPECT_EQ(ids("--since 1h"), (Ids{3, 2, 1}));
  EXPECT_EQ(ids("--since 2999-01-01"), Ids{});
  for (const char* wrong : {"--state asleep", "--since yesterday", "--since 5parsec", "--label =x"}) {
    const Said said = Run(std::string("jobs ") + wrong);
    EXPECT_EQ(said.code, 2) << wrong;
    EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
  }
}

TEST_F(ServiceCommands, EventsTellWhatHappened) {
  const int64_t first = Submit(), second = Submit();
  service_.client().Act(first, pb::JOB_ACTION_CANCEL, "\x1b[31m").status().ok();
  service_.client().Act(second, pb::JOB_ACTION_CANCEL, "enough").status().ok();
  const json events = RunJson("events --job " + std::to_string(second))["events"];
  ASSERT_EQ(events.size(), 2u);
  EXPECT_EQ(events[0]["event"], "job.submitted");
  EXPECT_EQ(events[1]["event"], "job.cancelled");
  EXPECT_EQ(events[1]["detail"], "enough");
  EXPECT_EQ(RunJson("events --limit 1")["events"].size(), 1u);
  EXPECT_NE(Run("events").out.find("job.submitted"), std::string::npos);
  EXPECT_EQ(RunJson("events --after " + std::to_string(events[1]["id"].get<int>()))["events"].size(), 0u);
}

TEST_F(ServiceCommands, GarbageIsListedBeforeItIsRemovedAndPinnedIsKept) {
  pb::ArtifactInfo info;
  info.set_kind("data");
  const std::string loose = *service_.client().PutArtifact("loose", info);
  const std::string pinned = *service_.client().PutArtifact("pinned", info);
  EXPECT_EQ(Run("artifacts pin " + pinned.substr(0, 8)).code, 0);
  EXPECT_EQ(Run("artifacts gc --yes --dry-run").code, 2);
  const json would = RunJson("artifacts gc --older-than-days 0 --dry-run");
  EXPECT_EQ(would["dry_run"], true);
  ASSERT_EQ(would["removed"].size(), 1u);
  EXPECT_EQ(would["removed"][0]["sha256"], loose);
  EXPECT_TRUE(service_.client().ShowArtifact(loose).ok());
  EXPECT_EQ(RunJson("artifacts gc --older-than-days 0 --yes")["removed"].size(), 1u);
  EXPECT_FALSE(service_.client().ShowArtifact(loose).ok());
  EXPECT_EQ(Run("artifacts unpin " + pinned.substr(0, 8)).code, 0);
  EXPECT_EQ(RunJson("artifacts gc --older-than-days 0 --yes")["removed"].size(), 1u);
}

TEST_F(ServiceCommands, ABackupIsRestored) {
  const int64_t before = Submit();
  const json backup = RunJson("backup --name copy.db");
  const int64_t after = Submit();
  const std::string restore = "restore " + backup["path"].get<std::string>() + " --db ";
  EXPECT_EQ(Run(restore + service_.folder() + "/service.db --overwrite").code, 6)
      << "a coordinator runs on it";
  std::filesystem::create_symlink("service.db", service_.folder() + "/link.db");
  const Said by_link = Run(restore + service_.folder() + "/link.db --overwrite");
  EXPECT_EQ(by_link.code, 6) << "by a link too";
  EXPECT_NE(by_link.err.find("in use by process"), std::string::npos) << by_link.err;
  service_.KillCoordinator();
  EXPECT_EQ(Run(restore + service_.folder() + "/service.db").code, 1) << "there is one already";
  EXPECT_EQ(Run(restore + service_.folder() + "/service.db --overwrite").code, 0);
  service_.StartCoordinator();
  EXPECT_TRUE(service_.client().GetJob(before).ok());
  EXPECT_EQ(service_.client().GetJob(after).status().code(), StatusCode::kNotFound);
}

// Pages of an artefact's bytes, which nobody reads at a start.
TEST_F(ServiceCommands, ADamagedDatabaseDoesNotStartAndTheRemedyIsNamed) {
  const std::string database = service_.database();
  pb::ArtifactInfo info;
  info.set_kind("data");
  ASSERT_TRUE(service_.client().PutArtifact(std::string(2'000'000, 'x'), info).ok());
  const int64_t job = Submit();
  const json backup = RunJson("backup --name copy.db");
  EXPECT_EQ(RunJson("db check --db " + database)["ok"], true) << "while it works";
  service_.coordinator().Signal(SIGTERM);
  ASSERT_EQ(service_.coordinator().WaitForExit(60.0), 0);
  std::string bytes = ReadFile(database).value();
  for (size_t i = bytes.size() / 2; i < 3 * bytes.size() / 4; ++i) bytes[i] = static_cast<char>(i);
  ASSERT_TRUE(WriteFileAtomically(database, bytes).ok());

  EXPECT_FALSE(service_.TryStartCoordinator());
  EXPECT_EQ(service_.coordinator().WaitForExit(60.0), 1);
  const std::string log = service_.Logs();
  EXPECT_NE(log.find("realitygrad db check --db " + database), std::string::npos) << log;
  EXPECT_NE(log.find("realitygrad restore BACKUP --db " + database + " --overwrite"), std::string::npos) << log;
  const Said said = Run("db check --db " + database);
  EXPECT_EQ(said.code, 1);
  EXPECT_FALSE(said.out.empty());
  EXPECT_NE(said.err.find("realitygrad restore BACKUP --db " + database), std::string::npos) << said.err;
  const Said as_json = Run("db check --output json --db " + database);
  EXPECT_EQ(as_json.code, 1);
  EXPECT_FALSE(json::parse(as_json.out)["problems"].empty());

  EXPECT_EQ(Run("restore " + backup["path"].get<std::string>() + " --overwrite --db " + database).code, 0);
  service_.StartCoordinator();
  EXPECT_TRUE(service_.client().GetJob(job).ok());
  EXPECT_EQ(Run("db check --db " + database).code, 0);
  EXPECT_EQ(Run("db check --db " + database + ".none").code, 1);
}

}  // namespace
}  // namespace rg
