#include "robot_agent/simulated_robot/truth.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "robot_agent/simulated_robot/robot_world.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;
using testing::HasSubstr;

std::string TruthPath() {
  return std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/mico2_truth.json";
}

// The outcome of loading the Mico²'s truth after `edit`.
Result<RobotTruth> LoadEdited(const std::function<void(json&)>& edit) {
  json root = json::parse(ReadFile(TruthPath()).value());
  root["urdf"] = std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/mico2.urdf";
  edit(root);
  const std::string path =
      (std::filesystem::temp_directory_path() / ("rg-truth-" + RandomHex(6) + ".json")).string();
  EXPECT_TRUE(WriteFileAtomically(path, root.dump()).ok());
  auto truth = LoadRobotTruth(path);
  std::filesystem::remove(path);
  return truth;
}

TEST(RobotTruths, TheMicosIsHeavierThanItsUrdfAndHasPhysicsItsModelLacks) {
  const RobotTruth truth = LoadRobotTruth(TruthPath()).value();
  const auto& table = truth.plant.parameters();
  const Eigen::VectorXd nominal = table.Nominal();
  const int mass = table.Find("mass.link_2");
  EXPECT_NEAR(truth.values[mass], 1.15 * nominal[mass], 1e-12);
  EXPECT_EQ(truth.plant.effects().size(), 4u);
  EXPECT_EQ(truth.values[table.Find("rotor_inertia.joint_4.armature")], 0.045);
}

TEST(RobotTruths, RefusalsNameFileFieldAndValue) {
  EXPECT_THAT(LoadEdited([](json& t) { t["rotor"] = 1; }).status().message(),
              HasSubstr("unknown field \"rotor\""));
  EXPECT_THAT(LoadEdited([](json& t) {
                t["parameters"]["mass.link_22"] = {{"scale", 2}};
              })
                  .status()
                  .message(),
              HasSubstr("mass.link_22"));
  EXPECT_THAT(LoadEdited([](json& t) {
                t["torque_limit"] = {1, 2};
              })
                  .status()
                  .message(),
              HasSubstr("torque_limit has 2 entries for 6"));
  EXPECT_THAT(LoadEdited([](json& t) { t["effects"][0]["effect"] = "magic"; }).status().message(),
              HasSubstr("magic"));
  EXPECT_THAT(LoadEdited([](json& t) { t["sensors"]["rate_hz"] = 0; }).status().message(),
              HasSubstr("rate_hz"));
  EXPECT_THAT(LoadEdited([](json& t) { t["gravity_compensation"] = "yes"; }).status().message(),
              HasSubstr("\"yes\""));
  EXPECT_THAT(LoadEdited([](json& t) {
                t["parameters"]["mass.link_2"] = {{"value", -1}};
              })
                  .status()
                  .message(),
              HasSubstr("mass.link_2"));
}

TEST(RobotWorlds, PositionModeReachesAPoseAndHoldsItStill) {
  const RobotTruth truth = LoadRobotTruth(TruthPath()).value();
  RobotWorld world(truth, 1);
  Eigen::VectorXd pose(6);
  pose << 0.3, 2.9, 3.4, -0.3, 0.2, 0.4;
  world.MoveTo(pose.data());
  world.AdvanceTo(4'000'000'000);
  EXPECT_LT((world.true_state().q - pose).cwiseAbs().maxCoeff(), 0.01);
  EXPECT_LT(world.true_state().v.cwiseAbs().maxCoeff(), 1e-3);
  EXPECT_EQ(world.failure(), "");
}

TEST(RobotWorlds, WithoutTorqueTheArmFallsAndHoldBrakesIt) {
  const RobotTruth truth = LoadEdited([](json& t) { t["silence"]["timeout_s"] = 10; }).value();
  RobotWorld world(truth, 1);
  Eigen::VectorXd pose(6);
  pose << 0, 2.0, 3.1, 0, 0, 0;  // leaning
  world.MoveTo(pose.data());
  world.AdvanceTo(6'000'000'000);
  const double before = world.true_state().q[1];
  const std::vector<double> zero(6, 0.0);
  world.EnterTorque(zero.data());
  world.AdvanceTo(6'500'000'000);
  const double fallen = world.true_state().q[1];
  EXPECT_GT(std::abs(fallen - before), 0.05);
  EXPECT_GT(std::abs(world.true_state().v[1]), 0.1);
  world.Hold();
  world.AdvanceTo(7'500'000'000);
  EXPECT_LT(world.true_state().v.cwiseAbs().maxCoeff(), 0.01);
  EXPECT_LT(std::abs(world.true_state().q[1] - fallen), 0.1);
}

TEST(RobotWorlds, MeasurementsComeAtTheirRateLateAndOnTheirGrid) {
  const RobotTruth truth = LoadRobotTruth(TruthPath()).value();
  RobotWorld world(truth, 1);
  int taken = 0;
  RobotState state;
  for (int ms = 1; ms <= 1000; ++ms) {
    world.AdvanceTo(ms * 1'000'000LL);
    if (!world.TakeState(&state)) continue;
    ++taken;
    EXPECT_GE(world.time_ns() - state.stamp_ns, 3'000'000);
    EXPECT_LE(world.time_ns() - state.stamp_ns, 4'000'000);
    EXPECT_NEAR(std::remainder(state.q[2], 2e-4), 0.0, 1e-12);
  }
  EXPECT_EQ(taken, 100);
}

}  // namespace
}  // namespace rg::robot_agent
