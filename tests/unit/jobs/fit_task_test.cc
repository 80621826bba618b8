// A fit of a diagnosis is the same to the bit, whoever makes it.
#include "services/jobs/fit_task.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/recordings/csv.h"
#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/likelihood/features.h"
#include "services/diagnosis/search/fit_requests.h"
#include "services/jobs/fit_messages.h"
#include "services/jobs/kinds.h"
#include "services/rollouts/recording_bundle.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::jobs {
namespace {

using diagnosis::FitRequest;
using diagnosis::FitResult;
using ::testing::HasSubstr;

class FitsOfASet : public ::testing::Test {
 protected:
  FitsOfASet() {
    rollouts::Bundle files = {{"manifest.json", recordings::FormatManifest(set_, "robot.urdf")},
                              {"robot.urdf", set_.urdf_text}};
    for (const auto& r : set_.recordings) files[r.name] = recordings::FormatCsv(r);
    bundle_ = rollouts::PackBundle(files);
  }

  // Coulomb friction of the elbow on some windows, and on all from where that fit ended.
  std::vector<FitRequest> Requests() {
    const std::vector<effects::EffectSpec> friction = {
        effects::MakeSpec("coulomb_friction", {nominal_.joint_names()[1]}, {{"coulomb", 0.1}})};
    FitRequest some{friction, true, {}, {0, 2, 5}, 0, false, nullptr};
    some.options.iterations = 2, some.options.noise_scale = 1.25, some.options.still_falling = 0.1;
    some.options.to_beat = 1e4;
    auto from = diagnosis::Unfitted(setting_, friction, true);
    FitRequest all{friction, true, {}, {}, 0, false, nullptr};
    all.options.iterations = 1;
    from.fit = diagnosis::MakeFit(setting_, all);
    all.from = std::make_shared<const diagnosis::Candidate>(std::move(from));
    return {some, all};
  }

  worker::TaskInput Input(const realitygrad::v1::FitBatch& batch, uint32_t index) const {
    realitygrad::v1::FitPayload payload;
    payload.set_index(index);
    worker::TaskInput input;
    input.kind = kKindFit, input.task_name = "fit";
    payload.SerializeToString(&input.payload);
    input.inputs.push_back({.name = kInputRecording, .sha256 = std::string(64, 'a'), .bytes = bundle_});
    input.inputs.push_back(
        {.name = kInputFitBatch, .sha256 = std::string(64, 'b'), .bytes = batch.SerializeAsString()});
    return input;
  }

  recordings::RecordingSet set_ = diagnosis::testing::MakeSet(
      "arm2", {effects::MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.6}})}, 9, 2.0);
  sim::Plant nominal_ = sysid::NominalPlant(set_).value();
  diagnosis::FitData data_ = diagnosis::PrepareData(set_, nominal_, {}).value();
  diagnosis::MotionScales scales_ = diagnosis::ScalesOf(data_, nominal_);
  diagnosis::FitSetting setting_{data_, nominal_, scales_};
  std::string bundle_;
};

TEST_F(FitsOfASet, AWorkersFitIsThisProcessesFit) {
  const std::vector<FitRequest> requests = Requests();
  const auto batch = BatchOf(requests, data_);
  const worker::TaskFunction task = MakeFitTask();
  worker::RecordingTaskContext context("");
  for (uint32_t i = 0; i < requests.size(); ++i) {
    const auto done = task(Input(batch, i), context);
    ASSERT_TRUE(done.ok()) << done.status().ToString();
    realitygrad::v1::FitReply reply;
    ASSERT_TRUE(reply.ParseFromString(done->artifacts.at(0).bytes));
    const FitResult there = FitOf(reply), here = diagnosis::MakeFit(setting_, requests[i]);
    ASSERT_TRUE(here.ok);
    EXPECT_TRUE(there.ok);
    EXPECT_EQ(there.values, here.values);
    EXPECT_EQ(there.theta, here.theta);
    EXPECT_EQ(there.stddev, here.stddev);
    EXPECT_EQ(there.states, here.states);
    EXPECT_EQ(there.window_chi2, here.window_chi2);
    EXPECT_EQ(there.information, here.information);
    EXPECT_EQ(there.chi2, here.chi2);
    EXPECT_EQ(there.prior_cost, here.prior_cost);
    EXPECT_EQ(there.evidence, here.evidence);
    EXPECT_EQ(there.work, here.work);
    EXPECT_EQ(there.rows, here.rows);
    EXPECT_EQ(there.iterations, here.iterations);
    EXPECT_GT(here.step_s, 0.0);
    EXPECT_EQ(there.step_s, here.step_s);
  }
}

TEST_F(FitsOfASet, OptionsAndStartsTravelWithARequest) {
  std::vector<FitRequest> requests = Requests();
  requests[0].specs[0].options["sensor"] = "motor";
  const auto batch = BatchOf(requests, data_);
  EXPECT_EQ(batch.starts_size(), 1);
  const FitRequest back = RequestOf(batch, 0, setting_).value();
  EXPECT_EQ(back.specs[0].options, requests[0].specs[0].options);
  EXPECT_EQ(back.specs[0].values, requests[0].specs[0].values);
  EXPECT_EQ(back.places, requests[0].places);
  EXPECT_EQ(back.options.noise_scale, 1.25);
  EXPECT_EQ(back.options.still_falling, 0.1);
  EXPECT_EQ(back.options.to_beat, 1e4);
  EXPECT_EQ(back.from, nullptr);
  EXPECT_EQ(RequestOf(batch, 1, setting_)->from->fit.states, requests[1].from->fit.states);
  EXPECT_EQ(RequestOf(batch, 1, setting_)->from->fit.step_s, requests[1].from->fit.step_s);
}

TEST_F(FitsOfASet, ABatchOfOtherRecordingsIsRefused) {
  auto batch = BatchOf(Requests(), data_);
  EXPECT_THAT(RequestOf(batch, 7, setting_).status().message(), HasSubstr("no fit 7"));
  batch.mutable_starts(0)->mutable_states()->RemoveLast();
  EXPECT_THAT(RequestOf(batch, 1, setting_).status().message(), HasSubstr("not one of these recordings"));
  batch.mutable_fits(0)->add_places(100000);
  EXPECT_THAT(RequestOf(batch, 0, setting_).status().message(), HasSubstr("no window 100000"));
  worker::TaskInput input = Input(batch, 0);
  input.inputs[1].bytes = "no batch";
  worker::RecordingTaskContext context("");
  EXPECT_FALSE(MakeFitTask()(input, context).ok());
}

}  // namespace
}  // namespace rg::jobs
