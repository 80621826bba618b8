#include "services/jobs/diagnose_task.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/csv.h"
#include "common/sim/model_file.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/diagnosis_inputs.h"
#include "services/jobs/kinds.h"
#include "services/rollouts/recording_bundle.h"

namespace rg::jobs {
namespace {

using nlohmann::json;

// arm2 as its URDF has it.
const std::string kModel = [] {
  const auto robot =
      model::LoadUrdf(std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/arm2.urdf", {}).value();
  const sim::Plant plant = sim::Plant::Create(std::make_shared<const model::RobotModel>(robot)).value();
  return sim::ModelToJson(plant, plant.parameters().Nominal());
}();

// What the agent leaves of a rollout of `rows` rows; below two the recording is not in the manifest.
worker::InputArtifact Rollout(int rows) {
  recordings::Recording r;
  r.joints = {"shoulder", "elbow"};
  r.t = Eigen::VectorXd::LinSpaced(rows, 0.0, 0.04 * (rows - 1));
  r.q = Eigen::MatrixXd::Zero(2, rows), r.v = r.q, r.effort_command = r.q;
  for (int k = 0; k < rows; ++k) r.q(0, k) = 0.1 * std::sin(k);
  json manifest = {{"format", "realitygrad.recordings/1"}, {"robot", "robot.urdf"}, {"joints", r.joints}};
  manifest["recordings"] = json::array();
  if (rows >= 2) manifest["recordings"].push_back({{"file", "rec_000.csv"}, {"split", "fit"}});
  rollouts::Bundle bundle;
  bundle["manifest.json"] = manifest.dump();
  bundle["robot.urdf"] =
      ReadFile(std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/arm2.urdf").value();
  bundle["rec_000.csv"] = recordings::FormatCsv(r);
  return {.name = kInputRecording, .sha256 = std::string(64, 'a'), .bytes = rollouts::PackBundle(bundle)};
}

worker::TaskInput Input(bool of_a_loop, std::vector<int> rows) {
  realitygrad::v1::DiagnosePayload payload;
  payload.set_rollouts(of_a_loop);
  worker::TaskInput input;
  input.kind = kKindDiagnose, input.task_name = "diagnosis";
  payload.SerializeToString(&input.payload);
  input.inputs.push_back({.name = kInputModel, .sha256 = std::string(64, 'b'), .bytes = kModel});
  for (const int count : rows) input.inputs.push_back(Rollout(count));
  return input;
}

TEST(DiagnoseTask, ALoopGoesOnWithItsModelWhereRolloutsSayTooLittle) {
  for (const std::vector<int>& rows : {std::vector<int>{0}, {5}, {0, 5}, {12}}) {
    worker::RecordingTaskContext context("");
    const auto done = RunDiagnose(Input(true, rows), context);
    ASSERT_TRUE(done.ok()) << done.status().ToString();
    EXPECT_EQ(json::parse(done->artifacts[0].bytes)["verdict"], "not_diagnosed");
    EXPECT_EQ(done->artifacts[1].bytes, kModel);
    EXPECT_FALSE(context.lines.empty()) << "it says why";
  }
}

TEST(DiagnoseTask, SaysWhichJointsTheRolloutsTellTooLittleOf) {
  worker::RecordingTaskContext context("");
  const auto done = RunDiagnose(Input(true, {12}), context);
  ASSERT_TRUE(done.ok()) << done.status().ToString();
  EXPECT_EQ(json::parse(done->artifacts[0].metadata_json).at("quiet_joints"), json({"shoulder", "elbow"}));
}

// A rollout whose bundle holds a row that is none.
worker::InputArtifact OddRollout() {
  worker::InputArtifact odd = Rollout(20);
  auto files = rollouts::UnpackBundle(odd.bytes).value();
  files["rec_000.csv"] += "0.1,nan\n";
  odd.bytes = rollouts::PackBundle(files), odd.sha256 = std::string(64, 'd');
  return odd;
}

TEST(DiagnoseTask, ARolloutThatCannotBeReadIsNamedAndTheOthersAreDiagnosed) {
  worker::TaskInput input = Input(true, {12, 20});
  input.inputs.push_back(OddRollout());
  const auto set = SetToDiagnose(input, true);
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_EQ(set->recordings.size(), 2u);
  ASSERT_FALSE(set->warnings.empty());
  EXPECT_EQ(set->warnings.back().find("recording dddddddddddd is left out: "), 0u) << set->warnings.back();
  // Of a user's set nothing is left out.
  const auto whole = SetToDiagnose(input, false);
  ASSERT_FALSE(whole.ok());
  EXPECT_EQ(whole.status().message().find("recording set dddddddddddd: "), 0u) << whole.status().message();
}

TEST(DiagnoseTask, WhoAskedForADiagnosisIsToldThatThereIsNone) {
  worker::RecordingTaskContext context("");
  EXPECT_NE(RunDiagnose(Input(false, {5}), context).status().message().find("fewer than 10 rows"),
            std::string::npos);
}

}  // namespace
}  // namespace rg::jobs
