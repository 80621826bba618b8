// The whole loop through real ROS topics with a diagnosis after each rollout: what the stand-in hides is
// named, and the second iteration is better than the first. The search has time to end: what a busy machine cuts off is
// not named. With `deploy/check --full` only.
#include <map>
#include <nlohmann/json.hpp>

#include "tests/integration/cli/program.h"

namespace rg {
namespace {

using nlohmann::json;

bool HasRos() {
  return std::filesystem::exists("/usr/bin/rosmaster") &&
         std::filesystem::exists(BinDir() + "/realitygrad-kinova-stand-in");
}

// effect -> on how many joints.
std::map<std::string, size_t> NamesOf(const json& iteration) {
  std::map<std::string, size_t> names;
  for (const json& finding : iteration["diagnosis"]["findings"])
    names[finding["effect"]] = finding["joints"].size();
  return names;
}

TEST(RunKinovaDiagnosed, NamesWhatTheStandInHidesAndTheSecondIterationIsBetter) {
  if (!HasRos()) GTEST_SKIP() << "SKIPPED: no rosmaster (python3-rosmaster), or built without roscpp";
  const ScratchFolder scratch;
  const Said said = RunProgram(
      scratch, "run --driver kinova --stand-in --diagnose --iterations 2 --seed 1 --dir r --output json");
  ASSERT_EQ(said.code, 0) << said.err;
  const json iterations = json::parse(said.out)["iterations"];
  ASSERT_EQ(iterations.size(), 2u);
  for (const json& iteration : iterations) {
    EXPECT_EQ(iteration["rollout"]["end_reason"], "completed");
    const auto names = NamesOf(iteration);
    const auto said_so = " in " + json(names).dump();
    // A Coulomb force and a dead band of the torques look alike where a joint never rests under a small
    // torque: each joint's is in one of the two.
    EXPECT_TRUE(names.contains("torque_deadband")) << said_so;
    EXPECT_GE(names.contains("torque_deadband") ? names.at("torque_deadband") : 0, 3u) << said_so;
    EXPECT_TRUE(names.contains("coulomb_friction") || names.contains("stribeck_friction")) << said_so;
    EXPECT_TRUE(names.contains("viscous_friction")) << said_so;
    EXPECT_TRUE(names.contains("actuator_lag") || names.contains("actuator_delay")) << said_so;
  }
  // The compensation's wrong masses, beside the names.
  const auto second = NamesOf(iterations[1]);
  EXPECT_TRUE(second.contains("parameters_only") || second.contains("payload")) << json(second).dump();

  const auto goal = [&](int k, const char* what) {
    return iterations[k]["rollout"]["goal_error"][what].get<double>();
  };
  EXPECT_LT(goal(1, "tip_distance_m"), 0.5 * goal(0, "tip_distance_m"));
  EXPECT_LT(goal(1, "joint_norm"), 0.5 * goal(0, "joint_norm"));
  // What the models made before a rollout predict of it; null: the simulation broke down.
  const json& unseen = iterations[1]["diagnosis"]["unseen"];
  const double diagnosed = unseen["diagnosed"]["window_rms"].get<double>();
  for (const char* other : {"identified", "nominal"}) {
    if (unseen[other]["window_rms"].is_number()) {
      EXPECT_LT(diagnosed, unseen[other]["window_rms"].get<double>()) << other;
    }
  }
  std::printf("tip %.1f -> %.1f mm, joints %.3f -> %.3f rad, unseen windows %.4f rad\n",
              1e3 * goal(0, "tip_distance_m"), 1e3 * goal(1, "tip_distance_m"), goal(0, "joint_norm"),
              goal(1, "joint_norm"), diagnosed);
}

}  // namespace
}  // namespace rg
