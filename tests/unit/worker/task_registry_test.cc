#include "worker/task_registry.h"

#include <gtest/gtest.h>

namespace rg::worker {
namespace {

Result<TaskOutputs> Nothing(const TaskInput&, TaskContext&) { return TaskOutputs{}; }

TEST(TaskRegistry, FindsWhatWasRegisteredAndNothingElse) {
  TaskRegistry registry;
  registry.Register("b", Nothing);
  registry.Register("a", Nothing);
  EXPECT_NE(registry.Find("a"), nullptr);
  EXPECT_EQ(registry.Find("c"), nullptr);
  EXPECT_EQ(registry.kinds(), (std::vector<std::string>{"a", "b"}));
}

TEST(TaskRegistryDeathTest, AKindIsRegisteredOnce) {
  TaskRegistry registry;
  registry.Register("a", Nothing);
  EXPECT_DEATH(registry.Register("a", Nothing), "registered twice");
}

TEST(TaskInput, AMissingInputIsNamed) {
  TaskInput input;
  input.task_name = "train";
  input.kind = "policy.train";
  for (const char* bytes : {"one", "two"}) {
    InputArtifact shard;
    shard.name = "shard";
    shard.bytes = bytes;
    input.inputs.push_back(shard);
  }
  EXPECT_EQ(input.All("shard").size(), 2u);
  EXPECT_EQ(input.Find("shard")->bytes, "one");
  const auto missing = input.Require("model");
  ASSERT_FALSE(missing.ok());
  EXPECT_EQ(missing.status().code(), StatusCode::kInvalid);
  EXPECT_NE(missing.status().message().find("'model'"), std::string::npos);
}

TEST(TaskFailure, BadInputIsNotRetriedATroubledHostIs) {
  EXPECT_FALSE(TaskFailureIsRetryable(StatusCode::kInvalid));
  EXPECT_TRUE(TaskFailureIsRetryable(StatusCode::kUnavailable));
  EXPECT_TRUE(TaskFailureIsRetryable(StatusCode::kInternal));
}

}  // namespace
}  // namespace rg::worker
