// `realitygrad run --driver kinova --stand-in`: two iterations through real ROS topics.
#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <vector>

#include "tests/integration/cli/program.h"

namespace rg {
namespace {

using nlohmann::json;

const char kSmall[] =
    " --iterations 2 --workers 2 --trajectories 24 --shard-size 4 --epochs 15 --rollout-seconds 2 "
    "--identify-seconds 0 --hops 1 --rounds 2 --spread 0.4 --reach 0.35 ";

// With RG_KINOVA_SEEDS the command at its defaults, with so many seeds (`deploy/check --full`).
std::vector<std::string> Runs() {
  const char* seeds = std::getenv("RG_KINOVA_SEEDS");
  if (seeds == nullptr) return {kSmall};
  std::vector<std::string> out;
  for (int seed = 1; seed <= std::atoi(seeds); ++seed) out.push_back(" --iterations 2 --seed " + std::to_string(seed));
  return out;
}

bool HasRos() {
  return std::filesystem::exists("/usr/bin/rosmaster") &&
         std::filesystem::exists(BinDir() + "/realitygrad-kinova-stand-in");
}

// Processes that were started with the run's ROS_HOME.
int RunningOf(const std::string& run_folder) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    std::ifstream file(entry.path() / "environ", std::ios::binary);
    const std::string environment{std::istreambuf_iterator<char>(file), {}};
    count += environment.find("ROS_HOME=" + run_folder) != std::string::npos;
  }
  return count;
}

TEST(RunKinova, TwoIterationsThroughRealTopicsAndNothingIsLeftRunning) {
  if (!HasRos()) GTEST_SKIP() << "SKIPPED: no rosmaster (python3-rosmaster), or built without roscpp";
  for (const std::string& flags : Runs()) {
    SCOPED_TRACE(flags);
    const ScratchFolder scratch;
    const Said said =
        RunProgram(scratch, "run --driver kinova --stand-in --dir r --output json" + flags);
    ASSERT_EQ(said.code, 0) << said.err;
    const json result = json::parse(said.out);
    EXPECT_EQ(result["format"], "realitygrad.run-result/1");
    ASSERT_EQ(result["iterations"].size(), 2u);
    for (const json& iteration : result["iterations"]) {
      const json& rollout = iteration["rollout"];
      EXPECT_EQ(rollout["driver"], "kinova");
      EXPECT_EQ(rollout["adds_gravity_compensation"], true);
      EXPECT_GT(rollout["rows"].get<int>(), 10);
      EXPECT_EQ(rollout["held"], true);
      const double before = iteration["identification"]["before_windows"]["joint_rms"];
      const double after = iteration["identification"]["after_windows"]["joint_rms"];
      EXPECT_LT(after, before);
    }
    EXPECT_TRUE(std::filesystem::exists(scratch / "r/ros"));
    EXPECT_EQ(RunningOf(scratch / "r"), 0);
  }
}

TEST(RunKinova, RefusesWhatWouldReachARealArmOrCannotBe) {
  const ScratchFolder scratch;
  for (const auto& [flags, words] : std::vector<std::pair<std::string, std::string>>{
           {"--driver kinova", "needs --stand-in"},
           {"--stand-in", "needs --driver kinova"},
           {"--driver baxter", "must be simulated or kinova"},
           {"--driver kinova --stand-in --lock-step", "real time"}}) {
    const Said said = RunProgram(scratch, "run --dir r " + flags);
    EXPECT_EQ(said.code, 2) << flags;
    EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
    EXPECT_NE(said.err.find(words), std::string::npos) << said.err;
    EXPECT_FALSE(std::filesystem::exists(scratch / "r")) << flags;
  }
}

}  // namespace
}  // namespace rg
