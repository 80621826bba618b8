#include "robot_agent/drivers/simulated_driver.h"

#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <vector>

#include "common/base/clock.h"

extern char** environ;

namespace rg::robot_agent {
namespace {

constexpr int kChildSocket = 3;  // the file descriptor on which the child finds its end

std::string ProgramBesideThisOne() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  return (self.parent_path() / "realitygrad-simulated-robot").string();
}

Result<pid_t> Spawn(const std::vector<std::string>& arguments, int socket_file) {
  std::vector<char*> argv;
  for (const auto& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, socket_file, kChildSocket);
  posix_spawn_file_actions_addclosefrom_np(&actions, kChildSocket + 1);
  pid_t pid = -1;
  const int error = posix_spawn(&pid, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) return FailedPreconditionError("cannot start " + arguments[0] + ": " + std::strerror(error));
  return pid;
}

// Gives the child a moment to end by itself, then kills it.
void Reap(pid_t pid) {
  for (int i = 0; i < 50; ++i) {
    if (waitpid(pid, nullptr, WNOHANG) != 0) return;
    usleep(2000);
  }
  kill(pid, SIGKILL);
  waitpid(pid, nullptr, 0);
}

}  // namespace

SimulatedDriver::SimulatedDriver(SimulatedDriverOptions options) : options_(std::move(options)) {}

SimulatedDriver::~SimulatedDriver() {
  if (socket_.open() && pid_ > 0) (void)Send(Request(MessageType::kBye, nullptr)).ok();
  socket_.Close();
  if (pid_ > 0) Reap(pid_);
}

Status SimulatedDriver::Connect(double timeout_s) {
  if (socket_.open()) return FailedPreconditionError("the simulated robot is connected already");
  if (options_.socket_path.empty()) {
    RG_RETURN_IF_ERROR(StartChild());
  } else {
    RG_ASSIGN_OR_RETURN(socket_, PacketSocket::ConnectTo(options_.socket_path));
  }
  RG_RETURN_IF_ERROR(Greet(timeout_s));
  RobotState ignored;
  return AwaitStateFrom(1, timeout_s, &ignored);
}

Status SimulatedDriver::StartChild() {
  RG_ASSIGN_OR_RETURN(auto pair, PacketSocket::Pair());
  std::vector<std::string> arguments{options_.program.empty() ? ProgramBesideThisOne() : options_.program,
                                     "--truth",
                                     options_.truth_path,
                                     "--seed",
                                     std::to_string(options_.seed),
                                     "--socket-fd",
                                     std::to_string(kChildSocket)};
  if (options_.allow_faults) arguments.push_back("--allow-faults");
  RG_ASSIGN_OR_RETURN(pid_, Spawn(arguments, pair.second.file()));
  socket_ = std::move(pair.first);
  return Status::Ok();
}

Status SimulatedDriver::Greet(double timeout_s) {
  RobotMessage hello = Request(MessageType::kHello, nullptr);
  hello.flags = options_.lock_step ? RobotMessage::kLockStep : 0;
  RG_RETURN_IF_ERROR(Send(hello));
  std::string buffer(sizeof(RobotMessage) + kMaxInfoText, '\0');
  const auto received = socket_.Receive(buffer.data(), buffer.size(), timeout_s);
  if (received.code == StatusCode::kDeadlineExceeded)
    return DeadlineExceededError("the simulated robot did not answer within " + std::to_string(timeout_s) +
                                 " s");
  if (received.code != StatusCode::kOk)
    return FailedPreconditionError("the simulated robot ended before it answered (see its messages above)");
  std::memcpy(&last_, buffer.data(), sizeof last_);
  RG_RETURN_IF_ERROR(CheckMessage(last_, received.bytes));
  if (last_.type != MessageType::kInfo) return InvalidError("the simulated robot did not introduce itself");
  RG_ASSIGN_OR_RETURN(info_, InfoFromJson(buffer.substr(sizeof last_, received.bytes - sizeof last_)));
  info_.driver = "simulated";
  info_.lock_step = options_.lock_step;
  robot_time_ns_ = last_.time_ns;
  health_.connected = true;
  return Status::Ok();
}

int64_t SimulatedDriver::NowNanos() const {
  return options_.lock_step ? robot_time_ns_ : RealClock().SteadyNanos();
}

Status SimulatedDriver::SleepUntil(int64_t deadline_ns) {
  if (lost_) return UnavailableError(health_.last_error);
  if (options_.lock_step) {
    if (deadline_ns <= robot_time_ns_) return Status::Ok();
    RobotMessage advance = Request(MessageType::kAdvance, nullptr);
    advance.time_ns = deadline_ns;
    RG_RETURN_IF_ERROR(Ask(advance, MessageType::kAdvanced));
    robot_time_ns_ = last_.time_ns;
    return Status::Ok();
  }
  const timespec until{deadline_ns / 1'000'000'000, deadline_ns % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
  return Status::Ok();
}

Status SimulatedDriver::ReadState(RobotState* state) {
  if (!options_.lock_step) DrainStates();
  if (lost_) return UnavailableError(health_.last_error);
  if (!has_state_) return UnavailableError("no state was received yet");
  *state = state_;
  return Status::Ok();
}

Status SimulatedDriver::EnterTorqueMode(const double* first) {
  RG_RETURN_IF_ERROR(Ask(Request(MessageType::kEnterTorque, first), MessageType::kAck));
  RobotState state;
  RG_RETURN_IF_ERROR(AwaitStateFrom(last_.sequence, 1.0, &state));
  if (state.mode == Mode::kTorque) return Status::Ok();
  return FailedPreconditionError("the robot refused torque mode (it said nothing, its mode did not change)");
}

Status SimulatedDriver::SendTorque(const double* tau) {
  if (lost_) return UnavailableError(health_.last_error);
  ++health_.commands_sent;
  return Send(Request(MessageType::kTorque, tau));
}

Status SimulatedDriver::Hold() { return Ask(Request(MessageType::kHold, nullptr), MessageType::kAck); }

Status SimulatedDriver::StartMove(const double* q) {
  RG_RETURN_IF_ERROR(Ask(Request(MessageType::kMoveTo, q), MessageType::kAck));
  RobotState ignored;
  return AwaitStateFrom(last_.sequence, 1.0, &ignored);  // so that `moving` is of this move
}

Status SimulatedDriver::InjectFault(Fault fault, double strength) {
  RobotMessage message = Request(MessageType::kFault, nullptr);
  message.code = static_cast<uint16_t>(fault);
  message.a[0] = strength;
  return Send(message);
}

RobotMessage SimulatedDriver::Request(MessageType type, const double* values) {
  RobotMessage message;
  message.type = type;
  message.sequence = ++requests_;
  message.time_ns = NowNanos();
  message.joints = static_cast<uint32_t>(joints());
  if (values != nullptr) std::copy_n(values, joints(), message.a.begin());
  return message;
}

Status SimulatedDriver::Send(const RobotMessage& message) {
  Status sent = socket_.Send(&message, sizeof message);
  if (sent.code() == StatusCode::kUnavailable) return Lost(sent.message().c_str());
  return sent;
}

Status SimulatedDriver::Ask(const RobotMessage& message, MessageType reply) {
  if (lost_) return UnavailableError(health_.last_error);
  RG_RETURN_IF_ERROR(Send(message));
  const int64_t give_up = RealClock().SteadyNanos() + std::llround(1e9 * options_.reply_timeout_s);
  while (true) {
    const double left = 1e-9 * static_cast<double>(give_up - RealClock().SteadyNanos());
    const auto received = socket_.Receive(&last_, sizeof last_, std::max(left, 0.0));
    if (received.code == StatusCode::kDeadlineExceeded) return Lost("the simulated robot does not answer");
    if (received.code != StatusCode::kOk) return Lost("the simulated robot is gone");
    TakeMessage(received.bytes);
    if (last_.type == reply) return Status::Ok();
  }
}

void SimulatedDriver::TakeMessage(size_t bytes) {
  if (CheckMessage(last_, bytes).ok()) {
    TakeState(last_);
  } else {
    ++health_.malformed;
    last_.type = MessageType::kHello;  // never a reply
  }
}

void SimulatedDriver::TakeState(const RobotMessage& message) {
  const bool carries = message.type == MessageType::kState || message.type == MessageType::kAdvanced;
  if (!carries || !(message.flags & RobotMessage::kHasState)) return;
  if (has_state_ && message.sequence <= state_.sequence) return;
  if (has_state_) health_.states_lost += options_.lock_step ? 0 : message.sequence - state_.sequence - 1;
  ++health_.states_received;
  state_.stamp_ns = message.stamp_ns;
  state_.sequence = message.sequence;
  state_.mode = message.mode;
  state_.moving = message.flags & RobotMessage::kMoving;
  state_.q = message.a;
  state_.v = message.b;
  state_.effort = message.c;
  has_state_ = true;
}

void SimulatedDriver::DrainStates() {
  while (!lost_) {
    const auto received = socket_.Receive(&last_, sizeof last_, 0.0);
    if (received.code == StatusCode::kDeadlineExceeded) return;
    if (received.code != StatusCode::kOk) {
      (void)Lost("the simulated robot is gone").ok();
      return;
    }
    TakeMessage(received.bytes);
  }
}

Status SimulatedDriver::Lost(const char* what) {
  lost_ = true;
  health_.connected = false;
  health_.last_error = what;
  return UnavailableError(what);
}

Status SimulatedDriver::AwaitStateFrom(uint64_t sequence, double timeout_s, RobotState* state) {
  const int64_t give_up = NowNanos() + std::llround(1e9 * timeout_s);
  while (true) {
    const Status read = ReadState(state);
    if (lost_) return read;
    if (read.ok() && state->sequence >= sequence) return Status::Ok();
    if (NowNanos() >= give_up) return Lost("the simulated robot sends no states");
    RG_RETURN_IF_ERROR(SleepUntil(NowNanos() + 5'000'000));
  }
}

}  // namespace rg::robot_agent
