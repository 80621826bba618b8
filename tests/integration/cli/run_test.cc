// `realitygrad run` end to end at small size: coordinator, workers, agent and simulated robot as real
// processes; the loop, its result, a stop in the middle and going on.
#include <signal.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/integration/cli/program.h"

namespace rg {
namespace {

using nlohmann::json;

const char kSmall[] =
    " --workers 2 --lock-step --trajectories 24 --shard-size 4 --epochs 15 --rollout-seconds 2 "
    "--identify-seconds 0 --hops 1 "
    "--rounds 2 --spread 0.4 --reach 0.35 ";

TEST(Run, ClosesTheGapOfTheFirstIterationAndKeepsEverything) {
  const ScratchFolder scratch;
  const Said said = RunProgram(scratch, std::string("run --iterations 1 --dir r --output json") + kSmall);
  ASSERT_EQ(said.code, 0) << said.err;
  const json result = json::parse(said.out);
  EXPECT_EQ(result["format"], "realitygrad.run-result/1");
  ASSERT_EQ(result["iterations"].size(), 1u);
  const json& iteration = result["iterations"][0];
  EXPECT_EQ(iteration["trajectories"]["solved"], 24);
  const double before = iteration["identification"]["before_windows"]["joint_rms"];
  const double after = iteration["identification"]["after_windows"]["joint_rms"];
  EXPECT_LT(after, before / 3) << "identification did not bring the simulation nearer to the recording";
  EXPECT_GT(iteration["rollout"]["rows"].get<int>(), 40);
  EXPECT_EQ(iteration["examination"]["pairs"], 60);
  EXPECT_LT(iteration["examination"]["mpc"]["median"].get<double>(), 0.02);

  const std::string page = ReadFile(scratch / "r/report.html").value();
  EXPECT_NE(page.find("joint_1"), std::string::npos);

  // The run's folder answers questions when everything has ended.
  const json jobs = json::parse(RunProgram(scratch, "--coordinator r jobs --output json").out)["jobs"];
  ASSERT_EQ(jobs.size(), 1u);
  EXPECT_EQ(jobs[0]["state"], "succeeded");
  const json history =
      json::parse(RunProgram(scratch, "--coordinator r params history --output json").out)["versions"];
  ASSERT_EQ(history.size(), 1u);
  EXPECT_EQ(history[0]["source"], "identified");
  EXPECT_EQ(history[0]["recording"].get<std::string>().size(), 64u);
  const json shown = json::parse(RunProgram(scratch, "--coordinator r params show --output json").out);
  EXPECT_GE(shown["values"].size(), 71u);
  const Said lineage =
      RunProgram(scratch, "--coordinator r artifacts lineage " + history[0]["model"].get<std::string>());
  for (const char* kind : {"recording", "policy", "trajectories", "hop-state"}) {
    EXPECT_NE(lineage.out.find(kind), std::string::npos) << kind << " is not in the lineage:\n"
                                                         << lineage.out;
  }
  EXPECT_EQ(RunProgram(scratch, "--coordinator r artifacts verify").code, 0);

  const json policy = json::parse(RunProgram(scratch, "--coordinator r policy show --output json").out);
  EXPECT_EQ(policy["layers"], json({18, 128, 128, 6}));
  EXPECT_GT(policy["points"].get<int>(), 24 * 25) << "the newest policy learned from answers, too";
  EXPECT_EQ(RunProgram(scratch, "--coordinator r policy export --onnx p.onnx").code, 0);
  EXPECT_NE(ReadFile(scratch / "p.onnx").value().find("observation"), std::string::npos);
}

TEST(Run, StoppedByCtrlCGoesOnWhereItWas) {
  const ScratchFolder scratch;
  // Begun with the programs that deploy/quickstart builds first, gone on with by the complete ones.
  const std::string program = BinDir() + "/../first/realitygrad";
  const pid_t pid = fork();
  if (pid == 0) {
    if (chdir(scratch.path().c_str()) != 0) _exit(9);
    const std::string command =
        "exec " + program + " run --iterations 1 --dir r --output quiet" + kSmall + " 2>stopped.err";
    execl("/bin/sh", "sh", "-c", command.c_str(), nullptr);
    _exit(9);
  }
  // Stop it once the job is on its way.
  for (int i = 0; i < 600 && !std::filesystem::exists(scratch / "r/address"); ++i) usleep(20'000);
  usleep(700'000);
  kill(pid, SIGINT);
  int how = 0;
  ASSERT_EQ(waitpid(pid, &how, 0), pid);
  ASSERT_TRUE(WIFEXITED(how));
  EXPECT_EQ(WEXITSTATUS(how), 4) << ReadFile(scratch / "stopped.err").value();
  EXPECT_NE(ReadFile(scratch / "stopped.err").value().find("--resume"), std::string::npos);

  const Said again = RunProgram(scratch, "run --resume --dir r --output json");
  ASSERT_EQ(again.code, 0) << again.err;
  EXPECT_EQ(json::parse(again.out)["iterations"].size(), 1u);
  // One job, not two: the second start found the first one's.
  EXPECT_EQ(json::parse(RunProgram(scratch, "--coordinator r jobs --output json").out)["jobs"].size(), 1u);
}

TEST(FirstPrograms, RunAnIterationByThemselves) {
  const ScratchFolder scratch;
  const std::string command = "cd " + scratch.path() + " && " + BinDir() +
                              "/../first/realitygrad run --iterations 1 --dir r --output quiet" + kSmall +
                              " 2>err";
  EXPECT_EQ(std::system(command.c_str()), 0) << ReadFile(scratch / "err").value();
  EXPECT_TRUE(std::filesystem::exists(scratch / "r/report.html"));
}

TEST(Run, RefusesImpossibleOptionsBeforeAnythingStarts) {
  const ScratchFolder scratch;
  const Said said = RunProgram(scratch, "run --dir r --trajectories 0");
  EXPECT_EQ(said.code, 2);
  EXPECT_NE(said.err.find("trajectories is 0, must be between 1"), std::string::npos) << said.err;
  EXPECT_FALSE(std::filesystem::exists(scratch / "r/realitygrad.db"));
  EXPECT_NE(RunProgram(scratch, "run --robot nobody").err.find("known robots"), std::string::npos);
}

}  // namespace
}  // namespace rg
