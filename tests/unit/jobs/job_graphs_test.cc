#include "services/jobs/job_graphs.h"

#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "services/jobs/kinds.h"
#include "services/jobs/options_json.h"

namespace rg::jobs {
namespace {

namespace pb = ::realitygrad::v1;

IterationInputs Model() { return {.model = std::string(64, 'a')}; }

// Every reference must name a task or stage that stands earlier in the job.
void ExpectWellFormed(const pb::JobSpec& job) {
  std::set<std::string> names, stages;
  for (const pb::TaskSpec& task : job.tasks()) {
    for (const pb::InputSpec& input : task.inputs()) {
      EXPECT_TRUE(!input.has_task_output() || names.count(input.task_output().task())) << task.name();
      EXPECT_TRUE(!input.has_stage_outputs() || stages.count(input.stage_outputs().stage())) << task.name();
      EXPECT_TRUE(input.source_case() != pb::InputSpec::kArtifact || input.artifact().size() == 64)
          << task.name();
    }
    EXPECT_TRUE(names.insert(task.name()).second) << "two tasks named " << task.name();
    stages.insert(task.stage());
  }
}

TEST(JobGraphs, ShardsCoverEveryTrajectoryOnce) {
  IterationOptions options;
  options.trajectories.count = 47;
  options.trajectories.shard_size = 10;
  const pb::JobSpec job = CompileTrajectories(options, Model());
  ASSERT_EQ(job.tasks_size(), 5);
  uint64_t next = 0;
  for (const pb::TaskSpec& task : job.tasks()) {
    pb::TrajectoriesPayload payload;
    ASSERT_TRUE(payload.ParseFromString(task.payload()));
    EXPECT_EQ(payload.first(), next);
    next += payload.count();
  }
  EXPECT_EQ(next, 47u);
}

TEST(JobGraphs, IterationIsWellFormedAndInOrder) {
  const pb::JobSpec job = CompileIteration({}, Model());
  ExpectWellFormed(job);
  EXPECT_EQ(job.tasks(job.tasks_size() - 1).kind(), kKindConclude);
}

TEST(JobGraphs, ADiagnosedIterationIdentifiesBothModelsAndAdoptsOne) {
  IterationOptions options;
  options.diagnosis.on = true;
  IterationInputs inputs = Model();
  inputs.nominal = std::string(64, 'n'), inputs.identified = std::string(64, 'i');
  inputs.earlier = {std::string(64, '1'), std::string(64, '2')};
  const pb::JobSpec job = CompileIteration(options, inputs);
  ExpectWellFormed(job);
  const auto from = [](const pb::TaskSpec& task, const std::string& name) {
    std::vector<std::string> sources;
    for (const pb::InputSpec& input : task.inputs()) {
      if (input.name() == name)
        sources.push_back(input.has_stage_outputs() ? input.stage_outputs().stage()
                                                    : input.artifact().substr(0, 1));
    }
    return sources;
  };
  using Sources = std::vector<std::string>;
  int alone = 0, refining = 0;
  for (const pb::TaskSpec& task : job.tasks()) {
    if (task.kind() == kKindTrajectories || task.kind() == kKindRollout) {
      EXPECT_EQ(from(task, kInputModel), Sources{"a"}) << task.name();
    }
    if (task.kind() == kKindIdentify && task.stage().starts_with(kStageIdentify)) {
      ++alone;
      EXPECT_EQ(from(task, kInputModel), Sources{"i"}) << "identification alone goes its own way";
    }
    if (task.kind() == kKindIdentify && task.stage().starts_with(kStageRefine)) {
      ++refining;
      EXPECT_EQ(from(task, kInputModel), Sources{kStageDiagnose});
    }
    if (task.kind() == kKindDiagnose || task.kind() == kKindAdopt) {
      EXPECT_EQ(from(task, kInputRecording), (Sources{"1", "2", kStageRollout})) << "oldest first";
    }
  }
  EXPECT_EQ(alone, options.identify.chains * options.identify.rounds);
  EXPECT_EQ(refining, alone);
  EXPECT_EQ(job.tasks(job.tasks_size() - 1).kind(), kKindAdopt);

  const IterationOptions read = OptionsFromJson(OptionsToJson(options));
  EXPECT_TRUE(read.diagnosis.on);
  nlohmann::json old = OptionsToJson(options);
  old.erase("diagnosis");
  EXPECT_FALSE(OptionsFromJson(old).diagnosis.on) << "runs from before there was one go on";
}

TEST(JobGraphs, EveryPolicyLearnsFromTheAnswersToAllBefore) {
  IterationOptions options;
  options.train.aggregations = 2;
  const pb::JobSpec job = CompileIteration(options, Model());
  std::vector<const pb::TaskSpec*> policies;
  std::set<uint64_t> seeds;
  for (const pb::TaskSpec& task : job.tasks()) {
    if (task.kind() == kKindTrain) policies.push_back(&task);
    pb::TrajectoriesPayload payload;
    if (task.kind() == kKindTrajectories || task.kind() == kKindAggregate || task.kind() == kKindExamine) {
      ASSERT_TRUE(payload.ParseFromString(task.payload()));
      seeds.insert(payload.seed());
    }
    if (task.kind() == kKindRollout || task.kind() == kKindExamine) {
      for (const auto& input : task.inputs()) {
        if (input.name() != kInputPolicy) continue;
        EXPECT_EQ(input.stage_outputs().stage(), policies.back()->stage());
      }
    }
  }
  ASSERT_EQ(policies.size(), 3u + kFurtherAggregations);
  EXPECT_EQ(policies[2]->inputs_size(), 1 + 3) << "model, the expert's shards, two rounds of answers";
  EXPECT_EQ(policies[3]->inputs_size(), 1 + 4 + 2) << "one round more, what the examination said, the policy before";
  EXPECT_EQ(seeds.size(), 4u + kFurtherAggregations) << "no start/goal pair is used twice";
  options.train.aggregations = 0;
  options.train.examination_pairs = 0;
  const pb::JobSpec plain = CompileIteration(options, Model());
  for (const pb::TaskSpec& task : plain.tasks())
    EXPECT_TRUE(task.kind() != kKindAggregate && task.kind() != kKindExamine);
}

TEST(JobGraphs, ARolloutWaitsForTheLastExamination) {
  IterationOptions options;
  const auto examined_in = [&options] {
    std::string stage;
    const pb::JobSpec job = CompileIteration(options, Model());
    for (const pb::TaskSpec& task : job.tasks()) {
      if (task.kind() != kKindRollout) continue;
      for (const auto& input : task.inputs()) {
        if (input.name() == kInputExamination) stage = input.stage_outputs().stage();
      }
    }
    return stage;
  };
  EXPECT_EQ(examined_in(), "examination 3/3");
  options.rollout.controller = "mpc";
  EXPECT_EQ(examined_in(), "") << "no policy drives";
  options.rollout.controller = "policy", options.train.examination_pairs = 0;
  EXPECT_EQ(examined_in(), "");
}

TEST(JobGraphs, TheCurriculumStartsNearAndGrowsToTheWhole) {
  IterationOptions options;
  options.curriculum = {.on = true, .first = 0.5, .growth = 1.5};
  const auto reach = [&](int iteration) {
    options.iteration = iteration;
    pb::TrajectoriesPayload payload;
    EXPECT_TRUE(payload.ParseFromString(CompileIteration(options, Model()).tasks(0).payload()));
    return payload.reach();
  };
  EXPECT_DOUBLE_EQ(reach(1), 0.5 * 0.6);
  EXPECT_DOUBLE_EQ(reach(2), 0.75 * 0.6);
  EXPECT_DOUBLE_EQ(reach(9), 0.6);
}

TEST(JobGraphs, RolloutRunsAtMostOnceAndOnlyBesideItsRobot) {
  IterationOptions options;
  options.robot = "mico2";
  const pb::JobSpec job = CompileIteration(options, Model());
  int rollouts = 0;
  for (const pb::TaskSpec& task : job.tasks()) {
    if (task.kind() != kKindRollout) continue;
    ++rollouts;
    EXPECT_EQ(task.max_attempts(), 1u);
    ASSERT_EQ(task.required_tags_size(), 1);
    EXPECT_EQ(task.required_tags(0), "robot:mico2");
  }
  EXPECT_EQ(rollouts, 1);
}

TEST(JobGraphs, ChainsReadAllChainsOfTheRoundBefore) {
  IterationOptions options;
  options.identify.chains = 3;
  options.identify.rounds = 2;
  IterationInputs inputs = Model();
  inputs.recording = std::string(64, 'b');
  const pb::JobSpec job = CompileIdentify(options, inputs);
  ExpectWellFormed(job);
  ASSERT_EQ(job.tasks_size(), 7);
  const pb::TaskSpec& second_round = job.tasks(3);
  std::map<std::string, const pb::InputSpec*> by_name;
  for (const auto& input : second_round.inputs()) by_name[input.name()] = &input;
  EXPECT_EQ(by_name.at(kInputChain)->task_output().task(), job.tasks(0).name());
  EXPECT_EQ(by_name.at(kInputOthers)->stage_outputs().stage(), job.tasks(0).stage());
}

TEST(JobGraphs, BudgetIsSharedByTheRounds) {
  IterationOptions options;
  options.identify.rounds = 4;
  options.identify.budget_s = 20;
  IterationInputs inputs = Model();
  inputs.recording = std::string(64, 'b');
  pb::IdentifyPayload payload;
  ASSERT_TRUE(payload.ParseFromString(CompileIdentify(options, inputs).tasks(0).payload()));
  EXPECT_DOUBLE_EQ(payload.budget_s(), 5.0);
}

TEST(JobGraphs, LinksAreIdentifiedAsBodiesUnlessRawIsAskedFor) {
  IterationOptions options;
  IterationInputs inputs = Model();
  inputs.recording = std::string(64, 'b');
  const auto parametrisation = [&] {
    pb::IdentifyPayload payload;
    EXPECT_TRUE(payload.ParseFromString(CompileIdentify(options, inputs).tasks(0).payload()));
    return payload.parametrisation();
  };
  EXPECT_EQ(parametrisation(), pb::IDENTIFY_PARAMETRISATION_LOG_CHOLESKY);
  options.identify.parametrisation = "raw";
  EXPECT_EQ(parametrisation(), pb::IDENTIFY_PARAMETRISATION_RAW);
  options.identify.parametrisation = "nice";
  EXPECT_EQ(Validate(options).message(), "parametrisation is 'nice', must be one of log-cholesky, raw");

  nlohmann::json old = OptionsToJson(IterationOptions{});
  old["identify"].erase("parametrisation");
  EXPECT_EQ(OptionsFromJson(old).identify.parametrisation, "raw") << "runs from before there was a choice";
}

pb::RolloutPayload RolloutOf(const IterationOptions& options) {
  pb::RolloutPayload payload;
  const pb::JobSpec job = CompileIteration(options, Model());
  for (const pb::TaskSpec& task : job.tasks()) {
    if (task.name() != "rollout") continue;
    EXPECT_TRUE(payload.ParseFromString(task.payload()));
  }
  return payload;
}

TEST(JobGraphs, ARolloutsJobWantsAllOfItAnIterationGoesOnWithWhatThereIs) {
  IterationOptions options;
  EXPECT_FALSE(RolloutOf(options).whole());
  IterationInputs inputs = Model();
  inputs.policy = std::string(64, 'c');
  const auto wants_all = [&] {
    pb::RolloutPayload payload;
    EXPECT_TRUE(payload.ParseFromString(CompileRollout(options, inputs).tasks(0).payload()));
    return payload.whole();
  };
  EXPECT_TRUE(wants_all());
  options.rollout.accept_partial = true;
  EXPECT_FALSE(wants_all());
  EXPECT_TRUE(OptionsFromJson(OptionsToJson(options)).rollout.accept_partial) << "a run that is gone on with";
}

TEST(JobGraphs, AnArmMovesAgainOnlyWhereItIsAskedFor) {
  IterationOptions options;
  EXPECT_EQ(RolloutOf(options).slower_attempts(), 0u);
  options.rollout.slower_attempts = 2;
  EXPECT_EQ(RolloutOf(options).slower_attempts(), 2u);
  options.rollout.slower_attempts = 11;
  EXPECT_EQ(Validate(options).message(), "slower attempts is 11, must be between 0 and 10");
}

TEST(OptionsJson, ComeBackAsTheyWere) {
  IterationOptions options;
  options.seed = 77;
  options.trajectories = {.count = 12, .shard_size = 3, .duration_s = 2.0, .reach = 0.3, .spread = 0.7};
  options.train = {.epochs = 9,
                   .batch = 8,
                   .learning_rate = 0.02,
                   .hidden = {16, 8},
                   .aggregations = 5,
                   .examination_pairs = 7};
  options.curriculum = {.on = true, .first = 0.3, .growth = 2.0};
  options.rollout.goal_position = {0.1, 0.2, 0.3};
  options.rollout.controller = "mpc";
  options.rollout.slower_attempts = 2;
  options.identify.solver = "lbfgs";
  options.identify.friction = false;
  options.identify.parametrisation = "raw";
  options.identify.hops = 5;
  const nlohmann::json json = OptionsToJson(options);
  EXPECT_EQ(OptionsToJson(OptionsFromJson(json)), json);
  EXPECT_NE(OptionsToJson(IterationOptions{}), json);
  EXPECT_EQ(OptionsFromJson(json).train.hidden, options.train.hidden);
  nlohmann::json broken = json;
  broken["train"].erase("epochs");
  EXPECT_THROW((void)OptionsFromJson(broken), nlohmann::json::exception);
}

TEST(JobGraphs, OptionsOutOfRangeAreNamed) {
  IterationOptions options;
  EXPECT_TRUE(Validate(options).ok());
  options.trajectories.count = 0;
  EXPECT_EQ(Validate(options).message(), "trajectories is 0, must be between 1 and 1000000");
  options = {};
  options.rollout.goal_position = {1, 2};
  EXPECT_NE(Validate(options).message().find("must have 3"), std::string::npos);
  options = {};
  options.identify.budget_s = 0;
  EXPECT_FALSE(Validate(options).ok());
}

}  // namespace
}  // namespace rg::jobs
