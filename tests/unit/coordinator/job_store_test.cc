// The SQLite store gives back what the reactor decided, after any history.
#include "coordinator/store/job_store.h"

#include <gtest/gtest.h>

#include "common/store/artifact_store.h"
#include "common/store/database.h"
#include "coordinator/core/reactor.h"
#include "coordinator/store/schema.h"
#include "realitygrad/v1/job.pb.h"
#include "tests/unit/coordinator/memory_store.h"
#include "tests/unit/coordinator/plans.h"

namespace rg::coordinator {
namespace {

std::unique_ptr<store::Database> OpenMemory() {
  auto database = store::Database::Open({.path = ":memory:"}, {CoordinatorSchema()});
  EXPECT_TRUE(database.ok()) << database.status().ToString();
  return *std::move(database);
}

// A random event that makes sense often enough, from what the state holds.
Event RandomEvent(Rng& rng, const State& state, int n) {
  const std::string instance = "i" + std::to_string(rng.Index(4));
  std::vector<Token> tokens = {0};
  for (const auto& [token, lease] : state.leases) tokens.push_back(token);
  std::sort(tokens.begin(), tokens.end());
  const Token token = tokens[rng.Index(tokens.size())];
  const auto lease = state.leases.find(token);
  const std::string holder = lease == state.leases.end() ? instance : lease->second.instance;
  const TaskId task = lease == state.leases.end() ? 0 : lease->second.task;
  const JobId job = static_cast<JobId>(1 + rng.Index(4));
  switch (rng.Index(14)) {
    case 0: {
      Submit submit{"r" + std::to_string(rng.Index(6)), RandomPlan(rng), nullptr, 0};
      auto plan = std::make_shared<JobPlan>(*submit.plan);
      if (task == 0) {
        for (const auto& [id, known] : state.jobs) {
          if (rng.Index(3) == 0) plan->after_jobs.push_back(id);
        }
        if (rng.Index(3) == 0) plan->time_limit_ns = static_cast<int64_t>(1 + rng.Index(30)) * 1'000'000'000;
        submit.plan = plan;
        return submit;
      }
      // By the task that holds the lease.
      plan->parent = task;
      submit.plan = plan, submit.lease = token;
      return submit;
    }
    case 1: {
      if (rng.Index(4) != 0) break;
      CommandJob change{job, JobCommand::kPriority, "r", 0};
      change.priority = static_cast<int32_t>(rng.Index(9)) - 4;
      return change;
    }
    case 13:
      return CommandJob{job, rng.Index(3) == 0 ? JobCommand::kCancel : JobCommand::kRetry, "r", 0};
    case 2:
      return CommandJob{job, rng.Index(3) == 0 ? JobCommand::kPause : JobCommand::kResume, "r", 0};
    case 3:
    case 4:
      return WorkerJoined{"w" + instance, instance, 3, {"robot:one"}, {"work", "other"}, {token},
                          false,          "h",      1, "v",           "k" + instance};
    case 5:
      return StartRequested{holder, token};
    case 6:
      return Failed{
          holder,          task, token, static_cast<Outcome>(2 + rng.Index(4)), "e" + std::to_string(n),
          rng.Index(4) > 0};
    case 7:
      return WorkerLeft{instance};
    case 8:
      return Tick{};
    default:
      break;
  }
  return Finished{holder, task, token};
}

TEST(JobStore, GivesBackTheStateAfterAnyHistory) {
  int commits = 0;
  for (uint64_t seed = 1; seed <= 40; ++seed) {
    Rng rng(seed);
    auto database = OpenMemory();
    JobStore store(database.get());
    MemoryStore memory;
    State state;
    for (int n = 0; n < 150; ++n) {
      const Now now{n * 700'000'000ll, 1'000 + n};
      Event event = RandomEvent(rng, state, n);
      memory.Complete(event, state);
      const Actions actions = On(event, state, now);
      ResultsByToken results;
      for (const Row& row : actions.rows) {
        if (const auto* commit = std::get_if<CommitResult>(&row)) results[commit->token] = {}, ++commits;
      }
      auto transaction = database->Begin();
      ASSERT_TRUE(transaction.ok());
      const Status applied = store.Apply(actions.rows, results);
      ASSERT_TRUE(applied.ok()) << applied.ToString();
      ASSERT_TRUE(transaction->Commit().ok());
      memory.Apply(actions.rows);
      for (const JobId id : std::exchange(state.ended, {})) Retire(state, id);
      if (n % 10 != 9) continue;
      auto loaded = store.Load();
      ASSERT_TRUE(loaded.ok()) << loaded.status().ToString();
      const auto restored = Describe(Restore(*loaded, state.options, now));
      const auto differences = Differences(Describe(state), restored);
      ASSERT_TRUE(differences.empty()) << "seed " << seed << " event " << n << ": " << differences.front();
      const auto stores = Differences(Describe(Restore(memory.Load(), state.options, now)), restored);
      ASSERT_TRUE(stores.empty()) << "seed " << seed << ": memory store: " << stores.front();
    }
  }
  EXPECT_GT(commits, 50);
}

TEST(JobStore, APlanSurvivesAsItWas) {
  auto database = OpenMemory();
  JobStore store(database.get());
  auto plan = std::make_shared<JobPlan>();
  plan->kind = "iteration";
  plan->tags = {"a", "b"};
  plan->labels = {{"robot", "mico2"}};
  plan->time_limit_ns = 90'000'000'000;
  plan->after_jobs = {3, 17};
  plan->tasks = {MakeTask("first"), MakeTask("second", {{0, true}})};
  plan->tasks[1].required_tags = {"robot:one", "x y"};
  plan->tasks[1].weight = 2.5;
  plan->tasks[1].at_most_once = true;
  realitygrad::v1::TaskSpec one, two;
  one.set_payload("one");
  two.set_payload(std::string("t\0o", 3));
  auto specs = std::make_shared<TaskSpecs>(TaskSpecs{one.SerializeAsString(), two.SerializeAsString()});
  ASSERT_TRUE(store.Apply({InsertJob{1, "r", 5, plan, specs}}, {}).ok());
  const auto loaded = store.Load();
  ASSERT_TRUE(loaded.ok());
  const JobPlan& back = *loaded->jobs.at(0).plan;
  EXPECT_EQ(back.tags, plan->tags);
  EXPECT_EQ(back.labels, plan->labels);
  EXPECT_EQ(back.time_limit_ns, plan->time_limit_ns);
  EXPECT_EQ(back.after_jobs, plan->after_jobs);
  EXPECT_EQ(back.tasks[1].required_tags, plan->tasks[1].required_tags);
  EXPECT_EQ(back.tasks[1].weight, 2.5);
  EXPECT_TRUE(back.tasks[1].at_most_once);
  ASSERT_EQ(back.tasks[1].parents.size(), 1u);
  EXPECT_TRUE(back.tasks[1].parents[0].optional);
  EXPECT_EQ(*store.Spec(MakeTaskId(1, 1)), specs->at(1));
}

TEST(JobStore, StartAndEndOfATaskSurviveARestart) {
  auto database = OpenMemory();
  JobStore store(database.get());
  State state;
  auto plan = std::make_shared<JobPlan>();
  plan->tasks = {MakeTask("first"), MakeTask("second", {{0, false}})};
  const auto happen = [&](const Event& event, int64_t wall_ns) {
    const Actions actions = On(event, state, Now{wall_ns, wall_ns});
    ResultsByToken results;
    for (const Row& row : actions.rows) {
      if (const auto* commit = std::get_if<CommitResult>(&row)) results[commit->token] = {};
    }
    ASSERT_TRUE(store.Apply(actions.rows, results).ok());
  };
  happen(Submit{"r", plan, nullptr, 0}, 10);
  happen(WorkerJoined{"w", "i", 1, {}, {plan->tasks[0].kind}, {}, false, "h", 1, "v"}, 20);
  ASSERT_EQ(state.leases.size(), 1u);
  happen(Finished{"i", MakeTaskId(1, 0), state.leases.begin()->first}, 30);
  const auto loaded = store.Load();
  ASSERT_TRUE(loaded.ok());
  const State restored = Restore(*loaded, state.options, Now{});
  const Job& back = restored.jobs.at(1);
  EXPECT_EQ(back.tasks[0].started_ns, 20);
  EXPECT_EQ(back.tasks[0].finished_ns, 30);
  EXPECT_EQ(back.tasks[1].started_ns, 30);
  EXPECT_EQ(back.tasks[1].finished_ns, 0);
}

TEST(JobStore, ACheckpointOfAnOlderLeaseDoesNotReplaceANewerOne) {
  auto database = OpenMemory();
  JobStore store(database.get());
  ASSERT_TRUE(store.SaveCheckpoint(1, 5, 1, "five").ok());
  ASSERT_TRUE(store.SaveCheckpoint(1, 4, 9, "four").ok());
  EXPECT_EQ(*store.Checkpoint(1), "five");
  ASSERT_TRUE(store.SaveCheckpoint(1, 5, 2, "again").ok());
  ASSERT_TRUE(store.SaveCheckpoint(1, 5, 1, "late").ok());
  EXPECT_EQ(*store.Checkpoint(1), "again");
}

TEST(JobStore, LogsAreBoundedPerTask) {
  auto database = OpenMemory();
  JobStore store(database.get());
  for (int i = 0; i < JobStore::kMaxLogLines + 1500; ++i)
    ASSERT_TRUE(store.AppendLog({7, 1, i, 0, "line"}).ok());
  ASSERT_TRUE(store.AppendLog({8, 1, 0, 0, "other"}).ok());
  const auto lines = store.Logs(7, 7, 0, 1'000'000);
  ASSERT_TRUE(lines.ok());
  EXPECT_LE(lines->size(), static_cast<size_t>(JobStore::kMaxLogLines) + 500);
  EXPECT_EQ(lines->back().wall_ns, JobStore::kMaxLogLines + 1499);
  EXPECT_EQ(store.Logs(8, 8, 0, 10)->size(), 1u);
}

TEST(JobStore, JobsFromBeforeThereWasAListOfInputsGetTheirs) {
  auto database =
      *store::Database::Open({.path = ":memory:"}, {store::ArtifactStore::Schema(), CoordinatorSchema()});
  JobStore store(database.get());
  realitygrad::v1::TaskSpec spec;
  const std::string hash(64, 'a');
  spec.add_inputs()->set_artifact(hash);
  auto specs = std::make_shared<TaskSpecs>(TaskSpecs{spec.SerializeAsString()});
  const auto plan = MakePlan({MakeTask("t")});
  ASSERT_TRUE(store.Apply({InsertJob{1, "r", 5, plan, specs}}, {}).ok());
  ASSERT_TRUE(database->Execute("DELETE FROM job_inputs; UPDATE jobs SET inputs_listed=0").ok());
  ASSERT_TRUE(store.ListMissingInputs().ok());
  const auto referred = [&](int64_t ended_before_ns) {
    auto rows = *database->Prepare(JobStore::ArtifactReferences(ended_before_ns)[0]);
    return *rows.Step() ? rows.Text(0) : "";
  };
  EXPECT_EQ(referred(0), hash);
  EXPECT_EQ(referred(1'000'000), hash) << "it has not ended";
  ASSERT_TRUE(database->Execute("UPDATE jobs SET finished_ns=10").ok());
  EXPECT_EQ(referred(10), hash);
  EXPECT_EQ(referred(11), "");
}

}  // namespace
}  // namespace rg::coordinator
