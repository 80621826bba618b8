// Which model the loop goes on with after a diagnosis.
#include "services/jobs/adopt_task.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/base/hash.h"
#include "common/recordings/csv.h"
#include "common/sim/model_file.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/kinds.h"
#include "services/rollouts/recording_bundle.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::jobs {
namespace {

using nlohmann::json;
using ::testing::StartsWith;

class Adoption : public ::testing::Test {
 protected:
  // A rollout as an artefact; `odd`: with a row that cannot be read.
  std::string Rollout(bool odd = false) const {
    rollouts::Bundle files = {{"manifest.json", recordings::FormatManifest(set_, "robot.urdf")},
                              {"robot.urdf", set_.urdf_text}};
    for (const auto& r : set_.recordings) files[r.name] = recordings::FormatCsv(r);
    if (odd) files[set_.recordings[0].name] += "nan,0,0\n";
    return rollouts::PackBundle(files);
  }
  // Of an identified and a diagnosed model, no chain having refined the latter.
  worker::TaskInput Input(const sim::Plant& identified, const sim::Plant& diagnosed,
                          const std::vector<std::string>& recordings) const {
    worker::TaskInput input;
    input.kind = kKindAdopt, input.task_name = "adopt";
    realitygrad::v1::AdoptPayload payload;
    payload.set_robot("arm2");
    payload.SerializeToString(&input.payload);
    const auto add = [&](const char* name, const std::string& bytes) {
      input.inputs.push_back({.name = name, .sha256 = Sha256Hex(bytes), .bytes = bytes});
    };
    const auto model = [](const sim::Plant& plant) {
      return sim::ModelToJson(plant, plant.parameters().Nominal());
    };
    for (const char* name : {kInputNominal, kInputModel, kInputIdentifiedBefore}) add(name, model(nominal_));
    add(kInputIdentified, model(identified));
    add(kInputDiagnosed, model(diagnosed));
    for (const std::string& bytes : recordings) add(kInputRecording, bytes);
    add(kInputDiagnosis, R"({"verdict": "unexplained", "findings": []})");
    add(kInputResult, "{}");
    return input;
  }
  std::string Adopted(const sim::Plant& identified, const sim::Plant& diagnosed) const {
    worker::RecordingTaskContext context("");
    const auto done = RunAdopt(Input(identified, diagnosed, {Rollout()}), context);
    EXPECT_TRUE(done.ok()) << done.status().ToString();
    return done.ok() ? json::parse(done->summary_json)["adopted"].get<std::string>() : "";
  }

  sim::Plant truth_ = sysid::testing::LoadPlant(
      "arm2", {effects::MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.5}})});
  sim::Plant nominal_ = sysid::testing::LoadPlant("arm2");
  recordings::RecordingSet set_ = diagnosis::testing::MakeSet("arm2", truth_.effects(), 3, 2.0);
};

TEST_F(Adoption, TheDiagnosedModelGoesOnWhereItTellsTheRolloutsBetter) {
  EXPECT_EQ(Adopted(nominal_, truth_), "diagnosed");
}

TEST_F(Adoption, IdentificationAloneGoesOnWhereTheDiagnosisDidNotBeatIt) {
  EXPECT_EQ(Adopted(truth_, nominal_), "identified");
}

TEST_F(Adoption, WhatPredictedTheNewestRolloutBestGoesOn) {
  worker::RecordingTaskContext context("");
  worker::TaskInput input = Input(truth_, nominal_, {Rollout()});
  const std::string before = sim::ModelToJson(truth_, truth_.parameters().Nominal());
  input.inputs.push_back({.name = kInputDiagnosedBefore, .sha256 = Sha256Hex(before), .bytes = before});
  const auto done = RunAdopt(input, context);
  ASSERT_TRUE(done.ok()) << done.status().ToString();
  const json said = json::parse(done->summary_json);
  EXPECT_EQ(said["adopted"], "diagnosed") << "the identified model of before is the nominal one";
  EXPECT_LT(said["unseen"]["diagnosed"]["window_rms"], said["unseen"]["identified"]["window_rms"]);
  EXPECT_EQ(done->artifacts[0].name, kOutputDiagnosed) << "what the next diagnosis begins with";
}

TEST_F(Adoption, ARolloutThatCannotBeReadIsNamedAndTakesNoOtherWithIt) {
  const std::string odd = Rollout(true), name = "recording " + Sha256Hex(odd).substr(0, 12);
  worker::RecordingTaskContext context("");
  const auto done = RunAdopt(Input(nominal_, truth_, {Rollout(), odd}), context);
  ASSERT_TRUE(done.ok()) << done.status().ToString();
  EXPECT_EQ(json::parse(done->summary_json)["adopted"], "diagnosed");
  ASSERT_FALSE(context.lines.empty());
  EXPECT_THAT(context.lines[0], StartsWith(name + " is left out: rec_000.csv: row 202 (line 203), column time: NaN"));
  for (const auto& artifact : done->artifacts) {
    if (artifact.name == kOutputParameters) {
      EXPECT_EQ(json::parse(artifact.metadata_json)["recording"], Sha256Hex(Rollout())) << "not the odd one";
    }
    if (artifact.name != kOutputResult) continue;
    const json said = json::parse(artifact.bytes)["diagnosis"];
    EXPECT_EQ(said["rollouts"], 1);
    EXPECT_EQ(said["left_out"], json({context.lines[0]}));
  }
}

TEST_F(Adoption, WithoutAnyRolloutThatCanBeReadIsAnErrorThatNamesTheNewest) {
  const std::string odd = Rollout(true);
  worker::RecordingTaskContext context("");
  const auto done = RunAdopt(Input(nominal_, truth_, {odd, odd}), context);
  ASSERT_FALSE(done.ok());
  EXPECT_THAT(done.status().message(), StartsWith("recording " + Sha256Hex(odd).substr(0, 12)));
}

}  // namespace
}  // namespace rg::jobs
