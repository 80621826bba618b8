// The kind `rollout` as an agent runs it, with a simulated arm: which request is answered with which
// recording.
#include "robot_agent/rollout/rollout_task_kind.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/hash.h"
#include "common/sim/model_file.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/kinds.h"
#include "services/rollouts/rollout_spec.h"
#include "tests/unit/robot_agent/rig.h"
#include "worker/task_registry.h"

namespace rg::robot_agent {
namespace {

class RolloutKind : public ::testing::Test {
 protected:
  RolloutKind() {
    rig_.spool.reset();  // the task takes it
    rig_.config.first_rollouts = {};
    RegisterRolloutKind(rig_.config, rig_.folder, &registry_);
    payload_.set_robot(rig_.config.name);
    payload_.set_controller("mpc");
    payload_.set_duration_s(0.2);
    payload_.set_seed(4);
    input_.kind = jobs::kKindRollout;
    input_.task_name = "rollout";
    input_.job = 1;
    input_.task = 1 << 24;
    input_.database = std::string(32, 'a');
    SetModel(rig_.values);
  }
  void SetModel(const Eigen::VectorXd& values) {
    worker::InputArtifact model;
    model.name = jobs::kInputModel;
    model.bytes = sim::ModelToJson(rig_.plant, values);
    model.sha256 = Sha256Hex(model.bytes);
    input_.inputs = {model};
  }
  // rollout.json of what it is answered with.
  nlohmann::json Run() {
    input_.payload = payload_.SerializeAsString();
    worker::RecordingTaskContext context(rig_.folder);
    const auto outputs = (*registry_.Find(jobs::kKindRollout))(input_, context);
    EXPECT_TRUE(outputs.ok()) << outputs.status().ToString();
    return outputs.ok() ? nlohmann::json::parse(outputs->artifacts.at(0).metadata_json) : nlohmann::json();
  }
  // How often the arm has begun to move.
  long Begun() const {
    const std::string lines = ReadFile(rig_.folder + "/begun.txt").value();
    return std::count(lines.begin(), lines.end(), '\n');
  }

  Rig rig_{true};
  worker::TaskRegistry registry_;
  realitygrad::v1::RolloutPayload payload_;
  worker::TaskInput input_;
};

TEST_F(RolloutKind, TheSameAttemptAtTheSameRequestMovesNothingAndAnyOtherDoes) {
  std::set<std::string> ids;
  const auto run_anew = [&](const char* what) {
    const long before = Begun();
    const auto said = Run();
    EXPECT_EQ(Begun(), before + 1) << what;
    EXPECT_EQ(said["duration_s"], payload_.duration_s()) << what;
    EXPECT_EQ(said["database"], input_.database);
    EXPECT_TRUE(ids.insert(said["id"].get<std::string>()).second) << what;
  };
  ASSERT_TRUE(WriteFileAtomically(rig_.folder + "/begun.txt", "").ok());
  run_anew("the first");
  const auto first = Run();
  EXPECT_EQ(Begun(), 1) << "a repeat";
  EXPECT_EQ(ids.count(first["id"].get<std::string>()), 1u);

  payload_.set_duration_s(0.4);
  run_anew("a longer one under the same numbers");
  payload_.add_goal_q(0.1);
  for (const double q : {3.1, 3.1, 0.0, 0.0, 0.0}) payload_.add_goal_q(q);
  run_anew("another goal");
  SetModel(1.01 * rig_.values);
  run_anew("another model");
  input_.attempt = 2;
  run_anew("somebody consented to another attempt");
  input_.database = std::string(32, 'b');
  run_anew("the same of another database");
  const auto last = Run();
  EXPECT_EQ(Begun(), 6) << "a repeat";
  EXPECT_EQ(ids.count(last["id"].get<std::string>()), 1u);
}

TEST_F(RolloutKind, ALongNameStillMakesAnIdWithRoomForSlowerAttempts) {
  input_.task_name = std::string(128, 'x');
  input_.job = (int64_t{1} << 39) - 1;
  input_.attempt = 4'294'967'295u;
  const auto said = Run();
  rollouts::RolloutSpec spec;
  spec.id = said["id"].get<std::string>() + "-slower10";
  EXPECT_TRUE(rollouts::CheckSpec(spec).ok()) << spec.id;
  input_.task_name += "y";
  EXPECT_NE(Run()["id"], said["id"]) << "all of the name counts";
}

}  // namespace
}  // namespace rg::robot_agent
