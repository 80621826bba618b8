#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "robot_agent/agent_program.h"

namespace rg::robot_agent {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

std::string ConfigPath() {
  return std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/mico2_agent.json";
}

TEST(AgentSettings, OwnFlagsAreTakenAndTheRestGoesToTheWorker) {
  const auto settings = ReadAgentSettings({"agent", "--coordinator", "ipc:///tmp/x", "--config", ConfigPath(),
                                           "--spool=/tmp/s", "--lock-step", "--name", "a"})
                            .value();
  EXPECT_EQ(settings.config.name, "mico2");
  EXPECT_EQ(settings.spool_folder, "/tmp/s");
  EXPECT_TRUE(settings.config.simulated.lock_step);
  EXPECT_FALSE(settings.is_executor);
  EXPECT_EQ(settings.coordinator, "ipc:///tmp/x");
  EXPECT_THAT(settings.worker_arguments,
              ElementsAre("agent", "--coordinator", "ipc:///tmp/x", "--name", "a"));
}

TEST(AgentSettings, AnExecutorChildFindsThemInTheEnvironment) {
  setenv("REALITYGRAD_AGENT_CONFIG", ConfigPath().c_str(), 1);
  setenv("REALITYGRAD_AGENT_SPOOL", "/tmp/there", 1);
  const auto settings = ReadAgentSettings({"agent", "--executor-fd", "7"}).value();
  unsetenv("REALITYGRAD_AGENT_CONFIG");
  unsetenv("REALITYGRAD_AGENT_SPOOL");
  EXPECT_TRUE(settings.is_executor);
  EXPECT_EQ(settings.spool_folder, "/tmp/there");
  EXPECT_THAT(settings.worker_arguments, ElementsAre("agent", "--executor-fd", "7"));
}

TEST(AgentSettings, ArmedAndDryRunAreSaidOnTheCommandLine) {
  const auto read = [](std::vector<std::string> more) {
    std::vector<std::string> words{"agent", "--config", ConfigPath()};
    words.insert(words.end(), more.begin(), more.end());
    return ReadAgentSettings(words).value();
  };
  EXPECT_FALSE(read({}).armed.has_value());
  EXPECT_EQ(read({"--arm"}).armed, true);
  EXPECT_EQ(read({"--disarmed"}).armed, false);
  EXPECT_FALSE(read({}).config.dry_run);
  EXPECT_TRUE(read({"--dry-run"}).config.dry_run);
  EXPECT_THAT(read({"--dry-run", "--arm"}).worker_arguments, ElementsAre("agent"));
}

TEST(AgentSettings, FirstRolloutsAreShortAndSlowWhereTheArmIsReal) {
  const std::string folder = std::filesystem::path(ConfigPath()).parent_path().string();
  auto json = nlohmann::json::parse(ReadFile(ConfigPath()).value());
  const auto read = [&] { return ParseAgentConfig(json.dump(), folder, "robot.json"); };
  EXPECT_FALSE(read()->first_rollouts.on()) << "a simulated arm";
  json["first_rollouts"] = {{"duration_s", 1.5}, {"speed", 0.3}};
  EXPECT_EQ(read()->first_rollouts.duration_s, 1.5);
  EXPECT_EQ(read()->first_rollouts.speed, 0.3);
  json["first_rollouts"]["speed"] = 1.2;
  EXPECT_THAT(read().status().message(), HasSubstr("first_rollouts: speed is 1.2"));
  json["first_rollouts"]["speed"] = 0;
  EXPECT_THAT(read().status().message(), HasSubstr("first_rollouts: speed is 0"));
  json["first_rollouts"] = {{"duration", 1}};
  EXPECT_THAT(read().status().message(), HasSubstr("first_rollouts: unknown field \"duration\""));
  json.erase("first_rollouts");
  json["driver"] = "kinova";
  if (const auto kinova = read(); kinova.ok()) {
    EXPECT_EQ(kinova->first_rollouts.duration_s, 2.0);
    EXPECT_EQ(kinova->first_rollouts.speed, 0.4);
    json["first_rollouts"] = nullptr;
    EXPECT_FALSE(read()->first_rollouts.on());
  }
}

TEST(AgentSettings, AMissingOrWrongConfigIsOneClearLine) {
  EXPECT_THAT(ReadAgentSettings({"agent"}).status().message(), HasSubstr("--config"));
  EXPECT_FALSE(ReadAgentSettings({"agent", "--config", "/nonexistent"}).ok());
  EXPECT_THAT(ParseAgentConfig(R"({"format": "realitygrad.agent/1", "nmae": "x"})", ".", "robot.json")
                  .status()
                  .message(),
              HasSubstr("robot.json: unknown field \"nmae\""));
}

// Nothing of the fence has a default that somebody else could fill in.
TEST(AgentSettings, WhatTheFenceNeedsIsAskedForByName) {
  const std::string folder = std::filesystem::path(ConfigPath()).parent_path().string();
  const auto good = nlohmann::json::parse(ReadFile(ConfigPath()).value());
  ASSERT_TRUE(ParseAgentConfig(good.dump(), folder, "robot.json").ok());
  for (const char* field : {"urdf", "limits"}) {
    auto json = good;
    json.erase(field);
    EXPECT_THAT(ParseAgentConfig(json.dump(), folder, "robot.json").status().message(),
                HasSubstr("robot.json: \"" + std::string(field) + "\" is missing"));
  }
  for (const char* field : {"lower", "upper", "velocity", "torque", "torque_rate", "task_box"}) {
    auto json = good;
    json["limits"].erase(field);
    EXPECT_THAT(ParseAgentConfig(json.dump(), folder, "robot.json").status().message(),
                HasSubstr("robot.json: limits: \"" + std::string(field) + "\" is missing"));
  }
  auto json = good;
  json["limits"]["torque"][2] = -3;
  EXPECT_THAT(ParseAgentConfig(json.dump(), folder, "robot.json").status().message(),
              HasSubstr("torque of joint_3 is -3"));
}

}  // namespace
}  // namespace rg::robot_agent
