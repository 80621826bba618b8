#include "robot_agent/drivers/replay/replay_driver.h"

#include <time.h>

#include <algorithm>
#include <cmath>

#include "common/base/clock.h"
#include "common/recordings/recording_set.h"

namespace rg::robot_agent {
namespace {

constexpr double kStartTolerance = 0.05;  // rad or m, of a move to where the recording begins

Result<recordings::Recording> Choose(const recordings::RecordingSet& set, const std::string& name) {
  std::string known;
  for (const auto& recording : set.recordings) {
    if (name.empty() || recording.name == name) return recording;
    known += " " + recording.name;
  }
  return NotFoundError(set.folder + " has no recording " + name + " (it has" + known + ")");
}

// The rate that half of the intervals have or exceed.
double RateOf(const recordings::Recording& recording) {
  std::vector<double> intervals;
  for (int k = 1; k < recording.rows(); ++k) intervals.push_back(recording.t[k] - recording.t[k - 1]);
  std::nth_element(intervals.begin(), intervals.begin() + intervals.size() / 2, intervals.end());
  return 1.0 / intervals[intervals.size() / 2];
}

}  // namespace

Status ReplayDriver::Connect(double) {
  if (!info_.joints.empty()) return FailedPreconditionError("the recording is played already");
  RG_ASSIGN_OR_RETURN(const recordings::RecordingSet set, recordings::LoadSet(options_.folder));
  RG_ASSIGN_OR_RETURN(recording_, Choose(set, options_.recording));
  if (recording_.rows() < 2) return InvalidError(options_.folder + ": " + recording_.name + " has no motion");
  if (recording_.n() > kMaxJoints)
    return InvalidError(options_.folder + ": " + std::to_string(recording_.n()) + " joints, limit " +
                        std::to_string(kMaxJoints));
  info_.robot = options_.robot;
  info_.driver = "replay";
  info_.joints = recording_.joints;
  info_.adds_gravity_compensation = set.effort_excludes_gravity;
  info_.lock_step = options_.lock_step;
  info_.state_rate_hz = RateOf(recording_);
  info_.position_stddev = set.noise.position_stddev.value_or(-1.0);
  info_.velocity_stddev = set.noise.velocity_stddev.value_or(-1.0);
  info_.position_resolution = set.noise.position_resolution.value_or(-1.0);
  health_.connected = true;
  return Status::Ok();
}

int64_t ReplayDriver::NowNanos() const {
  return options_.lock_step ? lock_step_ns_ : RealClock().SteadyNanos();
}

Status ReplayDriver::SleepUntil(int64_t deadline_ns) {
  if (options_.lock_step) {
    lock_step_ns_ = std::max(lock_step_ns_, deadline_ns);
    return Status::Ok();
  }
  const timespec until{deadline_ns / 1'000'000'000, deadline_ns % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
  }
  return Status::Ok();
}

int ReplayDriver::RowNow() const {
  const double t = recording_.t[0] + 1e-9 * static_cast<double>(NowNanos() - start_ns_);
  const double* const begin = recording_.t.data();
  const auto later = std::upper_bound(begin, begin + recording_.rows(), t + 1e-9);
  return std::max(0, static_cast<int>(later - begin) - 1);
}

Status ReplayDriver::ReadState(RobotState* state) {
  if (!health_.connected) return UnavailableError("no recording is played");
  if (mode_ == Mode::kTorque) {
    const int row = RowNow();
    sequence_ += static_cast<uint64_t>(row - row_);
    health_.states_received += static_cast<uint64_t>(row - row_);
    row_ = row;
    state->stamp_ns = start_ns_ + std::llround(1e9 * (recording_.t[row_] - recording_.t[0]));
  } else {
    ++sequence_;
    ++health_.states_received;
    state->stamp_ns = NowNanos();
  }
  state->sequence = sequence_;
  state->mode = mode_;
  state->moving = false;
  for (int i = 0; i < n(); ++i) {
    state->q[i] = recording_.q(i, row_);
    const bool moves = mode_ == Mode::kTorque && recording_.has_velocity();
    state->v[i] = moves ? recording_.v(i, row_) : 0.0;
    state->effort[i] = recording_.has_effort_measured()  ? recording_.effort_measured(i, row_)
                       : recording_.has_effort_command() ? recording_.effort_command(i, row_)
                                                         : 0.0;
  }
  return Status::Ok();
}

Status ReplayDriver::EnterTorqueMode(const double*) {
  if (!health_.connected) return UnavailableError("no recording is played");
  mode_ = Mode::kTorque;
  row_ = 0;
  ++sequence_;
  start_ns_ = NowNanos();
  return Status::Ok();
}

Status ReplayDriver::SendTorque(const double*) {
  if (mode_ != Mode::kTorque) return FailedPreconditionError("the recording is not played");
  ++health_.commands_sent;
  return Status::Ok();
}

Status ReplayDriver::Hold() {
  if (!health_.connected) return UnavailableError("no recording is played");
  if (mode_ == Mode::kTorque) row_ = RowNow();
  mode_ = Mode::kPosition;
  return Status::Ok();
}

// It is where the recording begins, or nowhere near.
Status ReplayDriver::StartMove(const double* q) { return MoveToPose(q, kStartTolerance, 0.0); }

Status ReplayDriver::MoveToPose(const double* q, double tolerance, double) {
  RG_RETURN_IF_ERROR(Hold());
  for (int i = 0; i < n(); ++i) {
    const double away = std::abs(recording_.q(i, 0) - q[i]);
    if (away <= tolerance) continue;
    return FailedPreconditionError("the recording " + recording_.name + " begins with " + info_.joints[i] +
                                   " at " + std::to_string(recording_.q(i, 0)) + ", the pose has it at " +
                                   std::to_string(q[i]));
  }
  row_ = 0;
  return Status::Ok();
}

}  // namespace rg::robot_agent
