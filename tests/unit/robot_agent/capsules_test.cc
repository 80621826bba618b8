#include "robot_agent/safety/capsules.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/rng.h"
#include "robot_agent/agent_config.h"
#include "robot_agent/safety/own_arm.h"

namespace rg::robot_agent {
namespace {

using Eigen::Vector3d;
using nlohmann::json;
using testing::HasSubstr;

Vector3d Draw(Rng& rng) { return {rng.Uniform(-1, 1), rng.Uniform(-1, 1), rng.Uniform(-1, 1)}; }

TEST(SegmentDistance, IsTheSmallestOfAFineGrid) {
  Rng rng(3);
  for (int k = 0; k < 200; ++k) {
    const Vector3d a0 = Draw(rng), b0 = Draw(rng);
    const Vector3d a1 = k % 10 == 0 ? a0 : Draw(rng);                                         // a point
    const Vector3d b1 = k % 10 == 1 ? b0 : k % 10 == 2 ? Vector3d(b0 + a1 - a0) : Draw(rng);  // parallel
    double least = INFINITY;
    for (int i = 0; i <= 200; ++i)
      for (int j = 0; j <= 200; ++j)
        least = std::min(least, (a0 + i / 200.0 * (a1 - a0) - b0 - j / 200.0 * (b1 - b0)).norm());
    const double distance = SegmentDistance(a0, a1, b0, b1);
    EXPECT_LE(distance, least + 1e-12) << k;
    EXPECT_GT(distance, least - 0.02) << k;
    EXPECT_NEAR(distance, SegmentDistance(b1, b0, a0, a1), 1e-12) << k;
  }
}

json MicoWithParts() {
  json config = json::parse(
      ReadFile(std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/mico2_agent.json").value());
  config["capsules"] = {{{"name", "base"},
                         {"link", "link_base"},
                         {"from", {0, 0, 0}},
                         {"to", {0, 0, 0.16}},
                         {"radius", 0.06}},
                        {{"name", "hand"},
                         {"link", "link_6"},
                         {"from", {0, 0, 0}},
                         {"to", {0, 0, -0.1}},
                         {"radius", 0.05}}};
  config["apart"] = json::array({json::array({"base", "hand"})});
  return config;
}

Result<AgentConfig> Parse(const json& config) {
  return ParseAgentConfig(config.dump(), std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots",
                          "robot.json");
}

TEST(OwnArmParts, AFoldedArmOverlapsAStretchedOneDoesNot) {
  const auto config = Parse(MicoWithParts());
  ASSERT_TRUE(config.ok()) << config.status().ToString();
  OwnArm arm(*config->arm, Vector3d(0, 0, -9.81), config->parts);
  int pair = -1;
  const double up[6] = {0, M_PI, M_PI, 0, 0, 0};
  EXPECT_GT(arm.Clearance(up, &pair), 0.3);
  EXPECT_EQ(pair, 0);
  // Somewhere in the boxes of joints 2 and 3 the hand comes down to the base.
  double least = INFINITY;
  for (double q2 = 0.9; q2 < 5.4; q2 += 0.1)
    for (double q3 = 0.65; q3 < 5.6; q3 += 0.1) {
      const double q[6] = {0, q2, q3, 0, 0, 0};
      least = std::min(least, arm.Clearance(q, &pair));
    }
  EXPECT_LT(least, 0.0);
}

TEST(OwnArmParts, WrongPartsAreNamed) {
  const auto refusal = [](const std::function<void(json&)>& change) {
    json config = MicoWithParts();
    change(config);
    return Parse(config).status().message();
  };
  EXPECT_THAT(refusal([](json& c) { c.erase("apart"); }), HasSubstr("go together"));
  EXPECT_THAT(refusal([](json& c) { c["capsules"][0]["link"] = "tail"; }), HasSubstr("no link \"tail\""));
  EXPECT_THAT(refusal([](json& c) { c["capsules"][0]["radius"] = -1; }), HasSubstr("base: radius"));
  EXPECT_THAT(refusal([](json& c) { c["apart"][0][1] = "foot"; }), HasSubstr("no capsule \"foot\""));
  EXPECT_THAT(refusal([](json& c) { c["capsules"][1]["name"] = "base"; }), HasSubstr("there twice"));
  EXPECT_THAT(refusal([](json& c) { c["capsules"][1]["radius"] = 1.0; }), HasSubstr("which is a collision"));
}

}  // namespace
}  // namespace rg::robot_agent
