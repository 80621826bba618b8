#include "robot_agent/supervisor.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/prctl.h>
#include <sys/signalfd.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "robot_agent/drivers/kinova/arm_session.h"
#include "robot_agent/local_socket.h"
#include "robot_agent/safety/latch.h"
#include "robot_agent/spool.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

constexpr int kBeatMs = 100;
constexpr int kExitFailed = 1;
constexpr auto kOrphanPatience = static_cast<unsigned>(LongestEnd());  // s

json JointsOf(const ArmStatus& status) {
  json joints = json::array();
  for (int i = 0; i < std::clamp(status.joints, 0, kMaxJoints); ++i)
    joints.push_back({{"name", std::string(status.names[i], strnlen(status.names[i], ArmStatus::kName))},
                      {"q", status.q[i]},
                      {"v", status.v[i]},
                      {"command", status.command[i]},
                      {"lower", status.lower[i]},
                      {"upper", status.upper[i]},
                      {"velocity", status.velocity[i]},
                      {"torque", status.torque[i]}});
  return joints;
}

template <size_t size>
std::string TextOf(const char (&text)[size]) {
  return std::string(text, strnlen(text, size));
}

size_t CountIn(const std::string& folder) {
  std::error_code error;
  size_t count = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder, error)) ++count;
  return count;
}

json StatusOf(const SupervisorOptions& options, const Board& board) {
  const ArmStatus arm = board.Read();
  const auto latch = Latch(options.spool_folder).Read();
  const bool moving = board.mover() != 0;
  const double age = 1e-9 * static_cast<double>(RealClock().SteadyNanos() - arm.at_ns);
  json out{{"ok", true},
           {"robot", options.robot},
           {"driver", options.driver},
           {"armed", board.armed()},
           {"dry_run", options.dry_run},
           {"phase", moving ? PhaseName(arm.phase) : "idle"},
           {"rollout", TextOf(arm.rollout)},
           {"mode", arm.mode == static_cast<uint32_t>(Mode::kTorque) ? "torque" : "position"},
           {"seen_s_ago", arm.at_ns > 0 ? json(age) : json()},
           {"joints", JointsOf(arm)},
           {"rate_hz", arm.rate_hz},
           {"ticks", arm.ticks},
           {"missed_deadlines", arm.missed},
           {"lateness_max_us", arm.lateness_max_us},
           {"state_age_us", arm.state_age_us},
           {"last_end", {{"reason", TextOf(arm.last_reason)}, {"detail", TextOf(arm.last_detail)}}},
           {"spool",
            {{"folder", options.spool_folder},
             {"recording", CountIn(options.spool_folder + "/active")},
             {"waiting", CountIn(options.spool_folder + "/ready")},
             {"broken", CountIn(options.spool_folder + "/broken")}}}};
  // While it moves, the file is there for whoever comes after it.
  out["latched"] = latch.has_value() && (latch->latched || !moving);
  if (out["latched"])
    out["latch"] = {{"rollout", latch->rollout}, {"reason", latch->reason}, {"since", latch->since}};
  return out;
}

std::string Refusal(const Status& status) { return json{{"ok", false}, {"error", status.message()}}.dump(); }

// Whoever arms, disarms or clears an arm stands beside it and may have touched it.
void ForgetSession(const SupervisorOptions& options) {
  kinova::SessionFile(options.spool_folder + "/" + kinova::kSessionFile).Forget();
}

Status ArmIt(const SupervisorOptions& options, Board& board) {
  if (board.mover() == 0 && !options.arm_ends_with_driver)
    RG_RETURN_IF_ERROR(Latch(options.spool_folder).CheckClear());
  ForgetSession(options);
  board.Arm(true);
  return Status::Ok();
}

Status ClearIt(const SupervisorOptions& options, const Board& board) {
  if (board.mover() != 0) return FailedPreconditionError("the arm is being moved: realitygrad agent stop");
  RG_ASSIGN_OR_RETURN(const auto nobody_else, Spool::Open(options.spool_folder, 1.0));
  return Latch(options.spool_folder).Clear();
}

class Supervisor {
 public:
  Supervisor(const SupervisorOptions& options, Board& board, LocalSocket& socket, pid_t worker, int signals)
      : options_(options), board_(board), socket_(socket), worker_(worker), signals_(signals) {}

  // Until the worker has ended; its exit code.
  int Run() {
    while (true) {
      board_.Beat(RealClock().SteadyNanos());
      pollfd waiting[2] = {{signals_, POLLIN, 0}, {socket_.file(), POLLIN, 0}};
      poll(waiting, 2, kBeatMs);
      if (waiting[1].revents & POLLIN)
        socket_.Serve([this](const std::string& line) { return AnswerRequest(options_, board_, line); });
      if (waiting[0].revents & POLLIN) TakeSignals();
      PushWorker();
      int how = 0;
      if (waitpid(worker_, &how, WNOHANG) == worker_) return WIFEXITED(how) ? WEXITSTATUS(how) : kExitFailed;
    }
  }

 private:
  void TakeSignals() {
    signalfd_siginfo info;
    while (read(signals_, &info, sizeof info) == sizeof info) {
      if (info.ssi_signo == SIGCHLD) continue;
      ++asked_to_go_;
      if (info.ssi_signo == SIGINT || asked_to_go_ > 1) Stop();
      if (asked_to_go_ == 1) kill(worker_, SIGTERM);
    }
  }

  void Stop() {
    if (stopping_since_ == 0) stopping_since_ = RealClock().SteadyNanos();
    if (board_.mover() != 0) spdlog::warn("stopping the arm; leaving when it has been seen at rest");
    board_.AskStop();
  }

  // A second word to the worker ends its executor at once: never before the arm is at rest.
  void PushWorker() {
    if (asked_to_go_ < 2 || pushed_) return;
    const double waited = 1e-9 * static_cast<double>(RealClock().SteadyNanos() - stopping_since_);
    if (board_.mover() != 0 && waited < options_.stop_patience_s) return;
    if (board_.mover() != 0) spdlog::error("the stop was not seen within {} s; the arm is latched", waited);
    pushed_ = true;
    kill(worker_, SIGTERM);
  }

  const SupervisorOptions& options_;
  Board& board_;
  LocalSocket& socket_;
  const pid_t worker_;
  const int signals_;
  int asked_to_go_ = 0;
  int64_t stopping_since_ = 0;
  bool pushed_ = false;
};

// Hands in what waits, while the agent lives.
class DeliveryThread {
 public:
  DeliveryThread(const SupervisorOptions& options, const std::function<void(double)>& deliver)
      : thread_([this, &options, &deliver] {
          deliver(0.0);
          double waited = 0.0;
          while (!end_) {
            std::this_thread::sleep_for(std::chrono::milliseconds(kBeatMs));
            waited += 1e-3 * kBeatMs;
            if (waited < options.delivery_every_s) continue;
            waited = 0.0;
            deliver(options.delivery_age_s);
          }
        }) {}
  ~DeliveryThread() {
    end_ = true;
    thread_.join();
  }

 private:
  std::atomic<bool> end_{false};
  std::thread thread_;
};

// The worker's process. A Ctrl-C of the terminal is the parent's business; if the parent is gone, so is the
// worker, in the end.
[[noreturn]] void BecomeWorker(pid_t parent, const sigset_t& mask, const std::function<int()>& run_worker) {
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (getppid() != parent) _exit(kExitFailed);
  sigprocmask(SIG_SETMASK, &mask, nullptr);
  std::thread([parent] {
    while (getppid() == parent) sleep(1);
    sleep(kOrphanPatience);
    kill(getpid(), SIGTERM);
  }).detach();
  const int code = run_worker();
  std::fflush(nullptr);
  _exit(code);
}

Result<int> LockAgent(const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return UnavailableError("cannot make the spool folder " + folder + ": " + error.message());
  const std::string path = folder + "/agent.lock";
  const int file = open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (file < 0) return UnavailableError("cannot open " + path + ": " + std::strerror(errno));
  if (flock(file, LOCK_EX | LOCK_NB) == 0) return file;
  close(file);
  return FailedPreconditionError("another agent runs on the spool folder " + folder);
}

}  // namespace

std::string AnswerRequest(const SupervisorOptions& options, Board& board, const std::string& line) {
  Status done;
  if (line == "status") return StatusOf(options, board).dump();
  if (line == "arm") {
    done = ArmIt(options, board);
  } else if (line == "disarm") {
    board.Arm(false);  // whoever moves the arm stops it
    ForgetSession(options);
  } else if (line == "stop") {
    board.AskStop();
  } else if (line == "clear") {
    done = ClearIt(options, board);
    ForgetSession(options);
  } else {
    done = InvalidError("unknown request \"" + line + "\", knows status, arm, disarm, stop, clear");
  }
  if (!done.ok()) return Refusal(done);
  spdlog::warn("{}, by the local socket", line);
  return StatusOf(options, board).dump();
}

int Supervise(const SupervisorOptions& options, const std::function<int()>& run_worker,
              const std::function<void(double)>& deliver) {
  const auto fail = [](const Status& status) {
    spdlog::error("{}", status.message());
    return kExitFailed;
  };
  const auto lock = LockAgent(options.spool_folder);
  if (!lock.ok()) return fail(lock.status());
  auto board = Board::Create(options.spool_folder);
  if (!board.ok()) return fail(board.status());
  ForgetSession(options);
  (*board)->Arm(options.armed);
  auto socket = LocalSocket::Listen(options.spool_folder);
  if (!socket.ok()) return fail(socket.status());

  sigset_t ours, before;
  sigemptyset(&ours);
  for (const int number : {SIGINT, SIGTERM, SIGCHLD}) sigaddset(&ours, number);
  sigprocmask(SIG_BLOCK, &ours, &before);
  const int signals = signalfd(-1, &ours, SFD_CLOEXEC | SFD_NONBLOCK);
  const pid_t parent = getpid(), worker = fork();
  if (worker == 0) {
    close(socket->file());
    BecomeWorker(parent, before, run_worker);
  }
  if (worker < 0 || signals < 0) return fail(ResourceExhaustedError(std::strerror(errno)));
  int code;
  {
    const DeliveryThread delivering(options, deliver);
    code = Supervisor(options, **board, *socket, worker, signals).Run();
  }
  deliver(0.0);
  close(signals);
  close(*lock);
  return code;
}

}  // namespace rg::robot_agent
