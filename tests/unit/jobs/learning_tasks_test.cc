// What tasks of further rounds of aggregation do after an examination.
#include "services/jobs/learning_tasks.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/base/hash.h"
#include "common/sim/model_file.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/kinds.h"
#include "services/policy/policy.h"
#include "services/policy/train.h"
#include "services/trajectories/shard.h"
#include "tests/unit/sysid/simulated_recordings.h"
#include "worker/task_registry.h"

namespace rg::jobs {
namespace {

using nlohmann::json;

class FurtherRound : public ::testing::Test {
 protected:
  void Add(worker::TaskInput* input, const char* name, const std::string& bytes) const {
    input->inputs.push_back({.name = name, .sha256 = Sha256Hex(bytes), .bytes = bytes});
  }
  // Of a policy that an examination has judged so.
  worker::TaskInput Input(bool train_on) const {
    worker::TaskInput input;
    realitygrad::v1::TrajectoriesPayload payload;
    payload.set_seed(3), payload.set_count(2), payload.set_duration_s(0.2);
    payload.SerializeToString(&input.payload);
    Add(&input, kInputModel, sim::ModelToJson(plant_, plant_.parameters().Nominal()));
    Add(&input, kInputPolicy, policy_);
    Add(&input, kInputExamination, json{{"train_on", train_on}, {"passed", !train_on}}.dump());
    return input;
  }
  trajectories::Shard Answers(bool train_on) const {
    worker::RecordingTaskContext context("");
    const auto done = RunAggregate(Input(train_on), context);
    EXPECT_TRUE(done.ok()) << done.status().ToString();
    return *trajectories::ParseShard(done->artifacts[0].bytes, "shard");
  }

  sim::Plant plant_ = sysid::testing::LoadPlant("arm2");
  std::string policy_ = [] {
    policy::Dataset dataset;
    Eigen::MatrixXd q = Eigen::MatrixXd::Random(2, 20);
    for (uint64_t id = 0; id < 4; ++id) dataset.AddTrajectory(id, q, q, q.col(0), 0.1 * q);
    policy::TrainOptions options;
    options.hidden = {4}, options.epochs = 1;
    return policy::SerializePolicy(policy::Train(dataset, options)->policy);
  }();
};

TEST_F(FurtherRound, AsksTheExpertOnlyWhereTheExaminationWasNotPassed) {
  EXPECT_EQ(Answers(true).trajectories.size() + Answers(true).unfilled.size(), 2u);
  EXPECT_EQ(Answers(false).trajectories.size(), 0u);
}

TEST_F(FurtherRound, PassesThePolicyAndItsExaminationOnWhereNothingIsToDo) {
  const worker::TaskInput input = Input(false);
  worker::RecordingTaskContext context("");
  const auto trained = RunTrain(input, context), examined = RunExamine(input, context);
  ASSERT_TRUE(trained.ok() && examined.ok()) << trained.status().ToString() << examined.status().ToString();
  EXPECT_EQ(trained->artifacts[0].bytes, policy_);
  EXPECT_EQ(examined->artifacts[0].bytes, input.Find(kInputExamination)->bytes);
}

TEST_F(FurtherRound, ExaminesAnewWhereMoreWasLearned) {
  worker::RecordingTaskContext context("");
  const auto examined = RunExamine(Input(true), context);
  ASSERT_TRUE(examined.ok()) << examined.status().ToString();
  EXPECT_EQ(json::parse(examined->artifacts[0].bytes)["pairs"], 2);
}

TEST_F(FurtherRound, AnExaminationThatIsNoneIsAnError) {
  worker::TaskInput input = Input(false);
  input.task_name = "policy-3";
  for (auto& artifact : input.inputs) {
    if (artifact.name == kInputExamination) artifact.bytes = "[]";
  }
  worker::RecordingTaskContext context("");
  EXPECT_EQ(RunTrain(input, context).status().message(), "policy-3: the examination is not one");
}

}  // namespace
}  // namespace rg::jobs
