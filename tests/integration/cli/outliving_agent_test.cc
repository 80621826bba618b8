// An agent and a worker that outlive the coordinator's database, with all else as it is used: every job of the next one
// moves the arm as it asks, and no recording of another database stands for it.
#include <nlohmann/json.hpp>

#include "common/store/restore.h"
#include "tests/integration/cli/small_robot.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

using nlohmann::json;

constexpr double kPatience = 600.0;

class OutlivingAgent : public ::testing::Test {
 protected:
  OutlivingAgent() {
    WriteSmallRobot(scratch_, json::array(), 0.1);
    Start("realitygrad-worker", {"--folder", scratch_ / "w", "--slots", "1"});
    Start("realitygrad-agent", {"--folder", scratch_ / "a", "--config", scratch_ / "small_agent.json", "--spool",
                                scratch_ / "spool", "--trusted"});
    EXPECT_TRUE(service_.WaitForWorkers(2)) << Logs();
  }
  void MoveTo(const std::string& name) {
    service_.KillCoordinator();
    service_.UseDatabase(name);
    service_.StartCoordinator();
  }
  // The job as it ended.
  pb::GetJobReply Run(const std::string& what) {
    const Said said = RunProgram(scratch_, "--coordinator " + service_.endpoint() + " submit " + what +
                                               " --robot ./small.robot.json --model nominal --output quiet");
    EXPECT_EQ(said.code, 0) << said.err << Logs();
    const int64_t job = std::atoll(said.out.c_str());
    const auto end = client().WaitForJob(job, kPatience);
    EXPECT_TRUE(end.ok()) << end.status().ToString() << Logs();
    const auto reply = client().GetJob(job, true, true);
    if (!reply.ok()) return {};
    EXPECT_EQ(reply->job().state(), pb::JOB_STATE_SUCCEEDED) << what << ": " << reply->job().reason() << Logs();
    return *reply;
  }
  pb::GetJobReply Rollout(const std::string& goal, const std::string& seconds) {
    return Run("rollout --controller mpc --goal " + goal + " --rollout-seconds " + seconds);
  }
  // rollout.json of the job's recording.
  static json RecordingOf(const pb::GetJobReply& job) {
    for (const pb::TaskInfo& task : job.tasks()) {
      for (const pb::TaskOutput& output : task.outputs())
        if (output.kind() == "recording") return json::parse(output.metadata_json());
    }
    ADD_FAILURE() << "job " << job.job().id() << " has no recording";
    return json::object();
  }
  static void ExpectDone(const pb::GetJobReply& job, const std::vector<double>& goal, double seconds) {
    const json recording = RecordingOf(job);
    EXPECT_EQ(recording["end_reason"], "completed");
    EXPECT_EQ(recording["goal"], json(goal));
    EXPECT_EQ(recording["duration_s"], seconds);
    EXPECT_EQ(recording["ended_after_s"], seconds);
  }
  static std::map<std::string, std::string> PlansOf(const pb::GetJobReply& job) {
    std::map<std::string, std::string> plans;
    for (const pb::TaskInfo& task : job.tasks()) {
      for (const pb::TaskOutput& output : task.outputs())
        if (output.kind() == "trajectories" || output.kind() == "policy")
          plans[task.name() + "/" + output.name()] = output.sha256();
    }
    EXPECT_FALSE(plans.empty());
    return plans;
  }
  coordinator::Client& client() { return service_.client(); }
  std::string Logs() const {
    std::string text = service_.Logs();
    for (const auto& [name, program] : programs_) {
      const auto log = ReadFile(scratch_ / (name + ".log"));
      if (log.ok()) text += "--- " + name + "\n" + log->substr(log->size() - std::min<size_t>(log->size(), 3'000));
    }
    return text;
  }

  const ScratchFolder scratch_;
  Service service_{300};

 private:
  void Start(const std::string& name, std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {BinFolder() + "/" + name, "--coordinator", service_.endpoint(), "--name", name});
    programs_[name] = std::make_unique<Process>(arguments, scratch_ / (name + ".log"));
  }

  std::map<std::string, std::unique_ptr<Process>> programs_;
};

TEST_F(OutlivingAgent, RolloutsOfANewDatabaseMoveTheArmAsTheyAsk) {
  const auto first = Rollout("0.9 1.0", "1");
  ExpectDone(first, {0.9, 1.0}, 1.0);
  MoveTo("second.db");
  const auto other = Rollout("0.2 0.3", "2");
  EXPECT_EQ(other.job().id(), first.job().id());
  ExpectDone(other, {0.2, 0.3}, 2.0);
  MoveTo("third.db");
  const auto same = Rollout("0.9 1.0", "1");
  ExpectDone(same, {0.9, 1.0}, 1.0);
  EXPECT_NE(RecordingOf(same)["id"], RecordingOf(first)["id"]);
  EXPECT_NE(RecordingOf(same)["started"], RecordingOf(first)["started"]) << "it moved again";
  MoveTo("service.db");
  ExpectDone(Rollout("0.5 0.6", "1"), {0.5, 0.6}, 1.0);
}

TEST_F(OutlivingAgent, RolloutsAfterARestoreMoveTheArmAsTheyAsk) {
  ExpectDone(Rollout("0.9 1.0", "1"), {0.9, 1.0}, 1.0);
  const auto backup = client().Backup("backup.db");
  ASSERT_TRUE(backup.ok()) << backup.status().ToString();
  const auto lost = Rollout("0.8 0.9", "1");
  service_.KillCoordinator();
  ASSERT_TRUE(store::RestoreDatabase({backup->path(), service_.database(), true}, {}).ok());
  service_.StartCoordinator();
  const auto next = Rollout("0.2 0.3", "2");
  EXPECT_EQ(next.job().id(), lost.job().id()) << "its number is given again";
  ExpectDone(next, {0.2, 0.3}, 2.0);
}

TEST_F(OutlivingAgent, TrajectoriesAndIterationsOfTwoInTurn) {
  const std::string trajectories = "trajectories --trajectories 4 --shard-size 2 --seed ";
  const std::string iteration =
      "iteration --trajectories 8 --shard-size 2 --epochs 3 --aggregations 0 --examination 0 --rollout-seconds 2 "
      "--identify-seconds 0 --hops 1 --rounds 2 --chains 2";
  const auto planned = PlansOf(Run(trajectories + "1"));
  const auto first = Run(iteration);
  MoveTo("second.db");
  EXPECT_NE(PlansOf(Run(trajectories + "2")), planned);
  const auto second = Run(iteration);
  EXPECT_EQ(PlansOf(second), PlansOf(first)) << "same seeds";
  EXPECT_NE(RecordingOf(second)["id"], RecordingOf(first)["id"]);
  EXPECT_NE(RecordingOf(second)["started"], RecordingOf(first)["started"]);
  MoveTo("service.db");
  EXPECT_EQ(PlansOf(Run(trajectories + "1")), planned);
  EXPECT_EQ(RecordingOf(Run(iteration))["end_reason"], RecordingOf(first)["end_reason"]);
  const auto workers = client().Workers();
  for (const auto& worker : *workers) EXPECT_EQ(worker.tasks_failed(), 0u) << worker.name();
}

}  // namespace
}  // namespace rg::testing
