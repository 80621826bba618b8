#include "robot_agent/drivers/kinova/kinova_driver.h"

#include <time.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdarg>
#include <cstdio>

#include "common/base/clock.h"
#include "common/base/log.h"

namespace rg::robot_agent::kinova {
namespace {

constexpr double kStillSpeed = 0.02;   // rad/s, differenced
constexpr double kProbeBox = 0.2;      // rad: no joint goes further during a test
constexpr double kStateTimeout = 0.3;  // s, between states while torques are tested
constexpr int kReportsForRate = 25;
constexpr int kPoseAttempts = 5;
constexpr double kAfterState = 0.012;  // s; what states come late by, and half of what is left of a period
constexpr double kStrongRatio = 1.5;   // of the test torque's most: no joint in torque mode resists it
constexpr double kZeroPoseTolerance = 0.06;  // rad: the arm's driver is content with 2°
constexpr double kPoseTolerance = 0.06;      // rad, of a move
constexpr double kPoseTimeout = 60.0;        // s, on the way to one pose

int64_t Nanos(double seconds) { return std::llround(1e9 * seconds); }

void SleepUntilSteady(int64_t deadline_ns) {
  const timespec until{deadline_ns / 1'000'000'000, deadline_ns % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
}

std::string Text(const char* format, ...) __attribute__((format(printf, 1, 2)));
std::string Text(const char* format, ...) {
  char text[240];
  va_list arguments;
  va_start(arguments, format);
  std::vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  return text;
}

MotionWatchOptions WatchOptions(const KinovaOptions& options) {
  MotionWatchOptions watch;
  watch.joints = options.n();
  for (int i = 0; i < watch.joints; ++i) watch.strong_nm[i] = kStrongRatio * options.test_torque_nm[i];
  return watch;
}

}  // namespace

KinovaDriver::KinovaDriver(KinovaOptions options, std::unique_ptr<ArmLink> link)
    : options_(std::move(options)),
      ros_names_(RosJointNames(options_.robot_name, options_.n())),
      responses_(options_.n()),
      motion_watch_(WatchOptions(options_)),
      link_(std::move(link)) {
  for (int i = 0; i < options_.n(); ++i)
    unwrappers_.emplace_back(options_.continuous[i], ToRadians(Degrees{options_.zero_pose_deg[i]}));
  info_.robot = options_.robot;
  info_.driver = "kinova";
  info_.joints = options_.joints;
  info_.adds_gravity_compensation = true;
  info_.silence_timeout_s = 0.25;
}

KinovaDriver::~KinovaDriver() {
  const auto is = [this](bool KinovaDriver::*flag) {
    const std::lock_guard lock(mutex_);
    return this->*flag;
  };
  EndMove();
  if (is(&KinovaDriver::streaming_)) (void)HoldNow().ok();
  const int64_t give_up = NowNanos() + Nanos(options_.farewell_s);
  while (sender_.joinable() && is(&KinovaDriver::position_mode_owed_) && NowNanos() < give_up)
    SleepUntilSteady(NowNanos() + Nanos(0.02));
  if (is(&KinovaDriver::position_mode_owed_))
    spdlog::error("the arm never confirmed position mode: it may float under its own gravity compensation");
  ended_ = true;
  if (sender_.joinable()) sender_.join();
  link_.reset();
}

// ---- connecting ----

Status KinovaDriver::Connect(double timeout_s) {
  if (sender_.joinable()) return FailedPreconditionError("the arm is connected already");
  RG_RETURN_IF_ERROR(link_->Open([this](const Result<JointReport>& report) { OnReport(report); }));
  const int64_t give_up = NowNanos() + Nanos(timeout_s);
  const auto left = [&] { return std::max(0.0, 1e-9 * static_cast<double>(give_up - NowNanos())); };
  RG_RETURN_IF_ERROR(AwaitFirstState(left()));
  RG_RETURN_IF_ERROR(CheckRate(left()));
  RG_RETURN_IF_ERROR(AwaitHeard(left()));
  RG_RETURN_IF_ERROR(PositionMode().WithPrefix("position mode"));
  {
    const std::lock_guard lock(mutex_);
    health_.connected = true;
    info_.state_rate_hz = rate_.hz();
  }
  sender_ = std::thread([this] { SendForEver(); });
  return Status::Ok();
}

Status KinovaDriver::AwaitFirstState(double timeout_s) {
  std::unique_lock lock(mutex_);
  arrived_.wait_for(lock, std::chrono::duration<double>(timeout_s), [&] { return has_state_; });
  if (has_state_) return Status::Ok();
  if (!implausible_.empty())
    return FailedPreconditionError("states of the arm are not plausible: " + implausible_);
  return UnavailableError("no state on /" + options_.robot_name + "_driver/out/joint_state within " +
                          Text("%.3g s: is kinova_robot.launch running as kinova_robotName:=", timeout_s) +
                          options_.robot_name + ", and the arm on?");
}

Status KinovaDriver::CheckRate(double timeout_s) {
  std::unique_lock lock(mutex_);
  // The first intervals after subscribing are not the arm's.
  rate_.Restart();
  arrived_.wait_for(lock, std::chrono::duration<double>(std::min(timeout_s, 1.5)),
                    [&] { return rate_.intervals() >= kReportsForRate; });
  const double hz = rate_.hz();
  lock.unlock();
  if (hz >= options_.least_rate_hz) return Status::Ok();
  const auto interval = link_->StatusInterval();
  return FailedPreconditionError(
      Text("states arrive at %.1f Hz, torque control needs %.4g: start kinova_robot.launch with "
           "feedback_publish_rate:=%.2f, an interval in seconds (%s)",
           hz, options_.least_rate_hz, 1.0 / kWantedRateHz,
           interval ? Text("its status_interval_seconds is %.3g", *interval).c_str()
                    : "its status_interval_seconds is not set"));
}

// What is published before the arm's driver has subscribed is lost.
Status KinovaDriver::AwaitHeard(double timeout_s) {
  const int64_t give_up = NowNanos() + Nanos(timeout_s);
  while (!link_->TorquesAreHeard()) {
    if (NowNanos() > give_up)
      return UnavailableError("nobody listens to /" + options_.robot_name + "_driver/in/joint_torque");
    SleepUntilSteady(NowNanos() + Nanos(0.01));
  }
  return Status::Ok();
}

DriverHealth KinovaDriver::health() const {
  const std::lock_guard lock(mutex_);
  return health_;
}

// ---- states ----

void KinovaDriver::OnReport(const Result<JointReport>& report) {
  const Status judged = report.ok() ? CheckPlausible(*report, ros_names_) : report.status();
  const std::lock_guard lock(mutex_);
  if (judged.ok()) {
    TakeReport(*report);
  } else {
    ++health_.malformed;
    implausible_ = judged.message();
    health_.last_error = judged.message();
  }
  arrived_.notify_all();
}

void KinovaDriver::TakeReport(const JointReport& report) {
  const uint32_t gap = report.number - last_number_;
  if (has_state_ && gap > 1 && gap < 1'000'000) health_.states_lost += gap - 1;
  last_number_ = report.number;
  received_ns_ = report.received_ns;
  rate_.Note(report.received_ns);
  ++health_.states_received;
  ++reports_since_outage_;
  state_.stamp_ns = clock_map_.ToHost(report.stamp_ns, report.received_ns);
  ++state_.sequence;
  for (int i = 0; i < options_.n(); ++i) state_.q[i] = unwrappers_[i].Unwrap({report.q[i]}).value;
  state_.v = report.v;
  state_.effort = report.effort;
  if (streaming_ && watch_motion_ && motion_watch_.Step(state_.stamp_ns, state_.q, command_)) {
    mode_lost_ = true;
    health_.last_error = "the arm stands still against its torques: it has left torque mode";
  }
  state_.mode = streaming_ && !mode_lost_ ? Mode::kTorque : Mode::kPosition;
  state_.moving = moving_ || under_way_;
  has_state_ = true;
}

int64_t KinovaDriver::NowNanos() const { return RealClock().SteadyNanos(); }

Status KinovaDriver::LostError() const {
  return UnavailableError(Text("the arm's driver has sent no states for %.3g s", options_.outage_s));
}

Status KinovaDriver::SleepUntil(int64_t deadline_ns) {
  SleepUntilSteady(deadline_ns);
  const std::lock_guard lock(mutex_);
  return lost_ ? LostError() : Status::Ok();
}

Status KinovaDriver::ReadState(RobotState* state) {
  const std::lock_guard lock(mutex_);
  if (lost_) return LostError();
  if (!has_state_) return UnavailableError("no state was received yet");
  *state = state_;
  return Status::Ok();
}

Status KinovaDriver::AwaitState(uint64_t sequence, double timeout_s, RobotState* state) {
  std::unique_lock lock(mutex_);
  arrived_.wait_for(lock, std::chrono::duration<double>(timeout_s),
                    [&] { return lost_ || state_.sequence > sequence; });
  if (lost_) return LostError();
  if (state_.sequence <= sequence)
    return UnavailableError(Text("the arm sent no state for %.3g s", timeout_s));
  *state = state_;
  return Status::Ok();
}

Status KinovaDriver::AwaitStill(double speed, double for_s, double at_most_s) {
  const int64_t give_up = NowNanos() + Nanos(at_most_s);
  RobotState anchor, now;
  RG_RETURN_IF_ERROR(ReadState(&anchor));
  now = anchor;
  while (true) {
    RG_RETURN_IF_ERROR(CheckNotStopped());
    RG_RETURN_IF_ERROR(AwaitState(now.sequence, options_.outage_s, &now));
    double furthest = 0.0;
    for (int i = 0; i < options_.n(); ++i) furthest = std::max(furthest, std::abs(now.q[i] - anchor.q[i]));
    const double elapsed = 1e-9 * static_cast<double>(now.stamp_ns - anchor.stamp_ns);
    if (furthest <= speed * for_s && elapsed >= for_s) return Status::Ok();
    if (NowNanos() > give_up)
      return DeadlineExceededError(Text("the arm still moves: %.3g rad in %.3g s", furthest, elapsed));
    if (furthest > speed * for_s) anchor = now;
  }
}

// ---- position mode ----

Status KinovaDriver::PositionMode() {
  const std::lock_guard lock(services_);
  return link_->Call(ArmService::kPositionMode, options_.service_timeout_s);
}

Status KinovaDriver::HoldNow() {
  if (!sender_.joinable()) return UnavailableError("the arm is not connected");
  {
    const std::lock_guard lock(mutex_);
    command_ = {};
    commanded_ns_ = NowNanos();
    position_mode_owed_ = true;
    if (lost_) return LostError();  // the sender sees to it when the arm is back
  }
  const Status held = PositionMode();
  StopStream();
  RG_RETURN_IF_ERROR(held.WithPrefix("position mode"));  // still owed: the sender goes on asking
  {
    const std::lock_guard lock(mutex_);
    position_mode_owed_ = mode_lost_ = false;
  }
  const Status still = AwaitStill(kStillSpeed, 0.3, 2.0);
  if (still.ok()) return still;
  const std::lock_guard lock(mutex_);
  position_mode_owed_ = true;
  return UnavailableError("position mode is not confirmed: " + still.message());
}

Status KinovaDriver::Hold() {
  EndMove();
  return HoldNow();
}

// The arm stops at once, by position mode, which also ends its way to a pose; its thread notices and ends.
void KinovaDriver::EndMove() {
  if (!mover_.joinable()) return;
  stop_move_ = true;
  bool under_way = false;
  {
    const std::lock_guard lock(mutex_);
    under_way = under_way_;
    if (under_way) command_ = {};
  }
  if (under_way) {
    link_->CancelMove();
    (void)PositionMode().ok();  // confirmed by the caller
  }
  mover_.join();
  stop_move_ = false;
}

Status KinovaDriver::CheckNotStopped() const {
  return stop_move_ ? CancelledError("the move was stopped") : Status::Ok();
}

Status KinovaDriver::StartMove(const double* q) {
  if (!sender_.joinable()) return UnavailableError("the arm is not connected");
  EndMove();
  {
    const std::lock_guard lock(mutex_);
    if (lost_) return LostError();
    under_way_ = state_.moving = true;
  }
  JointArray pose{};
  std::copy_n(q, options_.n(), pose.begin());
  mover_ = std::thread([this, pose] {
    const Status moved = MoveToPose(pose.data(), kPoseTolerance, kPoseTimeout);
    if (!moved.ok()) spdlog::error("the way to the pose: {}", moved.message());
    const std::lock_guard lock(mutex_);
    if (!moved.ok()) health_.last_error = moved.message();
    under_way_ = false;
  });
  return Status::Ok();
}

Status KinovaDriver::MoveToPose(const double* q, double tolerance, double timeout_s) {
  if (!sender_.joinable()) return UnavailableError("the arm is not connected");
  if (!prepared_) RG_RETURN_IF_ERROR(Prepare(timeout_s));
  return GoTo(q, tolerance, timeout_s);
}

Status KinovaDriver::GoTo(const double* q, double tolerance, double timeout_s) {
  RG_RETURN_IF_ERROR(HoldNow());
  const int64_t give_up = NowNanos() + Nanos(timeout_s);
  const auto moving = [this](bool on) {
    const std::lock_guard lock(mutex_);
    moving_ = on;
  };
  Status moved;
  for (int attempt = 1;; ++attempt) {
    std::vector<Degrees> pose;
    {
      const std::lock_guard lock(mutex_);
      for (int i = 0; i < options_.n(); ++i) pose.push_back(ToDegrees(unwrappers_[i].Raw({q[i]})));
    }
    RG_RETURN_IF_ERROR(CheckNotStopped());
    moving(true);
    moved = link_->MoveTo(pose, std::max(0.1, 1e-9 * static_cast<double>(give_up - NowNanos())));
    if (moved.ok()) moved = AwaitStill(kStillSpeed, 0.2, 2.0);
    moving(false);
    RG_RETURN_IF_ERROR(CheckNotStopped());
    if (moved.code() == StatusCode::kUnavailable) return moved;
    RobotState state;
    RG_RETURN_IF_ERROR(ReadState(&state));
    double worst = 0.0;
    for (int i = 0; i < options_.n(); ++i) worst = std::max(worst, std::abs(state.q[i] - q[i]));
    if (moved.ok() && worst <= tolerance) return Status::Ok();
    if (NowNanos() < give_up && attempt < kPoseAttempts) continue;
    RG_RETURN_IF_ERROR(HoldNow());
    return DeadlineExceededError(Text("the pose was not reached, still %.3g rad away", worst) +
                                 (moved.ok() ? "" : ": " + moved.message()));
  }
}

// ---- preparation ----

Status KinovaDriver::Prepare(double timeout_s) {
  std::vector<double> pose;
  for (const double degrees : options_.zero_pose_deg) pose.push_back(ToRadians(Degrees{degrees}).value);
  RG_RETURN_IF_ERROR(GoTo(pose.data(), kZeroPoseTolerance, timeout_s).WithPrefix("zero pose"));
  RG_RETURN_IF_ERROR(CheckNotStopped());
  RG_RETURN_IF_ERROR(ZeroSensors());
  const Status tested = TestAllJoints();
  const Status held = HoldNow();
  RG_RETURN_IF_ERROR(tested);
  RG_RETURN_IF_ERROR(held);
  prepared_ = true;
  return Status::Ok();
}

Status KinovaDriver::WorstEffort(int* joint, double* effort) {
  JointArray sum{};
  constexpr int kStates = 10;
  RobotState state;
  RG_RETURN_IF_ERROR(ReadState(&state));
  for (int k = 0; k < kStates; ++k) {
    RG_RETURN_IF_ERROR(AwaitState(state.sequence, options_.outage_s, &state));
    for (int i = 0; i < options_.n(); ++i) sum[i] += state.effort[i] / kStates;
  }
  *joint = 0;
  for (int i = 1; i < options_.n(); ++i)
    if (std::abs(sum[i]) > std::abs(sum[*joint])) *joint = i;
  *effort = sum[*joint];
  return Status::Ok();
}

Status KinovaDriver::ZeroSensors() {
  int joint = 0;
  double effort = 0.0;
  {
    const std::lock_guard lock(services_);
    RG_RETURN_IF_ERROR(link_->Call(ArmService::kTorqueParameters, options_.service_timeout_s));
    RG_RETURN_IF_ERROR(link_->Call(ArmService::kZeroTorques, options_.service_timeout_s));
  }
  RG_RETURN_IF_ERROR(WorstEffort(&joint, &effort));
  if (std::abs(effort) <= options_.zero_limit_nm) return Status::Ok();
  return FailedPreconditionError(
      Text("the torque sensor of %s reads %.3g N·m after zeroing in the zero pose, limit %.3g: let the arm "
           "stand free and upright (zero_pose_deg), then try again",
           info_.joints[joint].c_str(), effort, options_.zero_limit_nm));
}

Status KinovaDriver::TestJoint(int joint, const JointArray& base, ProbeEnd* end, double* reached,
                               double* drift) {
  ProbeOptions options;
  options.most_nm = options_.test_torque_nm[joint];
  options.rate_nm_per_s = options.most_nm;  // the ramp takes a second
  options.motion_rad = options_.test_motion_rad;
  TorqueProbe probe(options);
  RobotState state;
  RG_RETURN_IF_ERROR(ReadState(&state));
  const JointArray start = state.q;
  Status status;
  do {
    status = AwaitState(state.sequence, kStateTimeout, &state);
    if (status.ok()) status = CheckNotStopped();
    if (!status.ok()) break;
    *end = probe.Step(1e-9 * static_cast<double>(state.stamp_ns), state.q[joint]);
    JointArray command = base;
    command[joint] += probe.torque();
    Stream(command, true);
    for (int i = 0; i < options_.n() && status.ok(); ++i) {
      if (std::abs(state.q[i] - start[i]) <= kProbeBox) continue;
      status = FailedPreconditionError(
          info_.joints[i] + Text(" moved by %.3g rad while torques were tested, at most %.3g may be",
                                 state.q[i] - start[i], kProbeBox));
    }
  } while (status.ok() && *end == ProbeEnd::kGoingOn);
  Stream(base, true);
  *reached = probe.reached_nm();
  *drift = probe.drift_rad_per_s();
  return status;
}

Status KinovaDriver::JudgeTest(int joint, ProbeEnd end, double reached, double drift) const {
  const char* name = info_.joints[joint].c_str();
  switch (end) {
    case ProbeEnd::kMoved:
    case ProbeEnd::kGoingOn:
      return Status::Ok();
    case ProbeEnd::kWrongSign:
      return FailedPreconditionError(
          Text("%s moved against its torque of %.2f N·m: the sign of its torques is wrong", name, reached));
    case ProbeEnd::kSilent:
      return FailedPreconditionError(Text(
          "%s did not move at %.2f N·m above gravity, the most of its test (test_torque_nm)", name, reached));
    case ProbeEnd::kDrifts:
      return FailedPreconditionError(
          Text("%s drifts at %.3g rad/s under the arm's own gravity compensation: zero its sensors, or give "
               "the arm its payload and masses (COM parameters)",
               name, drift));
  }
  return Status::Ok();
}

Status KinovaDriver::TestAllJoints() {
  const JointArray zero{};
  RG_RETURN_IF_ERROR(EnterProved(zero));
  for (int joint = 0; joint < options_.n(); ++joint) {
    ProbeEnd end = ProbeEnd::kGoingOn;
    RG_RETURN_IF_ERROR(
        TestJoint(joint, zero, &end, &responses_[joint].torque_nm, &responses_[joint].drift_rad_per_s));
    RG_RETURN_IF_ERROR(JudgeTest(joint, end, responses_[joint].torque_nm, responses_[joint].drift_rad_per_s));
    spdlog::info("{} answers at {:.2f} N·m above gravity", info_.joints[joint], responses_[joint].torque_nm);
  }
  return Status::Ok();
}

// ---- torque mode ----

Status KinovaDriver::TryTorqueMode(const JointArray& first, bool* silent, std::string* tested) {
  *silent = false;
  Stream(first, true);
  {
    const std::lock_guard lock(services_);
    RG_RETURN_IF_ERROR(
        link_->Call(ArmService::kTorqueMode, options_.service_timeout_s).WithPrefix("torque mode"));
  }
  tested->clear();
  for (int joint = 0; joint < std::min(2, options_.n()); ++joint) {
    ProbeEnd end = ProbeEnd::kGoingOn;
    double reached = 0.0, drift = 0.0;
    RG_RETURN_IF_ERROR(TestJoint(joint, first, &end, &reached, &drift));
    if (end != ProbeEnd::kSilent) return JudgeTest(joint, end, reached, drift);
    *tested += (tested->empty() ? "" : ", ") + info_.joints[joint] + Text(" at %.2f N·m", reached);
  }
  *silent = true;
  return FailedPreconditionError("refused");
}

Status KinovaDriver::EnterProved(const JointArray& first) {
  std::string tested;
  for (int attempt = 0; attempt < options_.torque_mode_attempts; ++attempt) {
    RG_RETURN_IF_ERROR(CheckNotStopped());
    bool silent = false;
    const Status entered = TryTorqueMode(first, &silent, &tested);
    if (entered.ok()) {
      Stream(first, true);
      return AwaitStill(0.1, 0.08, 0.5).code() == StatusCode::kUnavailable ? LostError() : Status::Ok();
    }
    RG_RETURN_IF_ERROR(HoldNow());
    if (!silent) return entered;
    spdlog::warn("torque mode was refused in silence, attempt {} of {}", attempt + 1,
                 options_.torque_mode_attempts);
  }
  return FailedPreconditionError(
      Text(
          "the arm refused torque mode in silence, %d times: its service succeeded, but these did not move: ",
          options_.torque_mode_attempts) +
      tested + " (zero its torque sensors; keep joints away from their limits)");
}

Status KinovaDriver::AwaitPhase() {
  RobotState state;
  RG_RETURN_IF_ERROR(ReadState(&state));
  const JointArray torque = Command();
  RG_RETURN_IF_ERROR(AwaitState(state.sequence, options_.outage_s, &state));
  SleepUntilSteady(NowNanos() + Nanos(kAfterState));
  Stream(torque, true);
  return Status::Ok();
}

Status KinovaDriver::EnterTorqueMode(const double* first) {
  if (!sender_.joinable()) return UnavailableError("the arm is not connected");
  if (!prepared_) return FailedPreconditionError("the arm is not prepared: MoveToPose first");
  JointArray torque{};
  std::copy_n(first, options_.n(), torque.begin());
  RG_RETURN_IF_ERROR(EnterProved(torque));
  RG_RETURN_IF_ERROR(AwaitPhase());
  const std::lock_guard lock(mutex_);
  motion_watch_.Restart();
  watch_motion_ = true;
  return Status::Ok();
}

Status KinovaDriver::SendTorque(const double* tau) {
  const std::lock_guard lock(mutex_);
  if (lost_) return LostError();
  if (!streaming_) return FailedPreconditionError("the arm is not in torque mode");
  std::copy_n(tau, options_.n(), command_.begin());
  commanded_ns_ = NowNanos();
  ++health_.commands_sent;
  return Status::Ok();
}

void KinovaDriver::Stream(const JointArray& tau, bool fresh) {
  const std::lock_guard lock(mutex_);
  command_ = tau;
  if (fresh) commanded_ns_ = NowNanos();
  streaming_ = !lost_;
}

JointArray KinovaDriver::Command() const {
  const std::lock_guard lock(mutex_);
  return command_;
}

void KinovaDriver::StopStream() {
  const std::lock_guard lock(mutex_);
  streaming_ = watch_motion_ = false;
}

// ---- the sender's thread ----

void KinovaDriver::SendForEver() {
  const int64_t period = Nanos(1.0 / kCommandRateHz);
  int64_t next = NowNanos();
  while (!ended_) {
    SleepUntilSteady(next);
    const int64_t now = NowNanos();
    SendOnce(now);
    WatchLink(now);
    next = std::max(next + period, now);
  }
}

void KinovaDriver::SendOnce(int64_t now_ns) {
  JointArray torque{};
  bool ask = false;
  {
    const std::lock_guard lock(mutex_);
    if (!streaming_) return;
    const int64_t silence = now_ns - commanded_ns_;
    if (silence <= Nanos(options_.command_timeout_s)) torque = command_;
    if (silence > Nanos(options_.command_timeout_s + 0.5)) {
      ask = position_mode_owed_ = true;
      streaming_ = watch_motion_ = false;
      health_.last_error = "no command for too long: position mode";
    }
  }
  if (!ask) link_->PublishTorque(torque);
}

void KinovaDriver::WatchLink(int64_t now_ns) {
  bool back = false;
  {
    const std::lock_guard lock(mutex_);
    if (!lost_ && now_ns - received_ns_ > Nanos(options_.outage_s)) {
      lost_ = true;
      health_.connected = false;
      health_.last_error = LostError().message();
      position_mode_owed_ = true;
      streaming_ = watch_motion_ = false;
      reports_since_outage_ = 0;
      arrived_.notify_all();
    }
    // Owed after an outage, or because the caller fell silent.
    back = position_mode_owed_ && !streaming_ && (lost_ ? reports_since_outage_ >= 5 : true);
    if (now_ns < next_try_ns_) return;
    next_try_ns_ = now_ns + Nanos(0.2);
  }
  if (!back || !services_.try_lock()) return;
  const std::lock_guard lock(services_, std::adopt_lock);
  if (!link_->Call(ArmService::kPositionMode, options_.service_timeout_s).ok()) return;
  const std::lock_guard state_lock(mutex_);
  position_mode_owed_ = false;
  if (!lost_) return;
  lost_ = false;
  prepared_ = false;
  health_.connected = true;
}

}  // namespace rg::robot_agent::kinova
