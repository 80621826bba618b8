#include "robot_agent/guard/guard_driver.h"

#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "common/base/clock.h"
#include "robot_agent/drivers/robot_protocol.h"

extern char** environ;

namespace rg::robot_agent {
namespace {

constexpr int kGuardSocket = 3;         // the file on which the guard finds its end
constexpr double kReplyTimeout = kLongestCall;  // s; a stop of the guard's own is tried three times
constexpr double kListen = 0.005;       // s between looks at a stop while torque mode is entered
constexpr double kCommandLife = 2.0;    // periods

}  // namespace

Result<std::unique_ptr<GuardDriver>> GuardDriver::Start(std::vector<std::string> arguments, double period_s) {
  RG_ASSIGN_OR_RETURN(auto pair, PacketSocket::Pair());
  arguments.insert(arguments.end(), {"--socket-fd", std::to_string(kGuardSocket)});
  std::vector<char*> argv;
  for (auto& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, pair.second.file(), kGuardSocket);
  posix_spawn_file_actions_addclosefrom_np(&actions, kGuardSocket + 1);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSID);  // no terminal's signals, no parent's end
  pid_t pid = -1;
  const int error = posix_spawn(&pid, argv[0], &actions, &attributes, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  posix_spawnattr_destroy(&attributes);
  if (error != 0) return FailedPreconditionError("cannot start " + arguments[0] + ": " + std::strerror(error));
  auto driver = std::make_unique<GuardDriver>(std::move(pair.first), period_s);
  driver->pid_ = pid;
  return driver;
}

GuardDriver::~GuardDriver() {
  GuardMessage bye;
  if (socket_.open()) (void)socket_.Send(&bye, sizeof bye).ok();
  socket_.Close();
  // One that still stops an arm is left to it.
  for (int i = 0; pid_ > 0 && i < 250 && waitpid(pid_, nullptr, WNOHANG) == 0; ++i) usleep(2000);
}

Status GuardDriver::Lost(const char* what) {
  lost_ = true;
  health_.connected = false;
  health_.last_error = what;
  return UnavailableError(what);
}

Status GuardDriver::Ask(GuardRequest request, const double* values, double timeout_s) {
  RG_RETURN_IF_ERROR(Tell(request, values));
  const Status answer = Await(timeout_s);
  return answered_ ? answer : Lost("the guard does not answer");
}

Status GuardDriver::Tell(GuardRequest request, const double* values) {
  if (lost_) return UnavailableError(health_.last_error);
  request_.request = request;
  request_.sequence = ++sequence_;
  if (values != nullptr) std::copy_n(values, info_.joints.size(), request_.values.begin());
  if (!socket_.Send(&request_, sizeof request_).ok())
    return Lost("realitygrad-guard ended (its messages are above)");
  return Status::Ok();
}

Status GuardDriver::Await(double timeout_s) {
  const auto received = socket_.Receive(&reply_, sizeof reply_, timeout_s);
  answered_ = received.code != StatusCode::kDeadlineExceeded;
  if (!answered_) return DeadlineExceededError("no answer yet");
  if (received.code != StatusCode::kOk || received.bytes != sizeof reply_ || reply_.magic != kGuardMagic)
    return Lost("realitygrad-guard ended (its messages are above)");
  time_ns_ = reply_.time_ns;
  if (reply_.code == StatusCode::kOk) return Status::Ok();
  return Status(reply_.code, reply_.text);
}

Status GuardDriver::Connect(double timeout_s) {
  request_.number = timeout_s;
  RG_RETURN_IF_ERROR(Ask(GuardRequest::kConnect, nullptr, timeout_s + kReplyTimeout));
  const std::string driver = reply_.text;
  const bool lock_step = reply_.number != 0.0;
  std::string text(kMaxInfoText, '\0');
  const auto received = socket_.Receive(text.data(), text.size(), kReplyTimeout);
  if (received.code != StatusCode::kOk) return Lost("the guard did not introduce its arm");
  RG_ASSIGN_OR_RETURN(info_, InfoFromJson(text.substr(0, received.bytes)));
  info_.lock_step = lock_step;
  info_.driver = driver;
  health_.connected = true;
  return Status::Ok();
}

int64_t GuardDriver::NowNanos() const { return info_.lock_step ? time_ns_ : RealClock().SteadyNanos(); }

Status GuardDriver::SleepUntil(int64_t deadline_ns) {
  if (lost_) return UnavailableError(health_.last_error);
  if (info_.lock_step) {
    request_.time_ns = deadline_ns;
    return Ask(GuardRequest::kSleepUntil, nullptr, kReplyTimeout);
  }
  const timespec until{deadline_ns / 1'000'000'000, deadline_ns % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
  return Status::Ok();
}

Status GuardDriver::ReadState(RobotState* state) {
  RG_RETURN_IF_ERROR(Ask(GuardRequest::kReadState, nullptr, kReplyTimeout));
  if (reply_.state.sequence != state->sequence) ++health_.states_received;
  *state = reply_.state;
  return Status::Ok();
}

Status GuardDriver::EnterTorqueMode(const double* first) {
  request_.number = period_s_;
  RG_RETURN_IF_ERROR(Tell(GuardRequest::kEnter, first));
  bool stopped = false;
  for (double waited = 0.0; waited < kLongestEntry; waited += kListen) {
    const Status answer = Await(kListen);
    if (answered_) return answer;
    if (stopped || !stop_asked()) continue;
    stopped = true;
    RG_RETURN_IF_ERROR(Tell(GuardRequest::kStopEntry, nullptr));
  }
  return Lost("the guard does not answer");
}

Status GuardDriver::SendTorque(const double* tau) {
  request_.deadline_ns = NowNanos() + std::llround(1e9 * kCommandLife * period_s_);
  ++health_.commands_sent;
  return Ask(GuardRequest::kTorque, tau, kReplyTimeout);
}

Status GuardDriver::Hold() { return Ask(GuardRequest::kHold, nullptr, kReplyTimeout); }
Status GuardDriver::MoveEnd() { return Ask(GuardRequest::kMoveEnd, nullptr, kReplyTimeout); }
Status GuardDriver::StartMove(const double* q) { return Ask(GuardRequest::kStartMove, q, kReplyTimeout); }

}  // namespace rg::robot_agent
