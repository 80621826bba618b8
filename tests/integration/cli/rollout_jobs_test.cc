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

  // The end effector may rise to `highest` [m]; the goal of Submit is at 0.68 m.
  void StartAgent(const std::vector<double>& torque, const std::string& flags, double highest = 2) {
    json config = json::parse(ReadFile(scratch_ / "small_agent.json").value());
    config["limits"]["torque"] = torque;
    config["limits"]["task_box"] = {{"lower", {-2, -2, -2}}, {"upper", {2, 2, highest}}};
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
  json RunJson(const std::string& arguments) {
    const Said said = Run(arguments + " --output json");
    return json::parse(said.out, nullptr, false);
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

  const ScratchFolder scratch_;

 private:
  std::string address() const { return "ipc://" + (scratch_ / "c.sock"); }

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

// Nothing is lost while nobody has armed the arm: the job says what it waits for, and begins by itself.
TEST_F(RolloutJobs, ARolloutWaitsUntilItsArmIsArmedAndSaysSo) {
  StartAgent({80, 40}, "--trusted --disarmed");
  ASSERT_EQ(Submit("--rollout-seconds 1").code, 0) << Logs();
  std::string reason;
  for (int i = 0; i < 600 && reason.empty(); ++i) {
    const json jobs = RunJson("jobs");
    if (jobs.is_object()) reason = jobs["jobs"][0].value("reason", "");
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  EXPECT_NE(reason.find("waits for small to be armed: realitygrad agent arm"), std::string::npos) << reason << Logs();
  EXPECT_EQ(RunJson("job show last")["state"], "queued");
  EXPECT_EQ(Run("robot hold small 'belt replaced'").code, 0);
  EXPECT_EQ(RunProgram(scratch_, "agent arm --spool spool").code, 0);
  const json held = RunJson("robot holds");
  EXPECT_EQ(held["holds"][0]["reason"], "belt replaced");
  EXPECT_NE(RunJson("jobs")["jobs"][0].value("reason", "").find("is held"), std::string::npos);
  EXPECT_EQ(Run("robot release small").code, 0);
  const Said waited = Run("job wait last --timeout 300");
  EXPECT_EQ(waited.code, 0) << waited.err << waited.out << Logs();
  EXPECT_EQ(RunJson("job show last")["reason"], "");
}

TEST_F(RolloutJobs, ARolloutFailsWhereNobodyArmsItsArmInTime) {
  StartAgent({80, 40}, "--trusted --disarmed --arm-timeout 0.5");
  const Said failed = Submit("--rollout-seconds 1 --wait --timeout 300");
  EXPECT_EQ(failed.code, 3) << failed.err << Logs();
  EXPECT_NE(failed.out.find("is disarmed"), std::string::npos) << failed.out;
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

// The fence ends the rollout on its last centimetres: the job failed and says how, what was recorded can be used, and what
// comes of it is not current until somebody says so.
TEST_F(RolloutJobs, ARolloutThatWasStoppedFailedAndItsRecordingCanBeUsed) {
  StartAgent({80, 40}, "--trusted", 0.65);
  const Said stopped = Submit("--rollout-seconds 3 --timeout 300 --out r");
  EXPECT_EQ(stopped.code, 3) << stopped.err << stopped.out << Logs();
  EXPECT_TRUE(std::filesystem::exists(scratch_ / "r/rec_000.csv")) << stopped.err;
  const json job = RunJson("job show last");
  EXPECT_EQ(job["state"], "failed");
  const std::string reason = job.value("reason", "");
  EXPECT_NE(reason.find("stopped by task_space_limit ("), std::string::npos) << reason;
  EXPECT_NE(reason.find(" of 3 s"), std::string::npos) << reason;

  // As the reason says, while the agent still runs.
  const std::string named = "artefact ";
  const std::string recording = reason.substr(reason.find(named) + named.size(), 12);
  const std::string identify = "submit identify --robot ./small.robot.json --model nominal --hops 1 --chains 1 --rounds 1 "
                               "--identify-seconds 0 --wait --timeout 300 --recording " + recording;
  const Said identified = Run(identify);
  EXPECT_EQ(identified.code, 0) << identified.err << reason;
  EXPECT_NE(identified.out.find("rollout stopped by task_space_limit"), std::string::npos) << identified.out;
  EXPECT_EQ(RunJson("params history")["current"], 0);
  EXPECT_NE(RunJson("params history")["versions"][0]["rollout"].dump().find("stopped by task_space_limit"),
            std::string::npos);
  EXPECT_EQ(Run(identify + " --accept-partial").code, 0);
  EXPECT_EQ(RunJson("params history")["current"], 2);
  EXPECT_NE(RunJson("job show last").value("reason", "").find("; accepted"), std::string::npos);

  const Said accepted = Submit("--rollout-seconds 3 --timeout 300 --accept-partial --wait");
  EXPECT_EQ(accepted.code, 0) << accepted.err;
  EXPECT_NE(RunJson("job show last").value("reason", "").find("stopped by task_space_limit"), std::string::npos);
  ASSERT_EQ(Recordings().size(), 2u);
  EndAgent();
  EXPECT_EQ(Recordings().size(), 2u) << "what the spool hands in is known by its bytes";
}

// Every rollout is ended early, also the slower ones: the loop goes on from the model that it learned all the same, says
// so, and no version of it becomes current unless that was asked for.
TEST(RunThatIsStopped, GoesOnAndHoldsItsVersionsBack) {
  const ScratchFolder scratch;
  WriteSmallRobot(scratch, json::array(), 0.0);
  json config = json::parse(ReadFile(scratch / "small_agent.json").value());
  config["limits"]["task_box"] = {{"lower", {-2, -2, -2}}, {"upper", {2, 2, 0.65}}};
  ASSERT_TRUE(WriteFileAtomically(scratch / "small_agent.json", config.dump()).ok());
  const std::string run =
      "run --robot ./small.robot.json --lock-step --workers 2 --trajectories 4 --epochs 2 --aggregations 0 --examination 0 "
      "--controller mpc --goal 0.9 1.0 --excitation 0 --rollout-seconds 3 --slower-attempts 1 --identify-seconds 0 --hops 1 "
      "--chains 1 --rounds 1 ";
  const Said said = RunProgram(scratch, run + "--iterations 2 --dir r");
  ASSERT_EQ(said.code, 0) << said.err;
  EXPECT_NE(said.out.find("task_space_limit"), std::string::npos) << said.out;
  EXPECT_NE(said.out.find("rollout 1: stopped by task_space_limit ("), std::string::npos) << said.out;
  EXPECT_NE(said.out.find("rollout 2: stopped by task_space_limit ("), std::string::npos) << said.out;
  EXPECT_NE(said.out.find("its parameters are not current, the next iteration goes on from them"), std::string::npos);
  EXPECT_NE(ReadFile(scratch / "r/report.html").value().find("stopped by task_space_limit"), std::string::npos);
  const auto history = [&](const std::string& folder) {
    return json::parse(RunProgram(scratch, "--coordinator " + folder + " params history --output json").out);
  };
  EXPECT_EQ(history("r")["versions"].size(), 2u);
  EXPECT_EQ(history("r")["current"], 0);
  const json jobs = json::parse(RunProgram(scratch, "--coordinator r jobs --output json").out)["jobs"];
  for (const json& job : jobs) {
    EXPECT_EQ(job["state"], "succeeded");
    EXPECT_NE(job["reason"].dump().find("rollout stopped by task_space_limit"), std::string::npos) << job;
  }
  ASSERT_EQ(RunProgram(scratch, run + "--iterations 1 --accept-partial --dir a").code, 0);
  EXPECT_EQ(history("a")["current"], 1);
}

}  // namespace
}  // namespace rg
