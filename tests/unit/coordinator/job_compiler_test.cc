#include "coordinator/server/job_compiler.h"

#include <gtest/gtest.h>

#include <limits>

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;

pb::TaskSpec* Add(pb::JobSpec* job, const std::string& name, const std::string& stage = "") {
  pb::TaskSpec* task = job->add_tasks();
  task->set_name(name);
  task->set_kind("work");
  task->set_stage(stage);
  return task;
}

void Reads(pb::TaskSpec* task, const std::string& parent, bool optional = false) {
  pb::InputSpec* input = task->add_inputs();
  input->set_name("in");
  input->mutable_task_output()->set_task(parent);
  input->set_optional(optional);
}

void ExpectRefused(const pb::JobSpec& job, const std::string& part) {
  const auto compiled = CompileJob(job);
  ASSERT_FALSE(compiled.ok());
  EXPECT_EQ(compiled.status().code(), StatusCode::kInvalid);
  EXPECT_NE(compiled.status().message().find(part), std::string::npos) << compiled.status().message();
}

TEST(CompileJob, AStageInputDependsOnEveryTaskOfTheStage) {
  pb::JobSpec job;
  Add(&job, "s0", "shards");
  Add(&job, "s1", "shards");
  pb::InputSpec* input = Add(&job, "train")->add_inputs();
  input->set_name("shards");
  input->mutable_stage_outputs()->set_stage("shards");
  const auto compiled = CompileJob(job);
  ASSERT_TRUE(compiled.ok()) << compiled.status().ToString();
  EXPECT_EQ(compiled->plan->tasks[2].parents.size(), 2u);
  EXPECT_EQ(compiled->specs->size(), 3u);
}

TEST(CompileJob, AParentIsOptionalOnlyIfEveryMentionIs) {
  pb::JobSpec job;
  Add(&job, "a");
  pb::TaskSpec* both = Add(&job, "b");
  Reads(both, "a", true);
  both->add_after("a");
  Reads(Add(&job, "c"), "a", true);
  const auto compiled = CompileJob(job);
  ASSERT_TRUE(compiled.ok());
  ASSERT_EQ(compiled->plan->tasks[1].parents.size(), 1u);
  EXPECT_FALSE(compiled->plan->tasks[1].parents[0].optional);
  EXPECT_TRUE(compiled->plan->tasks[2].parents[0].optional);
}

TEST(CompileJob, NamesAndLabelsThatListingsShowAreOfBoundedSize) {
  pb::JobSpec job;
  Add(&job, "a");
  job.set_name(std::string(128, 'n'));
  for (int i = 0; i < 32; ++i) (*job.mutable_labels())["label" + std::to_string(i)] = std::string(128, 'v');
  EXPECT_TRUE(CompileJob(job).ok());
  pb::JobSpec named = job, labelled = job, valued = job;
  named.set_name(std::string(129, 'n'));
  ExpectRefused(named, "the job's name has 129 bytes, at most 128");
  (*labelled.mutable_labels())["one more"] = "";
  ExpectRefused(labelled, "33 labels, at most 32");
  (*valued.mutable_labels())["label0"] = std::string(129, 'v');
  ExpectRefused(valued, "the label label0 of the job has 129 bytes");
}

TEST(CompileJob, RefusesWhatCannotRunAndNamesIt) {
  ExpectRefused({}, "at least one task");
  pb::JobSpec twice;
  Add(&twice, "a"), Add(&twice, "a");
  ExpectRefused(twice, "two tasks are named 'a'");
  pb::JobSpec circle;
  Reads(Add(&circle, "a"), "b");
  Reads(Add(&circle, "b"), "a");
  ExpectRefused(circle, "circle");
  pb::JobSpec unknown;
  Reads(Add(&unknown, "a"), "ghost");
  ExpectRefused(unknown, "'ghost'");
  pb::JobSpec itself;
  Reads(Add(&itself, "a"), "a");
  ExpectRefused(itself, "itself");
  pb::JobSpec hash;
  Add(&hash, "a")->add_inputs()->set_artifact("xyz");
  ExpectRefused(hash, "task 'a'");
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  for (const double none : {-1.0, nan, infinity}) {
    pb::JobSpec weight, timeout, limit;
    Add(&weight, "a")->set_weight(none);
    Add(&timeout, "a")->set_timeout_s(none);
    Add(&limit, "a");
    limit.set_time_limit_s(none);
    ExpectRefused(weight, "weight");
    ExpectRefused(timeout, "timeout_s");
    ExpectRefused(limit, "time limit");
  }
  pb::JobSpec priority, after;
  Add(&priority, "a")->set_priority(1'000'001);
  ExpectRefused(priority, "priority 1000001");
  Add(&after, "a");
  after.add_after_jobs(0);
  ExpectRefused(after, "no job 0");
  after.set_after_jobs(0, 5);
  const auto of_task = CompileJob(after, MakeTaskId(3, 0));
  EXPECT_EQ(of_task.status().code(), StatusCode::kInvalid) << "its task would wait for itself";
}

}  // namespace
}  // namespace rg::coordinator
