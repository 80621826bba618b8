#include "robot_agent/board.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>

#include "common/base/clock.h"

namespace rg::robot_agent {
namespace {

constexpr uint64_t kBoardMagic = 0x3244524F42475200;  // this layout
constexpr auto kListenEvery = std::chrono::milliseconds(4);

template <size_t size>
void CopyText(const std::string& text, char (&to)[size]) {
  const size_t count = std::min(text.size(), size - 1);
  std::memcpy(to, text.data(), count);
  std::memset(to + count, 0, size - count);
}

void CopyNumbers(const std::vector<double>& from, JointArray* to) {
  std::copy_n(from.begin(), std::min<size_t>(from.size(), kMaxJoints), to->begin());
}

}  // namespace

const char* PhaseName(Phase phase) {
  static constexpr const char* kNames[] = {"idle", "connecting", "moving", "rollout", "stopping"};
  const auto index = static_cast<size_t>(phase);
  return index < std::size(kNames) ? kNames[index] : "unknown";
}

Result<std::unique_ptr<Board>> Board::Map(const std::string& folder, int flags) {
  const std::string path = folder + "/board";
  const int file = open(path.c_str(), flags | O_RDWR | O_CLOEXEC, 0600);
  if (file < 0) {
    const std::string text = "cannot open " + path + ": " + std::strerror(errno);
    return errno == ENOENT ? Status(StatusCode::kNotFound, text) : UnavailableError(text);
  }
  const bool sized = ftruncate(file, sizeof(Shared)) == 0;
  void* memory =
      sized ? mmap(nullptr, sizeof(Shared), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0) : MAP_FAILED;
  const int error = errno;
  close(file);
  if (memory == MAP_FAILED) return UnavailableError("cannot map " + path + ": " + std::strerror(error));
  return std::unique_ptr<Board>(new Board(static_cast<Shared*>(memory)));
}

Result<std::unique_ptr<Board>> Board::Create(const std::string& folder) {
  RG_ASSIGN_OR_RETURN(auto board, Map(folder, O_CREAT));
  Shared& shared = *board->shared_;
  shared.armed.store(0);
  shared.beat_ns.store(RealClock().SteadyNanos());
  // Who moves the arm for an agent that is gone keeps its name here, and hears that it is disarmed.
  if (shared.magic.load() != kBoardMagic) {
    shared.published.store(0);
    shared.mover.store(0);
    shared.stops.store(0);
    board->Publish(ArmStatus{});
  }
  shared.magic.store(kBoardMagic);
  return board;
}

Result<std::unique_ptr<Board>> Board::Open(const std::string& folder) {
  RG_ASSIGN_OR_RETURN(auto board, Map(folder, 0));
  if (board->shared_->magic.load() == kBoardMagic) return board;
  return FailedPreconditionError(folder + "/board is of another version of the agent");
}

Board::~Board() { munmap(shared_, sizeof(Shared)); }

void Board::AskStop() {
  shared_->armed.store(0);
  shared_->stops.fetch_add(1);
}

int32_t Board::mover() const {
  const int32_t pid = shared_->mover.load();
  return pid > 0 && (kill(pid, 0) == 0 || errno == EPERM) ? pid : 0;
}

void Board::Publish(const ArmStatus& status) {
  const uint64_t next = shared_->published.load(std::memory_order_relaxed) + 1;
  // Whoever reads some of what follows knows that the status there is no longer the newest.
  std::atomic_thread_fence(std::memory_order_release);
  std::memcpy(static_cast<void*>(&shared_->status[next % 2]), &status, sizeof status);
  shared_->published.store(next, std::memory_order_release);
}

ArmStatus Board::Read() const {
  ArmStatus status;
  for (;;) {  // again where a newer one came meanwhile: the one after that may be written over what was read
    const uint64_t newest = shared_->published.load(std::memory_order_acquire);
    std::memcpy(static_cast<void*>(&status), &shared_->status[newest % 2], sizeof status);
    std::atomic_thread_fence(std::memory_order_acquire);
    if (shared_->published.load(std::memory_order_relaxed) == newest) return status;
  }
}

StopListener::StopListener(const Board& board, const CancelToken& job)
    : board_(board), job_(job), stops_(board.stops()) {
  thread_ = std::thread([this] {
    while (!end_.load(std::memory_order_relaxed)) {
      const bool agent_lost = RealClock().SteadyNanos() - board_.beat_ns() > kAgentLost;
      if (job_.cancelled() || board_.stops() != stops_ || !board_.armed() || agent_lost) token_.Cancel();
      std::this_thread::sleep_for(kListenEvery);
    }
  });
}

StopListener::~StopListener() {
  end_ = true;
  thread_.join();
}

BoardPublisher::BoardPublisher(Board& board, const std::string& rollout,
                               const std::vector<std::string>& joints, const SafetyLimits& limits,
                               double rate_hz, bool dry_run)
    : board_(board) {
  status_.phase = Phase::kConnecting;
  status_.joints = static_cast<int32_t>(std::min<size_t>(joints.size(), kMaxJoints));
  status_.rate_hz = rate_hz;
  status_.dry_run = dry_run;
  CopyText(rollout, status_.rollout);
  for (int i = 0; i < status_.joints; ++i) CopyText(joints[static_cast<size_t>(i)], status_.names[i]);
  CopyNumbers(limits.lower, &status_.lower);
  CopyNumbers(limits.upper, &status_.upper);
  CopyNumbers(limits.velocity, &status_.velocity);
  CopyNumbers(limits.torque, &status_.torque);
  board_.SetMover(getpid());
  Write();
}

BoardPublisher::~BoardPublisher() {
  status_.phase = Phase::kIdle;
  Write();
  board_.SetMover(0);
}

void BoardPublisher::OnState(const RobotState& state) {
  status_.phase = Phase::kMoving;
  status_.mode = static_cast<uint32_t>(state.mode);
  status_.q = state.q;
  status_.v = state.v;
  Write();
}

void BoardPublisher::OnSample(const Sample& sample, const JitterReport& jitter) {
  status_.phase = sample.flags & Sample::kStopping ? Phase::kStopping : Phase::kRollout;
  status_.mode = static_cast<uint32_t>(Mode::kTorque);
  status_.q = sample.q;
  status_.v = sample.v;
  status_.command = sample.command;
  status_.ticks = static_cast<uint64_t>(sample.tick);
  status_.missed = jitter.missed_deadlines;
  status_.lateness_max_us = jitter.lateness.max_us();
  status_.state_age_us = 1e-3 * static_cast<double>(sample.time_ns - sample.stamp_ns);
  Write();
}

void BoardPublisher::SetEnd(const std::string& reason, const std::string& detail) {
  CopyText(reason, status_.last_reason);
  CopyText(detail, status_.last_detail);
  status_.mode = static_cast<uint32_t>(Mode::kPosition);
  Write();
}

void BoardPublisher::Write() {
  status_.at_ns = RealClock().SteadyNanos();
  board_.Publish(status_);
}

}  // namespace rg::robot_agent
