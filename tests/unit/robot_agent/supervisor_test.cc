#include "robot_agent/supervisor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"
#include "robot_agent/agent_commands.h"
#include "robot_agent/drivers/kinova/arm_session.h"
#include "robot_agent/local_socket.h"
#include "robot_agent/safety/latch.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;
using testing::HasSubstr;

class AgentFolder : public testing::Test {
 protected:
  AgentFolder() {
    // Longer than the path of a socket may be.
    folder_ = (std::filesystem::temp_directory_path() / ("rg-agent-" + RandomHex(6)) / std::string(90, 'x'))
                  .string();
    std::filesystem::create_directories(folder_);
    options_.spool_folder = folder_;
    options_.robot = "mico2";
    options_.driver = "kinova";
  }
  ~AgentFolder() override { std::filesystem::remove_all(std::filesystem::path(folder_).parent_path()); }
  static bool Soon(const std::function<bool()>& done) {
    const double give_up = RealClock().SteadySeconds() + 20;
    while (!done() && RealClock().SteadySeconds() < give_up) usleep(1000);
    return done();
  }
  // The agent in a process of its own; its pid.
  pid_t Start(const std::function<int()>& run_worker) {
    const pid_t pid = fork();
    if (pid == 0) _exit(Supervise(options_, run_worker, [](double) {}));
    EXPECT_TRUE(Soon([&] { return AskLocally(folder_, "status").ok(); }));
    return pid;
  }
  static int End(pid_t pid) {
    int how = 0;
    waitpid(pid, &how, 0);
    return WIFEXITED(how) ? WEXITSTATUS(how) : -1;
  }
  json Ask(const std::string& line) const {
    const auto text = AskLocally(folder_, line);
    return text.ok() ? json::parse(*text) : json{{"error", text.status().message()}};
  }
  int Command(const std::vector<std::string>& words) const {
    std::vector<std::string> all = {"realitygrad"};
    all.insert(all.end(), words.begin(), words.end());
    all.insert(all.end(), {"--spool", folder_, "--output", "json"});
    return RunAgentCommand(all).value();
  }

  std::string folder_;
  SupervisorOptions options_;
};

// A worker that moves the arm until a stop is asked for, then needs `rest_ms` for it to come to rest; a
// second SIGTERM kills it.
int MovingWorker(const std::string& folder, int rest_ms) {
  static volatile sig_atomic_t signals = 0;
  signal(SIGTERM, [](int) {
    signals = signals + 1;
    if (signals > 1) _exit(66);
  });
  auto board = Board::Open(folder).value();
  board->SetMover(getpid());
  while (board->stops() == 0) usleep(2000);
  usleep(1000 * rest_ms);
  if (!WriteFileAtomically(folder + "/at_rest", "").ok()) return 1;
  board->SetMover(0);
  while (signals == 0) usleep(2000);
  return 0;
}

TEST_F(AgentFolder, ArmsDisarmsAndTellsHowItIsWithoutACoordinator) {
  const pid_t pid = Start([] { return pause(), 0; });
  EXPECT_EQ(Ask("status")["armed"], false) << "a real arm is armed by a person";
  EXPECT_EQ(Command({"arm"}), 0);
  EXPECT_EQ(Ask("status")["armed"], true);
  EXPECT_EQ(Command({"stop"}), 0);
  EXPECT_EQ(Ask("status")["armed"], false);
  EXPECT_EQ(Ask("status")["phase"], "idle");
  EXPECT_EQ(Ask("dance")["ok"], false);
  EXPECT_EQ(Command({"arm"}), 0);
  EXPECT_EQ(Command({"disarm"}), 0);
  EXPECT_EQ(Ask("status")["armed"], false);
  kill(pid, SIGTERM);
  EXPECT_EQ(End(pid), 1);  // this worker does not drain
  EXPECT_EQ(Command({"status"}), 6) << "no agent";
}

TEST_F(AgentFolder, TheSpaceBarStopsTheArmWhereSomebodyWatches) {
  options_.armed = true;
  const pid_t agent = Start([] { return pause(), 0; });
  const int terminal = posix_openpt(O_RDWR | O_NOCTTY);
  ASSERT_TRUE(terminal >= 0 && grantpt(terminal) == 0 && unlockpt(terminal) == 0);
  const std::string name = ptsname(terminal);
  const pid_t watcher = fork();
  if (watcher == 0) {
    const int end = open(name.c_str(), O_RDWR);
    dup2(end, 0), dup2(end, 1);
    _exit(RunAgentCommand({"realitygrad", "watch", "--spool", folder_, "--every", "0.05"}).value());
  }
  std::thread reading([terminal] {
    for (char text[4096]; read(terminal, text, sizeof text) > 0;) {
    }
  });
  EXPECT_EQ(Ask("status")["armed"], true);
  EXPECT_TRUE(Soon([&] {
    (void)!write(terminal, "x ", 2);  // before the terminal listens to single keys they wait for the end of a line
    usleep(50'000);
    return Ask("status")["armed"] == false;
  }));
  kill(watcher, SIGTERM);
  EXPECT_EQ(End(watcher), 0);
  reading.join();
  close(terminal);
  kill(agent, SIGTERM);
  End(agent);
}

TEST_F(AgentFolder, AnArmThatIsLatchedIsNotArmedUntilSomebodyCleared) {
  Latch latch(folder_);
  ASSERT_TRUE(latch.Set("rollout-7", "the arm moves at 0.3 rad/s", "then").ok());
  const pid_t pid = Start([] { return pause(), 0; });
  EXPECT_EQ(Ask("status")["latched"], true);
  EXPECT_THAT(Ask("arm")["error"].get<std::string>(), HasSubstr("realitygrad agent clear"));
  EXPECT_EQ(Command({"arm"}), 1);
  EXPECT_EQ(Command({"clear"}), 0);
  EXPECT_EQ(Command({"arm"}), 0);
  kill(pid, SIGTERM);
  End(pid);
  ASSERT_TRUE(latch.Set("rollout-8", "again", "then").ok());
  EXPECT_EQ(Command({"clear"}), 0) << "also where no agent runs";
  EXPECT_FALSE(latch.Read().has_value());
}

TEST_F(AgentFolder, ASecondSignalNeverSkipsTheStop) {
  options_.armed = true;
  const std::string folder = folder_;
  for (const int first : {SIGINT, SIGTERM}) {
    std::filesystem::remove(folder_ + "/at_rest");
    std::filesystem::remove(folder_ + "/board");
    const pid_t pid = Start([folder] { return MovingWorker(folder, 300); });
    ASSERT_TRUE(Soon([&] { return Board::Open(folder).value()->mover() != 0; }));
    for (int k = 0; k < 5; ++k) {  // an impatient person
      kill(pid, k == 0 ? first : SIGINT);
      usleep(10'000);
    }
    const int code = End(pid);
    EXPECT_TRUE(std::filesystem::exists(folder + "/at_rest")) << "somebody left before the arm was at rest";
    EXPECT_TRUE(code == 0 || code == 66) << code;
  }
}

TEST_F(AgentFolder, AFirstSigtermLetsTheRolloutFinish) {
  options_.armed = true;
  const std::string folder = folder_;
  const pid_t pid = Start([folder] {
    static volatile sig_atomic_t told = 0;
    signal(SIGTERM, [](int) { told = 1; });
    while (!told) usleep(2000);
    usleep(200'000);  // the rest of the rollout
    return Board::Open(folder).value()->stops() == 0 ? 5 : 6;
  });
  usleep(50'000);
  kill(pid, SIGTERM);
  EXPECT_EQ(End(pid), 5);
}

// Of an arm that is away, 9 s and more.
TEST(SupervisorOptions, WaitForTheLongestStop) { EXPECT_GE(SupervisorOptions().stop_patience_s, LongestEnd()); }

TEST_F(AgentFolder, AWorkerThatDoesNotStopIsLeftAfterALongWhile) {
  options_.armed = true;
  options_.stop_patience_s = 0.3;
  const std::string folder = folder_;
  const pid_t pid = Start([folder] {
    static volatile sig_atomic_t signals = 0;
    signal(SIGTERM, [](int) {
      signals = signals + 1;
      if (signals > 1) _exit(66);
    });
    Board::Open(folder).value()->SetMover(getpid());
    while (true) pause();
    return 0;
  });
  ASSERT_TRUE(Soon([&] { return Board::Open(folder).value()->mover() != 0; }));
  const double before = RealClock().SteadySeconds();
  kill(pid, SIGINT);
  usleep(10'000);
  kill(pid, SIGINT);
  EXPECT_EQ(End(pid), 66);
  EXPECT_GT(RealClock().SteadySeconds() - before, 0.3);
}

TEST_F(AgentFolder, TwoAgentsBesideOneSpoolAreOneTooMany) {
  const pid_t pid = Start([] { return pause(), 0; });
  const pid_t second = fork();
  if (second == 0)
    _exit(Supervise(
        options_, [] { return 0; }, [](double) {}));
  EXPECT_EQ(End(second), 1);
  EXPECT_TRUE(AskLocally(folder_, "status").ok()) << "the first one is still there";
  kill(pid, SIGTERM);
  End(pid);
}

TEST(AgentCommands, OtherWordsAreTheProgramsOwn) {
  EXPECT_FALSE(RunAgentCommand({"agent"}).has_value());
  EXPECT_FALSE(RunAgentCommand({"agent", "--config", "x"}).has_value());
  EXPECT_EQ(RunAgentCommand({"agent", "frobnicate"}).value(), 2);
  EXPECT_EQ(RunAgentCommand({"agent", "status", "--sool", "x"}).value(), 2);
  EXPECT_EQ(RunAgentCommand({"agent", "status", "--output", "yaml"}).value(), 2);
}

TEST(AgentCommands, TheStatusShowsJointsAgainstTheirLimitsAndWhatToDo) {
  const json status = {{"ok", true},
                       {"robot", "mico2"},
                       {"driver", "kinova"},
                       {"armed", true},
                       {"phase", "rollout"},
                       {"mode", "torque"},
                       {"rollout", "job3-rollout"},
                       {"latched", true},
                       {"latch", {{"rollout", "r"}, {"reason", "still moving"}, {"since", "noon"}}},
                       {"joints",
                        {{{"name", "joint_1"},
                          {"q", 0.0},
                          {"v", 0.1},
                          {"command", 2.0},
                          {"lower", -1.0},
                          {"upper", 1.0},
                          {"velocity", 1.5},
                          {"torque", 30.5}},
                         {{"name", "joint_2"},
                          {"q", 1.5},
                          {"v", 0.1},
                          {"command", 2.0},
                          {"lower", -1.0},
                          {"upper", 1.0},
                          {"velocity", 1.5},
                          {"torque", 30.5}}}},
                       {"last_end", {{"reason", "velocity_limit"}, {"detail", "joint_1: fast"}}},
                       {"spool", {{"folder", "/tmp/s"}, {"recording", 0}, {"waiting", 2}, {"broken", 0}}}};
  const std::string text = StatusText(status.dump());
  EXPECT_THAT(text, HasSubstr("mico2 (kinova): armed, rollout, torque mode"));
  EXPECT_THAT(text, HasSubstr("joint_1     [......#......]   0.0000  [#.......]   0.100  [#.......]    2.00\n"));
  EXPECT_THAT(text, HasSubstr("[............!]"));
  EXPECT_THAT(text, HasSubstr("LATCHED since noon"));
  EXPECT_THAT(text, HasSubstr("last end: velocity_limit (joint_1: fast)"));
  EXPECT_THAT(text, HasSubstr("2 waiting"));
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 80u) << line;
}

// Whoever does one of these stands beside the arm and may have touched it: its preparation is done again.
TEST_F(AgentFolder, ArmDisarmAndClearEndTheArmsSession) {
  const auto board = Board::Create(folder_).value();
  const kinova::SessionFile session(folder_ + "/" + kinova::kSessionFile);
  for (const char* word : {"arm", "disarm", "clear"}) {
    ASSERT_TRUE(session.Write({.prepared_ns = 1, .arm = "a", .number = 1, .responses = {}}).ok());
    AnswerRequest(options_, *board, "status");
    EXPECT_TRUE(session.Read().has_value());
    AnswerRequest(options_, *board, word);
    EXPECT_FALSE(session.Read().has_value()) << word;
  }
}

}  // namespace
}  // namespace rg::robot_agent
