// A diagnosed model feeds everything: each effect of the catalogue, in a model.json, plans trajectories,
// examines and teaches policies, identifies, predicts, and is a simulated robot.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/effects/effect_catalog.h"
#include "common/model/urdf_loader.h"
#include "common/sim/model_file.h"
#include "robot_agent/simulated_robot/robot_world.h"
#include "services/jobs/identify_problem.h"
#include "services/sysid/prediction.h"
#include "services/trajectories/mpc_controller.h"
#include "services/trajectories/shard.h"

namespace rg::jobs {
namespace {

using Eigen::VectorXd;

std::string Arm() { return std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/arm2.urdf"; }

sim::Plant Bare() {
  auto model = model::LoadUrdf(Arm(), {});
  EXPECT_TRUE(model.ok()) << model.status().ToString();
  return sim::Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
}

// A value that is felt and that the arm can live with.
double Felt(const effects::ParameterInfo& p, double effort) {
  if (p.name == "gap") return 0.01;
  if (p.name == "amplitude" || p.name == "coulomb" || p.name == "torque") return 0.02 * effort;
  if (p.default_is_effort) return 0.5 * effort;
  if (p.default_value != 0.0) return p.default_value;
  if (p.name == "offset") return 0.1;
  const double scale = p.prior_of_effort ? effort : 1.0;
  const double value = 0.2 * scale * p.prior_stddev;
  return std::isfinite(value) ? std::min(p.upper, std::max(p.lower, value)) : 0.01;
}

sim::Plant With(const sim::Plant& bare, const effects::EffectInfo& info) {
  effects::EffectSpec spec = effects::MakeSpec(info.id);
  const auto& names = bare.joint_names();
  if (info.scope == effects::Scope::kJoint) spec.joints = {names[1]};
  if (info.scope == effects::Scope::kJointPair) spec.joints = {names[0], names[1]};
  const bool joint = info.scope == effects::Scope::kJoint;
  for (size_t i = 0; i < info.parameters.size(); ++i) {
    if (info.Applies(static_cast<int>(i), spec))
      spec.values[joint ? names[1] : "*"][info.parameters[i].name] =
          Felt(info.parameters[i], bare.model().joint(1).effort);
  }
  auto plant = bare.WithEffect(spec);
  EXPECT_TRUE(plant.ok()) << info.id << ": " << plant.status().ToString();
  return *plant;
}

// As a diagnosis hands it over.
sim::ModelFile Read(const sim::Plant& plant) {
  auto file = sim::ModelFromJson(sim::ModelToJson(plant, plant.parameters().Nominal()), "model.json");
  EXPECT_TRUE(file.ok()) << file.status().ToString();
  return *file;
}

class EachEffect : public ::testing::TestWithParam<std::string> {
 protected:
  const effects::EffectInfo& info() const { return *effects::FindEffect(GetParam()); }
  sim::ModelFile Model() const { return Read(With(Bare(), info())); }
};

TEST_P(EachEffect, PlansTrajectories) {
  const sim::ModelFile model = Model();
  trajectories::ShardSpec spec;
  spec.count = 2;
  spec.seed = 3;
  const auto shard = trajectories::GenerateShard(model.plant, model.values, spec);
  ASSERT_TRUE(shard.ok()) << shard.status().ToString();
  EXPECT_EQ(shard->trajectories.size(), 2u) << shard->FailureSummary();
}

TEST_P(EachEffect, IsASimulatedRobot) {
  const sim::ModelFile model = Model();
  const std::string folder =
      (std::filesystem::temp_directory_path() / ("rg-augmented-" + RandomHex(6))).string();
  ASSERT_TRUE(WriteFileAtomically(folder + "/model.json", sim::ModelToJson(model.plant, model.values)).ok());
  ASSERT_TRUE(WriteFileAtomically(folder + "/truth.json", R"({"format": "realitygrad.robot_truth/1",
      "robot": "arm2", "model": "model.json", "torque_limit": [60, 30], "initial_pose": [0.3, 0.2],
      "position_controller": {"stiffness": [200, 100], "damping": [20, 10], "speed": [1, 1]}})")
                  .ok());
  const auto truth = robot_agent::LoadRobotTruth(folder + "/truth.json");
  std::filesystem::remove_all(folder);
  ASSERT_TRUE(truth.ok()) << truth.status().ToString();
  EXPECT_EQ(truth->values, model.values);
  robot_agent::RobotWorld world(*truth, 1);
  const double pose[2] = {0.4, 0.1};
  world.MoveTo(pose);
  world.AdvanceTo(2'000'000'000);
  EXPECT_EQ(world.failure(), "");
  EXPECT_NEAR(world.true_state().q[0], 0.4, 0.15);
}

TEST_P(EachEffect, IsIdentifiedFurtherAndPredicts) {
  const sim::ModelFile model = Model();
  // What the model itself does under a known command.
  sim::Simulator simulator(model.plant);
  simulator.SetParameters(model.values);
  recordings::Recording recording;
  recording.name = "rec.csv";
  recording.joints = model.plant.joint_names();
  const int rows = 51;
  recording.t = VectorXd::LinSpaced(rows, 0.0, 2.0);
  recording.q.resize(2, rows), recording.v.resize(2, rows), recording.effort_command.resize(2, rows);
  sim::State x = simulator.MakeState(VectorXd::Constant(2, 0.3), VectorXd::Zero(2));
  for (int k = 0; k < rows; ++k) {
    VectorXd q, v;
    q.resize(2), v.resize(2);
    simulator.Measure(x, &q, &v);
    recording.q.col(k) = q, recording.v.col(k) = v;
    recording.effort_command.col(k) << 3.0 * std::sin(3 * recording.t[k]), 1.5 * std::cos(4 * recording.t[k]);
    ASSERT_TRUE(simulator.Advance(x, recording.effort_command.col(k), 0.04).ok());
  }
  IdentifyProblemOptions options;
  options.alpha = 1e-2;
  options.friction = true;
  const auto fitted = ModelToFit(model, options);
  ASSERT_TRUE(fitted.ok()) << fitted.status().ToString();
  const auto problem = IdentifyProblem::Create(fitted->plant, fitted->values, recording, options);
  ASSERT_TRUE(problem.ok()) << problem.status().ToString();
  const sysid::LeastSquaresProblem& ls = problem->problem();
  VectorXd r(ls.residuals->num_residuals());
  sysid::RowMatrix jacobian(r.size(), ls.initial.size());
  ASSERT_TRUE(ls.residuals->Evaluate(ls.initial, {}, &r, &jacobian));
  EXPECT_TRUE(r.allFinite() && jacobian.allFinite());

  const auto prediction = sysid::PredictRecording(model.plant, model.values, recording, {});
  EXPECT_TRUE(prediction.failures.empty());
  EXPECT_LT(sysid::ErrorOf(prediction, recording).rms, 0.05);
}

TEST(AugmentedModel, PlansAreInWhatTheEncodersSay) {
  const sim::Plant bare = Bare();
  const auto read = [](const sim::Plant& plant, double spread) {
    trajectories::ShardSpec spec;
    spec.count = 1;
    spec.sampling.home = VectorXd::Constant(2, 0.5), spec.sampling.home_range = spread;
    return trajectories::GenerateShard(plant, plant.parameters().Nominal(), spec)
        .value()
        .trajectories.front();
  };
  const auto plain = read(bare, 0.4);
  const auto offset = read(
      *bare.WithEffect(effects::MakeSpec("encoder_offset", {bare.joint_names()[1]}, {{"offset", 0.1}})), 0.4);
  EXPECT_LT((offset.torque - plain.torque).cwiseAbs().maxCoeff(), 1e-12) << "the same motion";
  EXPECT_NEAR(offset.q(1, 0) - plain.q(1, 0), 0.1, 1e-12);
  EXPECT_NEAR(offset.goal[1] - plain.goal[1], 0.1, 1e-12);
  EXPECT_EQ(offset.q(0, 0), plain.q(0, 0));

  // Live on the robot, too: the same state, as its encoders say it.
  const sim::Plant shifted =
      *bare.WithEffect(effects::MakeSpec("encoder_offset", {bare.joint_names()[1]}, {{"offset", 0.1}}));
  const auto first = [](const sim::Plant& plant, const Eigen::Vector2d& q, const Eigen::Vector2d& goal) {
    auto mpc = trajectories::MpcController::Create(plant, plant.parameters().Nominal(), {}).value();
    VectorXd u(2);
    mpc->Solve(q, VectorXd::Zero(2), goal, &u);
    return u;
  };
  EXPECT_LT((first(bare, {0.3, 0.2}, {0.5, 0.4}) - first(shifted, {0.3, 0.3}, {0.5, 0.5})).norm(), 1e-12);
}

TEST(AugmentedModel, IdentificationAddsNoSecondDryFriction) {
  const sim::Plant bare = Bare();
  const auto& names = bare.joint_names();
  sim::Plant plant = *bare.WithEffect(effects::MakeSpec("stribeck_friction", {names[0]}));
  plant = *plant.WithEffect(effects::MakeSpec("joint_elasticity", {names[1]}));
  IdentifyProblemOptions options;
  options.friction = true;
  const auto fitted = ModelToFit(Read(plant), options);
  ASSERT_TRUE(fitted.ok()) << fitted.status().ToString();
  const auto& table = fitted->plant.parameters();
  EXPECT_LT(table.Find("coulomb_friction." + names[0] + ".coulomb"), 0);
  EXPECT_GE(table.Find("coulomb_friction." + names[1] + ".coulomb"), 0);
  EXPECT_GE(table.Find("rotor_inertia." + names[0] + ".armature"), 0);
  EXPECT_LT(table.Find("rotor_inertia." + names[1] + ".armature"), 0);
}

std::vector<std::string> Ids() {
  std::vector<std::string> ids;
  for (const auto& info : effects::Catalog()) ids.push_back(info.id);
  return ids;
}
INSTANTIATE_TEST_SUITE_P(Catalogue, EachEffect, ::testing::ValuesIn(Ids()),
                         [](const auto& info) { return info.param; });

}  // namespace
}  // namespace rg::jobs
