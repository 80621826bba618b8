// `realitygrad run --diagnose`: a robot with a cable that pulls at its elbow, which no inertia, friction or
// gain can stand for. The loop names it, plans with it, and is stopped and resumed on the way.
#include <signal.h>

#include <nlohmann/json.hpp>

#include "tests/integration/cli/small_robot.h"

namespace rg {
namespace {

using nlohmann::json;

const char kSmall[] =
    "run --diagnose --diagnose-threads 2 --robot ./small.robot.json --iterations 2 --dir r --workers 2 "
    "--lock-step "
    "--trajectories 8 --shard-size 4 --epochs 3 --aggregations 0 --examination 0 --controller mpc "
    "--rollout-seconds 3 --identify-seconds 0 --hops 1 --rounds 1 --chains 1";

size_t Results(const ScratchFolder& scratch) {
  const auto text = ReadFile(scratch / "r/run.json");
  const json run = text.ok() ? json::parse(*text, nullptr, false) : json();
  return run.is_object() && run.contains("results") ? run["results"].size() : 0;
}

// Ends it with Ctrl-C once it has an iteration.
void RunUntilTheFirstIterationIsDone(const ScratchFolder& scratch) {
  const pid_t pid = fork();
  if (pid == 0) {
    if (chdir(scratch.path().c_str()) != 0) _exit(9);
    const std::string command =
        "exec " + BinDir() + "/realitygrad " + kSmall + " --output quiet >stopped.out 2>stopped.err";
    execl("/bin/sh", "sh", "-c", command.c_str(), nullptr);
    _exit(9);
  }
  int how = 0;
  bool ended = false;
  while (!ended && Results(scratch) < 1) {
    usleep(20'000);
    ended = waitpid(pid, &how, WNOHANG) == pid;
  }
  if (!ended) {
    kill(pid, SIGINT);
    ASSERT_EQ(waitpid(pid, &how, 0), pid);
  }
  ASSERT_EQ(WEXITSTATUS(how), 4) << ReadFile(scratch / "stopped.err").value();
}

bool Named(const json& diagnosis, const std::string& effect, const std::string& joint) {
  for (const json& f : diagnosis["findings"]) {
    if (f["effect"] == effect && f["joints"] == json({joint})) return true;
  }
  return false;
}

TEST(RunDiagnose, NamesThePhysicsAndPredictsTheRobotBetterThanIdentificationAlone) {
  const ScratchFolder scratch;
  WriteSmallRobot(scratch,
                  {{{"effect", "position_spring"},
                    {"joints", {"elbow"}},
                    {"parameters", {{"stiffness", 20.0}, {"cubic", 0.0}, {"center", 0.2}}}}},
                  0.1);
  RunUntilTheFirstIterationIsDone(scratch);
  const Said said = RunProgram(scratch, "run --resume --dir r --output json");
  ASSERT_EQ(said.code, 0) << said.err;
  const json iterations = json::parse(said.out)["iterations"];
  ASSERT_EQ(iterations.size(), 2u);

  const json &first = iterations[0]["diagnosis"], &second = iterations[1]["diagnosis"];
  EXPECT_EQ(first["verdict"], "unmodelled_physics");
  EXPECT_TRUE(Named(first, "position_spring", "elbow")) << first.dump(1);
  EXPECT_EQ(first["unseen"].size(), 1u) << "before the first rollout there is the URDF only";
  EXPECT_EQ(second["rollouts"], 2) << "the recording from before the stop counts";

  // The second rollout was seen by none of the models that were made from the first.
  const auto unseen = [&](const char* model) { return second["unseen"][model]["window_rms"].get<double>(); };
  EXPECT_LT(unseen("diagnosed"), 0.2 * unseen("identified"));
  EXPECT_LT(unseen("identified"), unseen("nominal"));
  const auto goal_error = [&](int i) {
    return iterations[i]["rollout"]["goal_error"]["tip_distance_m"].get<double>();
  };
  EXPECT_LT(goal_error(1), 1e-3);

  const std::string page = ReadFile(scratch / "r/report.html").value();
  for (const char* text : {"position_spring of elbow", "identified only", "What the model leaves out"})
    EXPECT_NE(page.find(text), std::string::npos) << text;
  const json history =
      json::parse(RunProgram(scratch, "--coordinator r params history --output json").out)["versions"];
  EXPECT_NE(history.dump().find("position_spring"), std::string::npos) << history.dump(1);
}

}  // namespace
}  // namespace rg
