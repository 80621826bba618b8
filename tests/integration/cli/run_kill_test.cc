// `realitygrad run` whose programs are killed: it starts a worker again, or ends in one line, and what that line advises
// works. Real processes, kill -9.
#include <signal.h>

#include <functional>
#include <nlohmann/json.hpp>
#include <vector>

#include "tests/integration/cli/small_robot.h"

namespace rg {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr char kSmall[] =
    " --workers 1 --trajectories 8 --epochs 2 --aggregations 0 --examination 0 --controller mpc --goal 0.9 1.0 "
    "--excitation 0 --identify-seconds 0 --hops 1 --chains 1 --rounds 1 --iterations 1 ";

struct Process {
  pid_t pid = -1, parent = -1;
};

class KilledRun : public ::testing::Test {
 protected:
  KilledRun() {
    WriteSmallRobot(scratch_, json::array(), 0.0);
    json config = json::parse(ReadFile(scratch_ / "small_agent.json").value());
    config["simulated"]["lock_step"] = false;  // a rollout takes its time
    EXPECT_TRUE(WriteFileAtomically(scratch_ / "small_agent.json", config.dump()).ok());
  }
  ~KilledRun() override {
    if (run_ > 0) kill(run_, SIGKILL), waitpid(run_, nullptr, 0);
  }

  void Start(const std::string& flags) {
    run_ = fork();
    if (run_ != 0) return;
    if (chdir(scratch_.path().c_str()) != 0) _exit(9);
    const std::string command = "exec " + BinDir() + "/realitygrad run --robot ./small.robot.json --dir r" + kSmall + flags +
                                " >run.out 2>run.err";
    execl("/bin/sh", "sh", "-c", command.c_str(), nullptr);
    _exit(9);
  }
  bool Ended() {
    int how = 0;
    if (run_ < 0) return true;
    if (waitpid(run_, &how, WNOHANG) != run_) return false;
    code_ = WIFEXITED(how) ? WEXITSTATUS(how) : 128 + WTERMSIG(how);
    run_ = -1;
    return true;
  }
  // The run's exit code; ctest ends a run that never ends.
  int End() {
    while (!Ended()) usleep(20'000);
    return code_;
  }
  std::string Said() const { return ReadFile(scratch_ / "run.err").value(); }
  std::string LastSaid() const {
    const std::string said = Said();
    return said.substr(said.find_last_of('\n', said.size() - 2) + 1);
  }

  // Of this run: by program and a word of its command line.
  std::vector<Process> Find(const std::string& program, const std::string& word = "") const {
    std::vector<Process> found;
    std::error_code gone;
    for (const auto& entry : fs::directory_iterator("/proc")) {
      if (fs::read_symlink(entry.path() / "cwd", gone) != fs::path(scratch_.path())) continue;
      if (fs::read_symlink(entry.path() / "exe", gone).filename() != program) continue;
      std::ifstream command(entry.path() / "cmdline", std::ios::binary), status(entry.path() / "stat");
      const std::string words{std::istreambuf_iterator<char>(command), {}};
      std::string pid, name, state;
      pid_t parent = -1;
      status >> pid >> name >> state >> parent;
      if (words.find(word) != std::string::npos && state != "Z") found.push_back({std::stoi(pid), parent});
    }
    return found;
  }
  // The one that the run started itself; waits for it. -1: the run ended.
  pid_t Child(const std::string& program, const std::string& word = "") {
    while (!Ended()) {
      for (const Process& process : Find(program, word))
        if (process.parent == run_) return process.pid;
      usleep(10'000);
    }
    return -1;
  }
  void Kill(pid_t pid) {
    ASSERT_GT(pid, 0) << Said();
    kill(pid, SIGKILL);
  }
  // Until the arm has been driven for a while.
  void AwaitRollout() {
    for (int ticks = 0; ticks < 15 && !Ended();) {
      const rg::Said said = RunProgram(scratch_, "agent status --spool r/spool --output json");
      const json status = json::parse(said.out, nullptr, false);
      if (status.is_object() && status.value("phase", "") == "rollout") ticks = status.value("ticks", 0);
      usleep(20'000);
    }
    ASSERT_GT(run_, 0) << Said();
  }
  // The run ended in one line that says who and what to do, and doing that goes on to the end.
  void ExpectItGoesOn(const std::string& who) {
    const std::string last = LastSaid();
    EXPECT_NE(last.find(who), std::string::npos) << Said();
    const std::string advice = "go on with: realitygrad ";
    const size_t at = last.find(advice);
    ASSERT_NE(at, std::string::npos) << last;
    const rg::Said again = RunProgram(scratch_, last.substr(at + advice.size(), last.size() - at - advice.size() - 1) +
                                                    " --output json");
    EXPECT_EQ(again.code, 0) << again.err;
    EXPECT_EQ(json::parse(again.out, nullptr, false)["iterations"].size(), 1u) << again.out;
  }

  const ScratchFolder scratch_;
  pid_t run_ = -1;
  int code_ = -1;
};

TEST_F(KilledRun, AWorkerThatIsKilledIsStartedAgain) {
  Start("--rollout-seconds 1 --lock-step");
  Kill(Child("realitygrad-worker", "worker-1"));
  EXPECT_EQ(End(), 0) << Said();
  EXPECT_NE(Said().find("the worker-1 was ended by signal 9 (log: r/logs/worker-1.log): started again, 1 of 3"),
            std::string::npos)
      << Said();
}

TEST_F(KilledRun, AWorkerThatIsKilledAgainAndAgainEndsIt) {
  Start("--rollout-seconds 1 --lock-step");
  pid_t last = -1;
  while (true) {
    const pid_t worker = Child("realitygrad-worker", "worker-1");
    if (worker < 0) break;
    if (worker != last) kill(last = worker, SIGKILL);
  }
  EXPECT_EQ(End(), 1);
  EXPECT_NE(Said().find("started again, 3 of 3"), std::string::npos) << Said();
  ExpectItGoesOn("the worker-1 was ended by signal 9");
}

TEST_F(KilledRun, AnAgentThatIsKilledInARolloutEndsIt) {
  Start("--rollout-seconds 4");
  AwaitRollout();
  Kill(Child("realitygrad-agent"));
  EXPECT_EQ(End(), 1);
  ExpectItGoesOn("the agent was ended by signal 9");
}

TEST_F(KilledRun, ACoordinatorThatIsKilledEndsIt) {
  Start("--rollout-seconds 1 --lock-step");
  Child("realitygrad-worker", "worker-1");
  Kill(Child("realitygrad-coordinator"));
  EXPECT_EQ(End(), 1);
  ExpectItGoesOn("the coordinator was ended by signal 9");
}

// The arm is gone, not the agent: the rollout ends, and the iteration goes on with what was recorded.
TEST_F(KilledRun, ASimulatedRobotThatIsKilledEndsItsRollout) {
  Start("--rollout-seconds 4 --slower-attempts 0");
  AwaitRollout();
  const std::vector<Process> robots = Find("realitygrad-simulated-robot");
  ASSERT_EQ(robots.size(), 1u);
  Kill(robots[0].pid);
  EXPECT_EQ(End(), 0) << Said();
  const std::string table = ReadFile(scratch_ / "run.out").value();
  EXPECT_NE(table.find("rollout 1: stopped by "), std::string::npos) << table;
}

}  // namespace
}  // namespace rg
