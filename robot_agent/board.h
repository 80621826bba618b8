// What the agent and the process that moves the arm tell each other: a file of the spool's folder, mapped by
// both. Armed or not, stops that were asked for, whether the agent is alive; and how the arm is. Reading and
// writing take no system call, no lock and no allocation, so that the control cycle may do it.
//
// The agent (supervisor.h) creates it, and beats; the executor of a rollout opens it. Whoever moves the arm
// is its `mover` while it does. Fields of one word are atomic. Of the status there are two, the newest whole one
// and one to write: a writer that is interrupted, or dies, leaves the newest whole one readable.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "robot_agent/control_loop.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/safety/limits.h"

namespace rg::robot_agent {

enum class Phase : uint32_t { kIdle = 0, kConnecting = 1, kMoving = 2, kRollout = 3, kStopping = 4 };
const char* PhaseName(Phase phase);

struct ArmStatus {
  static constexpr size_t kName = 32;
  Phase phase = Phase::kIdle;
  int32_t joints = 0;
  int64_t at_ns = 0;  // steady clock, when it was written
  uint32_t mode = 0;  // of Mode
  uint32_t dry_run = 0;
  double rate_hz = 0.0, lateness_max_us = 0.0, state_age_us = 0.0;
  uint64_t ticks = 0, missed = 0;
  char rollout[96] = {};
  char last_reason[32] = {};  // of the last motion that ended
  char last_detail[200] = {};
  char names[kMaxJoints][kName] = {};
  JointArray q{}, v{}, command{}, lower{}, upper{}, velocity{}, torque{};
};

class Board {
 public:
  // Makes or takes over the file FOLDER/board: disarmed, no stop asked for.
  static Result<std::unique_ptr<Board>> Create(const std::string& folder);
  // kNotFound: no agent was ever here.
  static Result<std::unique_ptr<Board>> Open(const std::string& folder);
  ~Board();
  Board(const Board&) = delete;

  bool armed() const { return shared_->armed.load() != 0; }
  void Arm(bool armed) { shared_->armed.store(armed ? 1 : 0); }
  // Disarms too, so that nothing begins after it.
  void AskStop();
  uint64_t stops() const { return shared_->stops.load(); }
  void Beat(int64_t now_ns) { shared_->beat_ns.store(now_ns); }
  int64_t beat_ns() const { return shared_->beat_ns.load(); }
  // The process that moves the arm; 0: nobody, also if the one that did is gone.
  int32_t mover() const;
  void SetMover(int32_t pid) { shared_->mover.store(pid); }

  void Publish(const ArmStatus& status);
  ArmStatus Read() const;

 private:
  struct Shared {
    std::atomic<uint64_t> magic;
    std::atomic<uint32_t> armed;
    std::atomic<int32_t> mover;
    std::atomic<uint64_t> stops;
    std::atomic<int64_t> beat_ns;
    std::atomic<uint64_t> published;  // statuses so far: the newest is at published % 2
    ArmStatus status[2];
  };
  static_assert(std::atomic<uint64_t>::is_always_lock_free);
  static Result<std::unique_ptr<Board>> Map(const std::string& folder, int flags);
  explicit Board(Shared* shared) : shared_(shared) {}
  Shared* const shared_;
};

// Cancels `token()` when the job is cancelled, the agent asked for a stop or disarmed, or the agent is gone.
// A thread of its own looks every few milliseconds, so it is heard whatever the caller does.
class StopListener {
 public:
  static constexpr int64_t kAgentLost = 2'000'000'000;  // ns without a beat
  StopListener(const Board& board, const CancelToken& job);
  ~StopListener();
  const CancelToken& token() const { return token_; }

 private:
  const Board& board_;
  const CancelToken& job_;
  const uint64_t stops_;
  CancelToken token_;
  std::atomic<bool> end_{false};
  std::thread thread_;
};

// Writes what the loop and the moves see to the board; the mover while it lives.
class BoardPublisher final : public LoopObserver {
 public:
  BoardPublisher(Board& board, const std::string& rollout, const std::vector<std::string>& joints,
                 const SafetyLimits& limits, double rate_hz, bool dry_run);
  ~BoardPublisher() override;
  void OnState(const RobotState& state) override;  // in a move
  void OnSample(const Sample& sample, const JitterReport& jitter) override;
  void SetEnd(const std::string& reason, const std::string& detail);

 private:
  void Write();
  Board& board_;
  ArmStatus status_;
};

}  // namespace rg::robot_agent
