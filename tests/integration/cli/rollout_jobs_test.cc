// Jobs that move an arm, asked for again and cancelled: coordinator, worker, agent, guard and a simulated arm, which does
// not wait for real time.
#include <chrono>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "tests/integration/cli/small_robot.h"

namespace rg {
namespace {

using nlohmann::json;

class RolloutJobs : public ::testing::Test {
 protected:
  RolloutJobs() {
    WriteSmallRobot(scratch_, json::array(), 0.0);
    coordinator_.emplace(scratch_, "realitygrad-coordinator", "--listen " + address() + " --db c.db");
    worker_.emplace(scratch_, "realitygrad-worker", "--coordinator " + address() + " --folder ww");
  }
  ~RolloutJobs() override { EndAgent(); }

  void StartAgent(const std::vector<double>& torque, const std::string& flags) {
    json config = json::parse(ReadFile(scratch_ / "small_agent.json").value());
    config["limits"]["torque"] = torque;
    ASSERT_TRUE(WriteFileAtomically(scratch_ / "small_agent.json", config.dump()).ok());
    agent_.emplace(scratch_, "realitygrad-agent",
                   "--coordinator " + address() + " --config small_agent.json --spool spool --folder w " + flags);
  }
  // It hands in what waits.
  void EndAgent() {
    if (!agent_) return;
    const std::string pid = ReadFile(scratch_ / "realitygrad-agent.pid").value();
    agent_.reset();
    const std::string process = "/proc/" + pid.substr(0, pid.find('\n')) + "/exe";  // a zombie has none
    std::error_code gone;
    for (int i = 0; i < 1200 && !std::filesystem::read_symlink(process, gone).empty(); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  Said Run(const std::string& arguments) {
    return RunProgram(scratch_, "--coordinator " + address() + " " + arguments);
  }
  Said Submit(const std::string& flags) {
    return Run("submit rollout --robot ./small.robot.json --model nominal --controller mpc --goal 0.9 1.0 " + flags);
  }
  // What the store has of recordings, the first to come first: rollout.json.
  std::vector<json> Recordings() {
    const Said said = Run("artifacts list --kind recording --output json");
    EXPECT_EQ(said.code, 0) << said.err;
    std::vector<json> all;
    const json list = json::parse(said.out);
    for (const json& artifact : list["artifacts"]) all.insert(all.begin(), artifact["metadata"]);
    return all;
  }
  bool AgentSays(const std::string& phase) {
    for (int i = 0; i < 400; ++i) {
      const Said said = RunProgram(scratch_, "agent status --spool spool --output json");
      const json status = json::parse(said.out, nullptr, false);
      if (status.is_object() && status.value("phase", "") == phase) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    return false;
  }
  std::string Logs() const { return ReadFile(scratch_ / "realitygrad-agent.log").value(); }

 private:
  std::string address() const { return "ipc://" + (scratch_ / "c.sock"); }

  const ScratchFolder scratch_;
  std::optional<Background> coordinator_, worker_, agent_;
};

// The fence lets no torque through: the rollout does not begin, the job fails and says so, what was recorded is in the
// store. With the fence mended the same job may be tried again, and begins once.
TEST_F(RolloutJobs, ARolloutThatDidNotBeginIsBegunByARetry) {
  StartAgent({1e-6, 1e-6}, "--trusted");
  const Said refused = Submit("--rollout-seconds 1 --timeout 300 --out r");
  EXPECT_NE(refused.code, 0);
  EXPECT_NE((refused.out + refused.err).find("the rollout did not begin: torque_limit"), std::string::npos)
      << refused.err << refused.out << Logs();
  EndAgent();
  const std::vector<json> before = Recordings();
  ASSERT_EQ(before.size(), 1u) << Logs();
  EXPECT_EQ(before[0]["end_reason"], "torque_limit");
  EXPECT_EQ(before[0]["began"], false);

  StartAgent({80, 40}, "--trusted");
  const Said again = Run("job retry last");
  EXPECT_EQ(again.code, 0) << again.err;
  const Said waited = Run("job wait last --timeout 300");
  EXPECT_EQ(waited.code, 0) << waited.err << waited.out << Logs();
  EndAgent();
  const std::vector<json> after = Recordings();
  ASSERT_EQ(after.size(), 2u) << Logs();
  EXPECT_NE(after[1]["id"], before[0]["id"]) << "another attempt";
  EXPECT_EQ(after[1]["end_reason"], "completed");
  EXPECT_EQ(after[1]["began"], true);
  const Said once_more = Run("job retry last");
  EXPECT_NE(once_more.code, 0) << "what succeeded is not tried again";
}

// A cancelled task is given no time at all: the rollout's process lives until its arm was seen at rest all the same.
TEST_F(RolloutJobs, ACancelWaitsForTheStopAndTheRecordingSaysSo) {
  StartAgent({80, 40}, "--trusted --cancel-grace 0");
  std::thread person([this] { (void)Submit("--rollout-seconds 500 --timeout 300 --out r"); });
  EXPECT_TRUE(AgentSays("rollout")) << Logs();
  const Said cancelled = Run("job cancel last");
  EXPECT_EQ(cancelled.code, 0) << cancelled.err;
  person.join();
  EXPECT_TRUE(AgentSays("idle")) << Logs();
  EndAgent();
  const std::vector<json> recordings = Recordings();
  ASSERT_EQ(recordings.size(), 1u) << Logs();
  EXPECT_EQ(recordings[0]["end_reason"], "operator_stop") << recordings[0]["detail"];
  EXPECT_EQ(recordings[0]["stop"]["confirmed"], true);
}

}  // namespace
}  // namespace rg
