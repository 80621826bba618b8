#include "robot_agent/drivers/kinova/kinova_driver.h"

#include <algorithm>
#include <cmath>

#include "common/base/log.h"
#include "common/base/printf.h"
#include "robot_agent/drivers/kinova/units.h"

namespace rg::robot_agent::kinova {
namespace {

constexpr double kStillSpeed = 0.02;  // rad/s, differenced
constexpr int kReportsForRate = 25;
constexpr int kPoseAttempts = 5;
constexpr double kStrongRatio = 1.5;     // of the test torque's most: no joint in torque mode resists it
constexpr double kPoseTolerance = 0.06;  // rad, of a move
constexpr double kPoseTimeout = 60.0;    // s, on the way to one pose
constexpr double kSilence = 0.3;         // s without a state: who refuses something is there, and sends them

MotionWatchOptions WatchOptions(const KinovaOptions& options) {
  MotionWatchOptions watch;
  watch.joints = options.n();
  for (int i = 0; i < watch.joints; ++i) watch.strong_nm[i] = kStrongRatio * options.test_torque_nm[i];
  return watch;
}

}  // namespace

KinovaDriver::KinovaDriver(KinovaOptions options, std::unique_ptr<ArmLink> link,
                           std::shared_ptr<DriverTime> time)
    : options_(std::move(options)),
      time_(std::move(time)),
      session_(options_.session_path),
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
    time_->SleepUntil(NowNanos() + Nanos(0.02));
  if (is(&KinovaDriver::position_mode_owed_))
    spdlog::error("the arm never confirmed position mode: it may float under its own gravity compensation");
  ended_ = true;
  if (sender_.joinable()) time_->Join(sender_);
  link_.reset();
}

// ---- connecting ----

Status KinovaDriver::Connect(double timeout_s) {
  if (sender_.joinable()) return FailedPreconditionError("the arm is connected already");
  RG_RETURN_IF_ERROR(link_->Open([this](const Result<JointReport>& report) { OnReport(report); }));
  {
    const std::lock_guard lock(mutex_);
    has_state_ = false;  // of an arm that was away since
  }
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
  sender_ = time_->Start([this] { SendForEver(); });
  return Status::Ok();
}

Status KinovaDriver::AwaitFirstState(double timeout_s) {
  std::unique_lock lock(mutex_);
  time_->Wait(lock, arrived_, NowNanos() + Nanos(timeout_s), [&] { return has_state_; });
  if (has_state_) return Status::Ok();
  if (!implausible_.empty())
    return FailedPreconditionError("states of the arm are not plausible: " + implausible_);
  return UnavailableError("no state on /" + options_.robot_name + "_driver/out/joint_state within " +
                          Printf("%.3g s: is kinova_robot.launch running as kinova_robotName:=", timeout_s) +
                          options_.robot_name + ", and the arm on?");
}

Status KinovaDriver::CheckRate(double timeout_s) {
  std::unique_lock lock(mutex_);
  // The first intervals after subscribing are not the arm's.
  rate_.Restart();
  time_->Wait(lock, arrived_, NowNanos() + Nanos(std::min(timeout_s, 1.5)),
              [&] { return rate_.intervals() >= kReportsForRate; });
  const double hz = rate_.hz(), otherwise = rate_.hz_without_longest();
  lock.unlock();
  if (hz >= options_.least_rate_hz) return Status::Ok();
  if (hz == 0.0 || otherwise >= options_.least_rate_hz)
    return UnavailableError("the arm's driver fell silent while its states were counted");
  const auto interval = link_->StatusInterval();
  return FailedPreconditionError(
      Printf("states arrive at %.1f Hz, torque control needs %.4g: start kinova_robot.launch with "
             "feedback_publish_rate:=%.2f, an interval in seconds (%s)",
             hz, options_.least_rate_hz, 1.0 / kWantedRateHz,
             interval ? Printf("its status_interval_seconds is %.3g", *interval).c_str()
                      : "its status_interval_seconds is not set"));
}

// What is published before the arm's driver has subscribed is lost.
Status KinovaDriver::AwaitHeard(double timeout_s) {
  const int64_t give_up = NowNanos() + Nanos(timeout_s);
  while (!link_->TorquesAreHeard()) {
    if (NowNanos() > give_up)
      return UnavailableError("nobody listens to /" + options_.robot_name + "_driver/in/joint_torque");
    time_->SleepUntil(NowNanos() + Nanos(0.01));
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

int64_t KinovaDriver::NowNanos() const { return time_->NowNanos(); }

Status KinovaDriver::LostError() const {
  return UnavailableError(Printf("the arm's driver has sent no states for %.3g s", options_.outage_s));
}

Status KinovaDriver::SleepUntil(int64_t deadline_ns) {
  time_->SleepUntil(deadline_ns);
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
  time_->Wait(lock, arrived_, NowNanos() + Nanos(timeout_s),
              [&] { return lost_ || state_.sequence > sequence; });
  if (lost_) return LostError();
  if (state_.sequence <= sequence)
    return UnavailableError(Printf("the arm sent no state for %.3g s", timeout_s));
  *state = state_;
  return Status::Ok();
}

Status KinovaDriver::AwaitStill(double speed, double for_s, double at_most_s) {
  const int64_t give_up = NowNanos() + Nanos(at_most_s);
  RobotState anchor, now;
  RG_RETURN_IF_ERROR(ReadState(&anchor));
  now = anchor;
  while (true) {
    if (stop_move_) return CheckNotStopped();
    RG_RETURN_IF_ERROR(AwaitState(now.sequence, options_.outage_s, &now));
    double furthest = 0.0;
    for (int i = 0; i < options_.n(); ++i) furthest = std::max(furthest, std::abs(now.q[i] - anchor.q[i]));
    const double elapsed = 1e-9 * static_cast<double>(now.stamp_ns - anchor.stamp_ns);
    if (furthest <= speed * for_s && elapsed >= for_s) return Status::Ok();
    if (NowNanos() > give_up)
      return DeadlineExceededError(Printf("the arm still moves: %.3g rad in %.3g s", furthest, elapsed));
    if (furthest > speed * for_s) anchor = now;
  }
}

// ---- position mode ----

Status KinovaDriver::PositionMode() { return Ask(ArmService::kPositionMode); }

Status KinovaDriver::Ask(ArmService service) {
  Status asked;
  {
    const auto lock = time_->Lock(services_);
    asked = link_->Call(service, options_.service_timeout_s);
  }
  return asked.ok() ? asked : RefusedOrAway(asked);
}

// By the states that go on or do not: what a service or an action says is the same in both cases.
Status KinovaDriver::RefusedOrAway(const Status& failed) {
  if (IsOutage(failed)) return failed;
  const int64_t failed_ns = NowNanos();
  RobotState state;
  do {
    const Status there = AwaitState(state.sequence, kSilence, &state);
    if (!there.ok()) return Status(there.code(), failed.message() + ", and " + there.message());
  } while (state.stamp_ns < failed_ns);
  return FailedPreconditionError(failed.message());
}

Status KinovaDriver::HoldNow() {
  if (!sender_.joinable()) return FailedPreconditionError("the arm is not connected");
  bool surprised = false;
  {
    const std::lock_guard lock(mutex_);
    command_ = {};
    commanded_ns_ = NowNanos();
    position_mode_owed_ = true;
    if (lost_) return LostError();  // the sender sees to it when the arm is back
    surprised = mode_lost_;
  }
  if (surprised) session_.Forget();
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
  const std::string words = "position mode is not confirmed: " + still.message();
  return IsOutage(still) ? UnavailableError(words) : FailedPreconditionError(words);
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
  time_->Join(mover_);
  stop_move_ = false;
}

Status KinovaDriver::CheckNotStopped() const {
  return stop_move_ || stop_asked() || link_->StopAsked() ? CancelledError("stopped") : Status::Ok();
}

Status KinovaDriver::StartMove(const double* q) {
  if (!sender_.joinable()) return FailedPreconditionError("the arm is not connected");
  EndMove();
  {
    const std::lock_guard lock(mutex_);
    if (lost_) return LostError();
    under_way_ = state_.moving = true;
    move_end_ = Status::Ok();
  }
  JointArray pose{};
  std::copy_n(q, options_.n(), pose.begin());
  mover_ = time_->Start([this, pose] {
    const Status moved = MoveToPose(pose.data(), kPoseTolerance, kPoseTimeout);
    if (!moved.ok()) spdlog::error("the way to the pose: {}", moved.message());
    const std::lock_guard lock(mutex_);
    if (!moved.ok()) health_.last_error = moved.message();
    move_end_ = moved;
    under_way_ = false;
  });
  return Status::Ok();
}

Status KinovaDriver::MoveEnd() {
  const std::lock_guard lock(mutex_);
  return move_end_;
}

Status KinovaDriver::MoveToPose(const double* q, double tolerance, double timeout_s) {
  if (!sender_.joinable()) return FailedPreconditionError("the arm is not connected");
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
    moved = link_->MoveTo(pose, std::max(0.1, 1e-9 * static_cast<double>(give_up - NowNanos())), stop_move_);
    if (moved.ok()) moved = AwaitStill(kStillSpeed, 0.2, 2.0);
    moving(false);
    RG_RETURN_IF_ERROR(CheckNotStopped());
    if (moved.code() == StatusCode::kNotFound) return RefusedOrAway(moved);
    if (IsOutage(moved)) return moved;
    RobotState state;
    RG_RETURN_IF_ERROR(ReadState(&state));
    double worst = 0.0;
    for (int i = 0; i < options_.n(); ++i) worst = std::max(worst, std::abs(state.q[i] - q[i]));
    if (moved.ok() && worst <= tolerance) return Status::Ok();
    if (NowNanos() < give_up && attempt < kPoseAttempts) continue;
    RG_RETURN_IF_ERROR(HoldNow());
    return DeadlineExceededError(Printf("the pose was not reached, still %.3g rad away", worst) +
                                 (moved.ok() ? "" : ": " + moved.message()));
  }
}

// ---- torque ----

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
    time_->SleepUntil(next);
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
  bool back = false, just_lost = false;
  {
    const std::lock_guard lock(mutex_);
    if (!lost_ && now_ns - received_ns_ > Nanos(options_.outage_s)) {
      lost_ = just_lost = true;
      health_.connected = false;
      health_.last_error = LostError().message();
      position_mode_owed_ = true;
      streaming_ = watch_motion_ = false;
      reports_since_outage_ = 0;
      arrived_.notify_all();
    }
    // Owed after an outage, or because the caller fell silent.
    back = position_mode_owed_ && !streaming_ && (lost_ ? reports_since_outage_ >= 5 : true) &&
           now_ns >= next_try_ns_;
    if (now_ns >= next_try_ns_) next_try_ns_ = now_ns + Nanos(0.2);
  }
  if (just_lost) session_.Forget();
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
