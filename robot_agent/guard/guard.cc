#include "robot_agent/guard/guard.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <thread>

#include "common/base/clock.h"
#include "robot_agent/drivers/robot_protocol.h"
#include "robot_agent/safety/latch.h"

namespace rg::robot_agent {
namespace {

constexpr double kArrived = 0.2;          // rad (m): so far from its pose an arm at rest has not arrived
constexpr int64_t kSettled = 20'000'000;  // ns between the zero torques of a stop

double SecondsSince(int64_t then_ns) {
  return 1e-9 * static_cast<double>(RealClock().SteadyNanos() - then_ns);
}

// Cancels `stop` as soon as the agent says something, or is gone; takes nothing from the socket.
class WordWatch {
 public:
  WordWatch(int socket, CancelToken& stop)
      : over_(eventfd(0, EFD_CLOEXEC)), thread_([this, socket, &stop] { Watch(socket, stop); }) {}
  ~WordWatch() {
    eventfd_write(over_, 1);
    thread_.join();
    close(over_);
  }

 private:
  void Watch(int socket, CancelToken& stop) const {
    pollfd waiting[2] = {{socket, POLLIN, 0}, {over_, POLLIN, 0}};
    while (poll(waiting, 2, -1) < 0 && errno == EINTR) {
    }
    if (waiting[0].revents != 0) stop.Cancel();
  }

  const int over_;
  std::thread thread_;
};

void SetText(const std::string& text, GuardMessage* reply) {
  size_t count = std::min(text.size(), sizeof reply->text - 1);
  while (count < text.size() && count > 0 && (text[count] & 0xC0) == 0x80) --count;  // no half of a character
  std::memcpy(reply->text, text.data(), count);
  reply->text[count] = '\0';
}

}  // namespace

Guard::Guard(Driver& driver, ArmModel& arm, const SafetyLimits& limits, const PacketSocket& socket,
             const GuardOptions& options)
    : driver_(driver),
      arm_(arm),
      limits_(limits),
      socket_(socket),
      options_(options),
      n_(static_cast<int>(limits.lower.size())) {}

void Guard::Run() {
  GuardMessage request;
  while (true) {
    const auto received = socket_.Receive(&request, sizeof request, std::min(Patience(), 1.0));
    if (received.code == StatusCode::kUnavailable) return LeaveAlone();
    const bool good =
        received.code == StatusCode::kOk && received.bytes == sizeof request && request.magic == kGuardMagic;
    if (good && request.request == GuardRequest::kBye) return LeaveAlone();
    if (good && request.request != GuardRequest::kStopEntry) Answer(request);
    if (Patience() <= 0.0) Raise(EndReason::kControllerHung);
    if (stop_pending_) Stop();
  }
}

double Guard::MostSilence() const {
  if (doing_ == Doing::kMoving) return options_.move_silence_s;
  return (commanded_ ? options_.hang_periods : options_.first_periods) * period_s_;
}

// Seconds until the silence is too long.
double Guard::Patience() const {
  const bool at_rest = doing_ == Doing::kNothing || (doing_ == Doing::kMoving && !under_way_);
  if (at_rest || stop_pending_ || driver_.info().lock_step) return 1.0;
  return MostSilence() - SecondsSince(last_word_ns_);
}

std::string Guard::LatchedMotion() const {
  if (options_.latch_folder.empty()) return "";
  const auto entry = Latch(options_.latch_folder).Read();
  return entry ? entry->rollout + " " + entry->since : "";
}

void Guard::Answer(const GuardMessage& request) {
  GuardMessage reply;
  reply.request = request.request;
  reply.sequence = request.sequence;
  Status done;
  switch (request.request) {
    case GuardRequest::kConnect:
      return Connect(request, &reply);
    case GuardRequest::kReadState:
      done = ReadState(&reply);
      break;
    case GuardRequest::kSleepUntil:
      done = driver_.SleepUntil(request.time_ns);
      break;
    case GuardRequest::kStartMove:
      done = StartMove(request);
      break;
    case GuardRequest::kMoveEnd:
      done = Refused();
      if (done.ok()) done = driver_.MoveEnd();
      break;
    case GuardRequest::kEnter:
      done = Enter(request);
      break;
    case GuardRequest::kTorque:
      done = Torque(request);
      break;
    case GuardRequest::kHold:
      done = Hold();
      break;
    default:
      done = InvalidError("unknown request");
  }
  if (doing_ == Doing::kMoving) last_word_ns_ = RealClock().SteadyNanos();
  reply.code = done.code();
  if (!done.ok()) SetText(done.message(), &reply);
  reply.time_ns = driver_.NowNanos();
  reply.trip = trip_;
  (void)socket_.Send(&reply, sizeof reply).ok();  // if it is gone, Receive says so
}

void Guard::Connect(const GuardMessage& request, GuardMessage* reply) {
  Status done = driver_.Connect(request.number);
  if (done.ok() && static_cast<int>(driver_.info().joints.size()) != n_)
    done = InvalidError("the robot has " + std::to_string(driver_.info().joints.size()) +
                        " joints, the guard's configuration " + std::to_string(n_));
  connected_ = done.ok();
  reply->code = done.code();
  if (!done.ok()) SetText(done.message(), reply);
  reply->time_ns = connected_ ? driver_.NowNanos() : 0;
  reply->number = connected_ && driver_.info().lock_step;
  if (connected_) SetText(driver_.info().driver, reply);
  (void)socket_.Send(reply, sizeof *reply).ok();
  if (!connected_) return;
  const std::string info = InfoToJson(driver_.info());
  (void)socket_.Send(info.data(), info.size()).ok();
}

Status Guard::Refused() const {
  if (!connected_) return FailedPreconditionError("the guard is not connected to the arm");
  if (trip_.reason == EndReason::kNone) return Status::Ok();
  return AbortedError("the guard stopped the arm: " + std::string(EndReasonName(trip_.reason)) + " " +
                      DescribeTrip(trip_, driver_.info().joints));
}

bool Guard::Look() {
  const Status read = driver_.ReadState(&seen_.state);
  seen_.now_ns = driver_.NowNanos();
  seen_.connected = read.ok();
  seen_.operator_stop = driver_.StopWanted();
  seen_.has_state |= read.ok();
  if (!seen_.has_state) return false;
  arm_.Tip(seen_.state.q.data(), tip_);
  arm_.GravityTorque(seen_.state.q.data(), gravity_.data());
  seen_.tip = tip_;
  seen_.clearance = arm_.Clearance(seen_.state.q.data(), &seen_.nearest_pair);
  seen_.gravity = gravity_.data();
  return read.ok();
}

Status Guard::ReadState(GuardMessage* reply) {
  if (!connected_) return Refused();
  const Status read = driver_.ReadState(&reply->state);
  if (doing_ != Doing::kMoving) return read;
  Look();
  double distance = 0.0;
  for (int i = 0; i < n_; ++i) distance = std::max(distance, std::abs(seen_.state.q[i] - target_[i]));
  under_way_ = seen_.state.moving || distance > kArrived;
  if (monitor_->OnMove(seen_, under_way_) != Action::kCommand) Raise(monitor_->trip().reason);
  return read;
}

Status Guard::StartMove(const GuardMessage& request) {
  trip_ = Trip{};  // a new motion, with everything judged anew
  RG_RETURN_IF_ERROR(Refused());
  for (int i = 0; i < n_; ++i)
    if (!(request.values[i] >= limits_.lower[i] && request.values[i] <= limits_.upper[i]))
      return InvalidError("the pose has " + driver_.info().joints[i] + " at " +
                          std::to_string(request.values[i]) + ", outside its box");
  monitor_ = std::make_unique<SafetyMonitor>(limits_, n_);
  target_ = request.values;
  Look();
  if (monitor_->OnMove(seen_, false) != Action::kCommand) {
    Raise(monitor_->trip().reason);
    return Refused();
  }
  RG_RETURN_IF_ERROR(driver_.StartMove(request.values.data()));
  doing_ = Doing::kMoving;
  stopped_it_ = false;
  under_way_ = true;
  motion_ = LatchedMotion();
  return Status::Ok();
}

Status Guard::Enter(const GuardMessage& request) {
  RG_RETURN_IF_ERROR(Refused());
  if (!(request.number > 0.0 && request.number <= 1.0)) return InvalidError("the period needs 0 to 1 s");
  period_s_ = request.number;
  monitor_ = std::make_unique<SafetyMonitor>(limits_, n_, period_s_);
  Look();
  JointArray whole = request.values;
  if (driver_.info().adds_gravity_compensation)
    for (int i = 0; i < n_; ++i) whole[i] += gravity_[i];
  if (monitor_->CheckFirst(seen_, whole.data()) != Action::kCommand) {
    Raise(monitor_->trip().reason);
    return Refused();
  }
  doing_ = Doing::kTorque;
  stopped_it_ = commanded_ = false;
  motion_ = LatchedMotion();
  const Status entered = EnterUnlessStopped(request.values.data());
  last_word_ns_ = RealClock().SteadyNanos();
  if (!entered.ok()) stop_pending_ = true;
  return entered;
}

Status Guard::EnterUnlessStopped(const double* first) {
  CancelToken stop;
  SafetyMonitor monitor(limits_, n_);
  const WordWatch watch(socket_.file(), stop);
  driver_.HeedStop(&stop);
  driver_.WatchEntry([&] { return JudgeEntry(monitor); });
  const Status entered = driver_.EnterTorqueMode(first);
  driver_.WatchEntry({});
  driver_.HeedStop(nullptr);
  return entered;
}

// As of a move: the arm is under test torques, and its states may say either mode. It may stand still: that is what the
// proof is about.
Status Guard::JudgeEntry(SafetyMonitor& monitor) {
  Look();
  seen_.state.moving = true;
  if (monitor.OnMove(seen_, false) == Action::kCommand) return Status::Ok();
  trip_ = monitor.trip();
  stop_pending_ = true;
  return Refused();
}

Status Guard::Torque(const GuardMessage& request) {
  RG_RETURN_IF_ERROR(Refused());
  if (doing_ != Doing::kTorque) return FailedPreconditionError("the arm is not in torque mode");
  if (request.sequence <= sequence_) return InvalidError("a command that came before");
  sequence_ = request.sequence;
  if (driver_.NowNanos() > request.deadline_ns) return DeadlineExceededError("a command that came too late");
  last_word_ns_ = RealClock().SteadyNanos();
  commanded_ = true;
  Look();
  JointArray whole = request.values, sent = request.values;
  const bool adds = driver_.info().adds_gravity_compensation;
  for (int i = 0; adds && i < n_; ++i) whole[i] += gravity_[i];
  const JointArray asked = whole;
  const bool allowed =
      monitor_->OnTick(seen_) == Action::kCommand &&
      monitor_->LimitCommand(whole.data(), gravity_.data(), seen_.now_ns) == Action::kCommand;
  if (!allowed) {
    Raise(monitor_->trip().reason);
    return Refused();
  }
  for (int i = 0; i < n_; ++i)
    if (whole[i] != asked[i]) sent[i] = adds ? whole[i] - gravity_[i] : whole[i];
  return driver_.SendTorque(sent.data());
}

Status Guard::Hold() {
  if (!connected_) return Refused();
  const Status held = driver_.Hold();
  if (held.ok()) doing_ = Doing::kNothing;
  return held;
}

void Guard::Raise(EndReason reason) {
  if (trip_.reason != EndReason::kNone) return;
  trip_ = monitor_ != nullptr && monitor_->trip().reason == reason
              ? monitor_->trip()
              : Trip{reason, -1, SecondsSince(last_word_ns_), MostSilence(), driver_.NowNanos()};
  stop_pending_ = true;
}

// Zero added torque for its time where the state can be trusted, then position mode.
void Guard::Stop() {
  stop_pending_ = false;
  zero_torque_after_s_ = -1.0;
  const bool torque = doing_ == Doing::kTorque;
  doing_ = Doing::kNothing;
  const int64_t until = driver_.NowNanos() + std::llround(1e9 * limits_.zero_torque_s);
  while (torque && trip_.reason != EndReason::kImpossibleState && driver_.NowNanos() < until) {
    const bool good = Look() && seen_.state.mode == Mode::kTorque &&
                      std::all_of(seen_.state.q.begin(), seen_.state.q.begin() + n_,
                                  [](double q) { return std::isfinite(q); }) &&
                      1e-9 * static_cast<double>(seen_.now_ns - seen_.state.stamp_ns) <= limits_.stale_s;
    if (!good) break;
    JointArray zero = gravity_;
    if (driver_.info().adds_gravity_compensation) zero.fill(0.0);
    if (!driver_.SendTorque(zero.data()).ok()) break;
    if (zero_torque_after_s_ < 0.0) zero_torque_after_s_ = SecondsSince(last_word_ns_);
    if (!driver_.SleepUntil(driver_.NowNanos() + kSettled).ok()) break;
  }
  stop_ = StopArm(driver_, options_.stop);
  stopped_it_ = true;
}

// The agent is gone. If it had ended its motion, nothing is under way; where the guard did, the agent may not have lived
// to see it.
void Guard::LeaveAlone() {
  if (!connected_) return;
  if (doing_ != Doing::kNothing) {
    trip_ = Trip{EndReason::kDriverLost, -1, 0, 0, driver_.NowNanos()};
    Stop();
  } else if (!stopped_it_) {
    return;
  }
  if (options_.latch_folder.empty()) return;
  Latch latch(options_.latch_folder);
  const auto entry = latch.Read();
  const std::string now = FormatWallTime(RealClock().WallNanos());
  if (LatchedMotion() != motion_ || (entry && entry->latched)) return;  // somebody else's by now, or judged already
  if (stop_.confirmed) {
    (void)latch.EndMotion().ok();
  } else {
    (void)latch.Set(entry ? entry->rollout : "", "the agent was lost; " + stop_.why, now).ok();
  }
}

}  // namespace rg::robot_agent
