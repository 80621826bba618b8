// First rollouts are short and slow and grow with what was recorded; the fence takes some of that back. Coordinator,
// worker, agent, guard and a simulated arm, which does not wait for real time.
#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/integration/cli/small_robot.h"

namespace rg {
namespace {

using nlohmann::json;

class Laboratory {
 public:
  Laboratory() {
    WriteSmallRobot(scratch_, json::array(), 0.0);
    coordinator_.emplace(scratch_, "realitygrad-coordinator", "--listen " + address() + " --db c.db");
    worker_.emplace(scratch_, "realitygrad-worker", "--coordinator " + address() + " --folder ww");
  }

  // An agent that lets the end effector rise to `highest` [m]; its first rollouts take a second at half the speed.
  void StartAgent(double highest) {
    json config = json::parse(ReadFile(scratch_ / "small_agent.json").value());
    config["first_rollouts"] = {{"duration_s", 1.0}, {"speed", 0.5}};
    config["limits"]["task_box"] = {{"lower", {-2, -2, -2}}, {"upper", {2, 2, highest}}};
    ASSERT_TRUE(WriteFileAtomically(scratch_ / "small_agent.json", config.dump()).ok());
    agent_.emplace(scratch_, "realitygrad-agent",
                   "--coordinator " + address() + " --config small_agent.json --spool spool --folder w --lock-step");
  }
  void EndAgent() {
    const std::string pid = ReadFile(scratch_ / "realitygrad-agent.pid").value();
    agent_.reset();
    const std::string process = "/proc/" + pid.substr(0, pid.find('\n')) + "/exe";  // a zombie has none
    std::error_code gone;
    for (int i = 0; i < 600 && !std::filesystem::read_symlink(process, gone).empty(); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }

  // A rollout of three seconds, and a parameter version identified from it.
  json RolloutAndIdentification() {
    const std::string folder = "r" + std::to_string(++count_);
    Submit("rollout --controller mpc --goal 0.9 1.0 --rollout-seconds 3 --accept-partial --out " + folder);
    Submit("identify --hops 1 --chains 1 --rounds 1 --identify-seconds 0 --wait");
    return json::parse(ReadFile(scratch_ / (folder + "/rollout.json")).value());
  }

 private:
  std::string address() const { return "ipc://" + (scratch_ / "c.sock"); }
  void Submit(const std::string& what) {
    const size_t verb = what.find(' ');
    const Said said =
        RunProgram(scratch_, "--coordinator " + address() + " submit " + what.substr(0, verb) +
                                 " --robot ./small.robot.json --model nominal --timeout 300" + what.substr(verb));
    ASSERT_EQ(said.code, 0) << said.err << said.out;
  }

  const ScratchFolder scratch_;
  std::optional<Background> coordinator_, worker_, agent_;
  int count_ = 0;
};

void ExpectTrust(const json& rollout, double trust, const char* end) {
  EXPECT_EQ(rollout["end_reason"], end) << rollout["detail"];
  EXPECT_NEAR(rollout["trust"].get<double>(), trust, 1e-9);
  EXPECT_NEAR(rollout["duration_s"].get<double>(), 1.0 + 2.0 * trust, 1e-9);
  EXPECT_NEAR(rollout["limits"]["velocity"][0].get<double>(), 6.0 * (0.5 + 0.5 * trust), 1e-9);
}

TEST(TrustGrowth, GrowsWithEachRolloutThatEndedAsAskedAndTheFenceTakesHalfOfIt) {
  Laboratory laboratory;
  laboratory.StartAgent(1.0);
  for (const double trust : {0.0, 0.25, 0.5}) ExpectTrust(laboratory.RolloutAndIdentification(), trust, "completed");
  laboratory.EndAgent();
  // The goal is at 0.68 m: the arm is stopped on its last centimetres.
  laboratory.StartAgent(0.65);
  ExpectTrust(laboratory.RolloutAndIdentification(), 0.75, "task_space_limit");
  laboratory.EndAgent();
  laboratory.StartAgent(1.0);
  ExpectTrust(laboratory.RolloutAndIdentification(), 0.375, "completed");
  ExpectTrust(laboratory.RolloutAndIdentification(), 0.625, "completed");
}

}  // namespace
}  // namespace rg
