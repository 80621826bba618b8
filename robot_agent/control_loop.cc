#include "robot_agent/control_loop.h"

#include <cmath>
#include <optional>

#include "robot_agent/realtime.h"

namespace rg::robot_agent {
namespace {

constexpr int64_t kLate = 2'000'000;  // ns, of JitterReport::late_2ms

class Loop {
 public:
  Loop(Driver& driver, Controller& controller, ArmModel& arm, const SafetyLimits& limits,
       const ControlLoopOptions& options, Recorder& recorder, const CancelToken& stop, const Clock& clock)
      : driver_(driver),
        controller_(controller),
        arm_(arm),
        limits_(limits),
        options_(options),
        recorder_(recorder),
        stop_(stop),
        clock_(clock),
        n_(static_cast<int>(driver.info().joints.size())),
        period_ns_(std::llround(1e9 / options.rate_hz)),
        last_tick_(std::llround(options.duration_s * options.rate_hz)),
        monitor_(limits, n_, 1.0 / options.rate_hz) {
    result_.jitter.period_s = 1.0 / options.rate_hz;
    result_.jitter.lock_step = driver.info().lock_step;
  }

  ControlLoopResult Run() {
    // A robot that waits for the loop needs no priority.
    std::optional<RealtimeScope> on_time;
    if (!driver_.info().lock_step) result_.jitter.realtime = on_time.emplace(kLoopPriority).grant();
    if (!Enter()) return NotStarted();
    while (Cycle()) {
    }
    missed_ += MissedBy(driver_.NowNanos() - (start_ns_ + tick_ * period_ns_));
    result_.stop = StopArm(driver_, options_.stop);
    result_.trip = monitor_.trip();
    result_.saturated_samples = monitor_.saturated_samples();
    result_.duration_s = 1e-9 * static_cast<double>(result_.trip.at_ns - start_ns_);
    result_.jitter.ticks = monitor_.ticks();
    result_.jitter.missed_deadlines = missed_;
    return result_;
  }

 private:
  // Torque mode with gravity carried, so that nothing moves before the first command. Neither a state outside
  // the boxes nor a torque beyond the limits gets that far.
  bool Enter() {
    Observe(true);
    if (monitor_.CheckFirst(seen_, zero_added_.data()) != Action::kCommand) return false;
    JointArray handed = zero_added_;
    Hand(zero_added_, zero_added_, &handed);
    result_.entered = true;
    driver_.HeedStop(&stop_);
    const Status entered = driver_.EnterTorqueMode(handed.data());
    driver_.HeedStop(nullptr);
    start_ns_ = driver_.NowNanos();
    result_.refusal = entered;
    return entered.ok();
  }

  ControlLoopResult NotStarted() {
    start_ns_ = driver_.NowNanos();
    result_.stop = StopArm(driver_, options_.stop);
    result_.trip = monitor_.trip();
    Note(Action::kHold);
    const EndReason why = stop_.cancelled() ? EndReason::kOperatorStop : EndReason::kNotStarted;
    if (result_.trip.reason == EndReason::kNone) result_.trip = {why, -1, 0, 0, start_ns_};
    return result_;
  }

  // One tick; false when the arm has to be held.
  bool Cycle() {
    const bool reached = driver_.SleepUntil(start_ns_ + tick_ * period_ns_).ok();
    const int64_t woke = clock_.SteadyNanos();
    seen_.missed = CountMissed();
    Observe(reached);
    Action action = monitor_.OnTick(seen_);
    if (action == Action::kCommand) action = Compute();
    const bool going = Act(action);
    result_.jitter.cycle.Add(clock_.SteadyNanos() - woke);
    Note(action);
    ++tick_;
    return going;
  }

  int CountMissed() {
    const int64_t late = driver_.NowNanos() - (start_ns_ + tick_ * period_ns_);
    result_.jitter.lateness.Add(late);
    result_.jitter.late_2ms += late > kLate;
    const int missed = MissedBy(late);
    if (missed > 0) tick_ += late / period_ns_;
    missed_ += missed;
    return missed;
  }

  // Deadlines that a tick passes which wakes so late [ns]; also after a trip, where the monitor no longer counts.
  int MissedBy(int64_t late) const {
    return late * 2 <= period_ns_ ? 0 : static_cast<int>(1 + late / period_ns_);
  }

  void Observe(bool reached) {
    seen_.now_ns = driver_.NowNanos();
    const uint64_t known = seen_.state.sequence;
    const bool read = driver_.ReadState(&seen_.state).ok();
    seen_.connected = reached && read;
    seen_.has_state |= read;
    new_state_ = read && (tick_ == 0 || seen_.state.sequence != known);
    seen_.operator_stop = stop_.cancelled();
    seen_.recorder_ok = recorder_.ok();
    seen_.time_up = result_.entered && tick_ >= last_tick_;
    if (!seen_.has_state) return;
    if (result_.entered) result_.jitter.state_age.Add(seen_.now_ns - seen_.state.stamp_ns);
    arm_.Tip(seen_.state.q.data(), tip_);
    seen_.tip = tip_;
    seen_.clearance = arm_.Clearance(seen_.state.q.data(), &seen_.nearest_pair);
    arm_.GravityTorque(seen_.state.q.data(), zero_added_.data());
    seen_.gravity = zero_added_.data();
  }

  void ChooseVelocity() {
    velocity_ = seen_.state.v;
    if (options_.velocity_source == VelocitySource::kDifferenced && !monitor_.Velocity(velocity_.data()))
      velocity_.fill(0.0);
  }

  Action Compute() {
    const double t = 1e-9 * static_cast<double>(seen_.now_ns - start_ns_);
    const uint64_t saturated = monitor_.saturated_samples();
    ChooseVelocity();
    result_.began = true;
    controller_.Command(t, seen_.state.q.data(), velocity_.data(), command_.data());
    const Action action = monitor_.LimitCommand(command_.data(), zero_added_.data(), seen_.now_ns);
    saturated_ = monitor_.saturated_samples() != saturated;
    return action;
  }

  // Sends what the action asks for; false: hold.
  bool Act(Action action) {
    if (action == Action::kHold) return false;
    if (action == Action::kZeroAdded) command_ = zero_added_;
    Hand(command_, zero_added_, &sent_);
    // A failed send shows as a lost driver at the next tick's SleepUntil or ReadState.
    (void)driver_.SendTorque(sent_.data()).ok();
    result_.commands += action == Action::kCommand;
    sent_ns_ = driver_.NowNanos();
    return true;
  }

  void Hand(const JointArray& command, const JointArray& gravity, JointArray* handed) const {
    *handed = command;
    if (!driver_.info().adds_gravity_compensation) return;
    for (int i = 0; i < n_; ++i) (*handed)[i] -= gravity[i];
  }

  void Note(Action action) {
    if (!seen_.has_state) return;
    if (action == Action::kHold) command_ = sent_ = zero_added_, sent_ns_ = seen_.now_ns;
    sample_.tick = tick_;
    sample_.time_ns = sent_ns_ - start_ns_;
    sample_.stamp_ns = seen_.state.stamp_ns - start_ns_;
    sample_.sequence = seen_.state.sequence;
    sample_.flags = (new_state_ ? Sample::kNewState : 0) |
                    (action != Action::kCommand ? Sample::kStopping : 0) |
                    (action == Action::kCommand && saturated_ ? Sample::kSaturated : 0);
    sample_.q = seen_.state.q;
    sample_.v = seen_.state.v;
    sample_.effort = seen_.state.effort;
    sample_.command = command_;
    sample_.sent = sent_;
    recorder_.Record(sample_);
    if (options_.observer != nullptr) options_.observer->OnSample(sample_, result_.jitter);
  }

  Driver& driver_;
  Controller& controller_;
  ArmModel& arm_;
  const SafetyLimits& limits_;
  const ControlLoopOptions& options_;
  Recorder& recorder_;
  const CancelToken& stop_;
  const Clock& clock_;
  const int n_;
  const int64_t period_ns_;
  const int64_t last_tick_;
  SafetyMonitor monitor_;
  ControlLoopResult result_;

  int64_t start_ns_ = 0, tick_ = 0, sent_ns_ = 0;
  int missed_ = 0;
  Observation seen_;
  bool new_state_ = false, saturated_ = false;
  double tip_[3] = {};
  JointArray velocity_{}, command_{}, sent_{}, zero_added_{};
  Sample sample_;
};

}  // namespace

ControlLoopResult RunControlLoop(Driver& driver, Controller& controller, ArmModel& arm,
                                 const SafetyLimits& limits, const ControlLoopOptions& options,
                                 Recorder& recorder, const CancelToken& operator_stop, const Clock& clock) {
  return Loop(driver, controller, arm, limits, options, recorder, operator_stop, clock).Run();
}

}  // namespace rg::robot_agent
