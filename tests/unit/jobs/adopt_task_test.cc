// Which model the loop goes on with after a diagnosis.
#include "services/jobs/adopt_task.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/recordings/csv.h"
#include "common/sim/model_file.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/kinds.h"
#include "services/rollouts/recording_bundle.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::jobs {
namespace {

using nlohmann::json;

class Adoption : public ::testing::Test {
 protected:
  // What is adopted of an identified and a diagnosed model, no chain having refined the latter.
  std::string Adopted(const sim::Plant& identified, const sim::Plant& diagnosed) const {
    worker::TaskInput input;
    input.kind = kKindAdopt, input.task_name = "adopt";
    realitygrad::v1::AdoptPayload payload;
    payload.set_robot("arm2");
    payload.SerializeToString(&input.payload);
    const auto add = [&](const char* name, const std::string& bytes) {
      input.inputs.push_back({.name = name, .sha256 = std::string(64, 'a'), .bytes = bytes});
    };
    const auto model = [](const sim::Plant& plant) {
      return sim::ModelToJson(plant, plant.parameters().Nominal());
    };
    for (const char* name : {kInputNominal, kInputModel, kInputIdentifiedBefore}) add(name, model(nominal_));
    add(kInputIdentified, model(identified));
    add(kInputDiagnosed, model(diagnosed));
    rollouts::Bundle files = {{"manifest.json", recordings::FormatManifest(set_, "robot.urdf")},
                              {"robot.urdf", set_.urdf_text}};
    for (const auto& r : set_.recordings) files[r.name] = recordings::FormatCsv(r);
    add(kInputRecording, rollouts::PackBundle(files));
    add(kInputDiagnosis, R"({"verdict": "unexplained", "findings": []})");
    add(kInputResult, "{}");
    worker::RecordingTaskContext context("");
    const auto done = RunAdopt(input, context);
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

}  // namespace
}  // namespace rg::jobs
