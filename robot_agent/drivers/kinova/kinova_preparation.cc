// What an arm has to show before it is moved by torques, and the entry into torque mode.
#include <algorithm>
#include <cmath>

#include "common/base/log.h"
#include "common/base/printf.h"
#include "robot_agent/drivers/kinova/kinova_driver.h"
#include "robot_agent/drivers/kinova/units.h"

namespace rg::robot_agent::kinova {
namespace {

constexpr double kProbeBox = 0.2;            // rad: no joint goes further during a test
constexpr double kStateTimeout = 0.3;        // s, between states while torques are tested
constexpr double kAfterState = 0.012;        // s; what states come late by, and half of what is left of a period
constexpr double kZeroPoseTolerance = 0.06;  // rad: the arm's driver is content with 2°

}  // namespace

Status KinovaDriver::Prepare(double timeout_s) {
  std::vector<double> pose;
  for (const double degrees : options_.zero_pose_deg) pose.push_back(ToRadians(Degrees{degrees}).value);
  RG_RETURN_IF_ERROR(GoTo(pose.data(), kZeroPoseTolerance, timeout_s).WithPrefix("zero pose"));
  RG_RETURN_IF_ERROR(CheckNotStopped());
  if (!GoOnWithSession()) {
    session_.Forget();
    RG_RETURN_IF_ERROR(ZeroSensors());
    const Status tested = TestAllJoints();
    const Status held = HoldNow();
    RG_RETURN_IF_ERROR(tested);
    RG_RETURN_IF_ERROR(held);
    KeepSession();
  }
  prepared_ = true;
  return Status::Ok();
}

uint32_t KinovaDriver::NewestNumber() const {
  const std::lock_guard lock(mutex_);
  return last_number_;
}

// True: the joints have answered lately, on this arm, and its sensors still read nothing where there is nothing.
bool KinovaDriver::GoOnWithSession() {
  const auto session = session_.Read();
  const std::string run = link_->RunOfDriver(), arm = options_.robot_name + " " + run;
  if (run.empty() || !session || session->responses.size() != responses_.size() ||
      !Holds(*session, arm, NewestNumber(), NowNanos(), options_.prepare_every_s))
    return false;
  const Status zero = CheckSensors();
  const double age = 1e-9 * static_cast<double>(NowNanos() - session->prepared_ns);
  if (!zero.ok()) {
    spdlog::warn("prepared {:.0f} s ago, but {}; preparing again", age, zero.message());
    return false;
  }
  responses_ = session->responses;
  spdlog::info("all joints answered to their test torques {:.0f} s ago (prepare_every_s is {:.0f}): not again",
               age, options_.prepare_every_s);
  return true;
}

void KinovaDriver::KeepSession() const {
  const Status kept = session_.Write({.prepared_ns = NowNanos(),
                                      .arm = options_.robot_name + " " + link_->RunOfDriver(),
                                      .number = NewestNumber(),
                                      .responses = responses_});
  if (!kept.ok()) spdlog::warn("the preparation is not kept for the next rollout: {}", kept.message());
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
  RG_RETURN_IF_ERROR(Ask(ArmService::kTorqueParameters));
  RG_RETURN_IF_ERROR(Ask(ArmService::kZeroTorques));
  const Status zero = CheckSensors();
  if (zero.code() != StatusCode::kFailedPrecondition) return zero;
  return FailedPreconditionError(zero.message() +
                                 " after zeroing: let the arm stand free and upright (zero_pose_deg), then try "
                                 "again");
}

// In the zero pose.
Status KinovaDriver::CheckSensors() {
  int joint = 0;
  double effort = 0.0;
  RG_RETURN_IF_ERROR(WorstEffort(&joint, &effort));
  if (std::abs(effort) <= options_.zero_limit_nm) return Status::Ok();
  return FailedPreconditionError(Printf("the torque sensor of %s reads %.3g N·m in the zero pose, limit %.3g",
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
    if (status.ok()) status = JudgeEntry();  // first: a guard knows who asked for a stop
    if (status.ok()) status = CheckNotStopped();
    if (!status.ok()) break;
    *end = probe.Step(1e-9 * static_cast<double>(state.stamp_ns), state.q[joint]);
    JointArray command = base;
    command[joint] += probe.torque();
    Stream(command, true);
    for (int i = 0; i < options_.n() && status.ok(); ++i) {
      if (std::abs(state.q[i] - start[i]) <= kProbeBox) continue;
      status = FailedPreconditionError(
          info_.joints[i] + Printf(" moved by %.3g rad while torques were tested, at most %.3g may be",
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
          Printf("%s moved against its torque of %.2f N·m: the sign of its torques is wrong", name, reached));
    case ProbeEnd::kSilent:
      return FailedPreconditionError(Printf(
          "%s did not move at %.2f N·m above gravity, the most of its test (test_torque_nm)", name, reached));
    case ProbeEnd::kDrifts:
      return FailedPreconditionError(Printf(
          "%s drifts at %.3g rad/s under the arm's own gravity compensation: zero its sensors, or give "
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
  RG_RETURN_IF_ERROR(Ask(ArmService::kTorqueMode).WithPrefix("torque mode"));
  tested->clear();
  for (int joint = 0; joint < std::min(2, options_.n()); ++joint) {
    ProbeEnd end = ProbeEnd::kGoingOn;
    double reached = 0.0, drift = 0.0;
    RG_RETURN_IF_ERROR(TestJoint(joint, first, &end, &reached, &drift));
    if (end != ProbeEnd::kSilent) return JudgeTest(joint, end, reached, drift);
    *tested += (tested->empty() ? "" : ", ") + info_.joints[joint] + Printf(" at %.2f N·m", reached);
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
      return IsOutage(AwaitStill(0.1, 0.08, 0.5)) ? LostError() : Status::Ok();
    }
    RG_RETURN_IF_ERROR(CheckNotStopped());  // the stop is the caller's
    RG_RETURN_IF_ERROR(HoldNow());
    if (!silent) return entered;
    spdlog::warn("torque mode was refused in silence, attempt {} of {}", attempt + 1,
                 options_.torque_mode_attempts);
  }
  return FailedPreconditionError(
      Printf(
          "the arm refused torque mode in silence, %d times: its service succeeded, but these did not move: ",
          options_.torque_mode_attempts) +
      tested + " (zero its torque sensors; keep joints away from their limits)");
}

Status KinovaDriver::AwaitPhase() {
  RobotState state;
  RG_RETURN_IF_ERROR(ReadState(&state));
  const JointArray torque = Command();
  RG_RETURN_IF_ERROR(AwaitState(state.sequence, options_.outage_s, &state));
  time_->SleepUntil(NowNanos() + Nanos(kAfterState));
  Stream(torque, true);
  return Status::Ok();
}

Status KinovaDriver::EnterTorqueMode(const double* first) {
  if (!sender_.joinable()) return FailedPreconditionError("the arm is not connected");
  if (!prepared_) return FailedPreconditionError("the arm is not prepared: MoveToPose first");
  JointArray torque{};
  std::copy_n(first, options_.n(), torque.begin());
  if (const Status entered = EnterProved(torque); !entered.ok()) {
    session_.Forget();
    return entered;
  }
  RG_RETURN_IF_ERROR(AwaitPhase());
  const std::lock_guard lock(mutex_);
  motion_watch_.Restart();
  watch_motion_ = true;
  return Status::Ok();
}

}  // namespace rg::robot_agent::kinova
