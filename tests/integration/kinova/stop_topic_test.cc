// The topic that stops the arm, through everything that hears it: a ROS master, the stand-in, guard, agent, coordinator.
#include <chrono>
#include <thread>

#include "tests/integration/cli/program.h"
#include "tests/integration/kinova/ros_rig.h"

namespace rg {
namespace {

using nlohmann::json;

class StopTopic : public RosTest {
 protected:
  void SetUp() override {
    RosTest::SetUp();
    if (IsSkipped()) return;
    const std::string robots = std::filesystem::absolute(Environment("RG_SOURCE_DIR") + "/deploy/robots/");
    json config = json::parse(ReadFile(robots + "mico2_kinova_agent.json").value());
    config["urdf"] = robots + "mico2.urdf";
    config["kinova"].update({{"least_rate_hz", 14}, {"command_timeout_s", 0.25}});  // the machine may be busy
    ASSERT_TRUE(WriteFileAtomically(scratch_ / "agent.json", config.dump()).ok());
  }
  Said Run(const std::string& arguments) { return RunProgram(scratch_, "--coordinator " + address() + " " + arguments); }
  void Submit() {
    const Said said = Run("submit rollout --robot mico2 --model nominal --controller mpc --rollout-seconds 2");
    ASSERT_EQ(said.code, 0) << said.err;
  }
  // That of the newest job.
  void ExpectFailure(const std::string& words) {
    const Said said = Run("job wait last --timeout 600");
    constexpr int kFailed = 3;
    EXPECT_EQ(said.code, kFailed) << said.err << Log();
    EXPECT_NE(said.out.find(words), std::string::npos) << said.out;
  }
  json Status() {
    return json::parse(RunProgram(scratch_, "agent status --spool spool --output json").out, nullptr, false);
  }
  bool AgentBecomes(const std::function<bool(const json&)>& wanted, const std::function<void()>& meanwhile = [] {}) {
    for (int i = 0; i < 1200; ++i) {
      const json status = Status();
      if (status.is_object() && status.contains("phase") && wanted(status)) return true;
      meanwhile();
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    return false;
  }
  std::string address() const { return "ipc://" + (scratch_ / "c.sock"); }
  std::string Log() const { return ReadFile(scratch_ / "realitygrad-agent.log").value(); }

  const ScratchFolder scratch_;
};

TEST_F(StopTopic, StopsAndDisarmsTheArmAndNothingMovesItUntilAPersonArmsIt) {
  const Child arm = StartStandIn([](json& config) { config["refuse_torque_mode"] = 0; });
  const Background coordinator(scratch_, "realitygrad-coordinator", "--listen " + address() + " --db c.db");
  const Background agent(scratch_, "realitygrad-agent", "--coordinator " + address() +
                                                            " --config agent.json --spool spool --folder w --arm --trusted");
  ASSERT_TRUE(AgentBecomes([](const json& status) { return status["armed"] == true; }));
  Submit();
  EXPECT_TRUE(AgentBecomes([](const json& status) { return status["phase"] == "moving"; })) << Log();
  // The stand-in publishes on the topic.
  EXPECT_TRUE(AgentBecomes([](const json& status) { return status["armed"] == false; },
                           [&] { arm.Signal(SIGHUP); }))
      << Log();
  ExpectFailure("operator_stop");
  EXPECT_TRUE(AgentBecomes([](const json& status) { return status["phase"] == "idle"; })) << Log();
  EXPECT_EQ(Status()["latched"], false) << "the arm was seen at rest";

  Submit();
  std::string waits;
  for (int i = 0; i < 600 && waits.find("to be armed") == std::string::npos; ++i) {
    waits = Run("jobs --state queued").out;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  EXPECT_NE(waits.find("waits for mico2 to be armed"), std::string::npos) << waits;
}

}  // namespace
}  // namespace rg
