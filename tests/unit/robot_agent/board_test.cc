#include "robot_agent/board.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>

#include "common/base/clock.h"
#include "common/base/ids.h"

namespace rg::robot_agent {
namespace {

class BoardFolder : public testing::Test {
 protected:
  BoardFolder() : folder_((std::filesystem::temp_directory_path() / ("rg-board-" + RandomHex(6))).string()) {
    std::filesystem::create_directories(folder_);
  }
  ~BoardFolder() override { std::filesystem::remove_all(folder_); }

  // Waits for what another thread does soon; the time out only bounds a failure.
  static bool Soon(const std::function<bool()>& done) {
    const double give_up = RealClock().SteadySeconds() + 20;
    while (!done() && RealClock().SteadySeconds() < give_up) usleep(1000);
    return done();
  }

  std::string folder_;
};

TEST_F(BoardFolder, BothSidesSeeTheSame) {
  EXPECT_EQ(Board::Open(folder_).status().code(), StatusCode::kNotFound);
  auto agent = Board::Create(folder_).value();
  auto executor = Board::Open(folder_).value();
  EXPECT_FALSE(executor->armed()) << "nothing is armed by itself";
  agent->Arm(true);
  EXPECT_TRUE(executor->armed());
  ArmStatus status;
  status.phase = Phase::kRollout;
  status.q[3] = 1.25;
  executor->Publish(status);
  EXPECT_EQ(agent->Read().q[3], 1.25);
  EXPECT_EQ(agent->Read().phase, Phase::kRollout);
  agent->AskStop();
  EXPECT_EQ(executor->stops(), 1u);
  EXPECT_FALSE(executor->armed()) << "after a stop nothing begins by itself";
}

TEST_F(BoardFolder, AnAgentThatStartsAgainDisarmsAndSeesWhoStillMoves) {
  auto agent = Board::Create(folder_).value();
  agent->Arm(true);
  agent->SetMover(getpid());
  agent.reset();
  agent = Board::Create(folder_).value();
  EXPECT_FALSE(agent->armed());
  EXPECT_EQ(agent->mover(), getpid());
}

TEST_F(BoardFolder, AMoverThatDiedMovesNothing) {
  auto board = Board::Create(folder_).value();
  const pid_t child = fork();
  if (child == 0) _exit(0);
  board->SetMover(child);
  waitpid(child, nullptr, 0);
  EXPECT_EQ(board->mover(), 0);
}

TEST_F(BoardFolder, TheListenerHearsStopDisarmJobAndALostAgent) {
  auto board = Board::Create(folder_).value();
  const auto heard_after = [&](const std::function<void(CancelToken&)>& act) {
    board->Arm(true);
    board->Beat(RealClock().SteadyNanos() + 3'600'000'000'000);
    CancelToken job;
    const StopListener listener(*board, job);
    usleep(20'000);
    EXPECT_FALSE(listener.token().cancelled());
    act(job);
    return Soon([&] { return listener.token().cancelled(); });
  };
  EXPECT_TRUE(heard_after([&](CancelToken&) { board->AskStop(); }));
  EXPECT_TRUE(heard_after([&](CancelToken&) { board->Arm(false); }));
  EXPECT_TRUE(heard_after([&](CancelToken& job) { job.Cancel(); }));
  EXPECT_TRUE(heard_after(
      [&](CancelToken&) { board->Beat(RealClock().SteadyNanos() - StopListener::kAgentLost - 1); }));
}

TEST_F(BoardFolder, AReaderNeverSeesHalfAStatus) {
  auto board = Board::Create(folder_).value();
  std::atomic<bool> end{false};
  std::thread writer([&] {
    ArmStatus status;
    for (double x = 0; !end; ++x) {
      status.q.fill(x);
      status.torque.fill(x);
      board->Publish(status);
    }
  });
  for (int k = 0; k < 20000; ++k) {
    const ArmStatus seen = board->Read();
    ASSERT_EQ(seen.q.front(), seen.torque.back());
  }
  end = true;
  writer.join();
}

}  // namespace
}  // namespace rg::robot_agent
