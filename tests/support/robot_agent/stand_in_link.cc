#include "tests/support/robot_agent/stand_in_link.h"

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <mutex>
#include <thread>
#include "robot_agent/drivers/kinova/units.h"

namespace rg::robot_agent::stand_in {
namespace {

using kinova::ArmService;
using kinova::Degrees;
using kinova::JointReport;
using kinova::Nanos;

constexpr double kReached = 2.0, kStallTime = 1.5, kStallWay = 1.0;  // as main.cc's
constexpr int kCalls = 9;
constexpr double kCreep = 6.0;  // degrees/s

class StandInLink final : public kinova::ArmLink {
 public:
  explicit StandInLink(StandInArm& arm) : arm_(arm), time_(*arm.time) {}
  ~StandInLink() override {
    ended_ = true;
    if (node_thread_.joinable()) time_.Join(node_thread_);
  }

  Status Open(Listener listener) override {
    listener_ = std::move(listener);
    if (!node_thread_.joinable()) node_thread_ = time_.Start([this] { Serve(); });
    return Status::Ok();
  }

  bool TorquesAreHeard() const override { return !away_ && !arm_.faults.away; }

  void PublishTorque(const JointArray& tau) override {
    if (away_) return;
    pending_ = tau;
    has_pending_ = true;
    // Where the node is busy it takes the newest one afterwards.
    if (const std::unique_lock idle(node_, std::try_to_lock); idle.owns_lock()) TakeTorque();
  }

  Status Call(ArmService service, double timeout_s) override {
    const int64_t give_up = time_.NowNanos() + Nanos(timeout_s);
    const bool hangs =
        arm_.faults.hang_after_s > 0 && arm_.base->seconds_in_torque_mode() > arm_.faults.hang_after_s;
    if (hangs) time_.SleepUntil(give_up);
    if (away_ || arm_.faults.away) return NotFoundError("service is not offered");
    if (hangs) return DeadlineExceededError("service did not answer");
    const auto node = time_.Lock(node_);
    Spend(1);
    if (time_.NowNanos() > give_up) return DeadlineExceededError("service did not answer");
    if (service == ArmService::kTorqueMode && arm_.faults.failing_torque_modes > 0) {
      --arm_.faults.failing_torque_modes;
      return FailedPreconditionError("service failed");
    }
    Do(service);
    TakeTorque();
    return Status::Ok();
  }

  Status MoveTo(const std::vector<Degrees>& pose, double timeout_s, const std::atomic<bool>& stop) override {
    const int64_t give_up = time_.NowNanos() + Nanos(timeout_s);
    while (away_ && !stop && time_.NowNanos() < give_up) time_.SleepUntil(time_.NowNanos() + 20'000'000);
    if (stop) return AbortedError("stopped before the way to the pose began");
    if (away_) return NotFoundError("joints_action is not offered");
    arm_.base->MoveTo(pose);
    std::vector<Degrees> before = Now().Angles();
    int64_t moved_at = time_.NowNanos();
    while (time_.NowNanos() < give_up) {
      time_.SleepUntil(time_.NowNanos() + 100'000'000);
      if (away_) return AbortedError("LOST");
      const std::vector<Degrees> now = Now().Angles();
      double far = 0.0, way = 0.0;
      for (size_t i = 0; i < now.size(); ++i) {
        const double off = now[i].value - pose[i].value;
        far = std::max(far, std::abs(off - 360.0 * std::round(off / 360.0)));
        way = std::max(way, std::abs(now[i].value - before[i].value));
      }
      if (way > kStallWay) before = now, moved_at = time_.NowNanos();
      if (stop || time_.NowNanos() - moved_at > Nanos(kStallTime)) {
        arm_.base->Stop();
        return AbortedError(stop ? "PREEMPTED" : "ABORTED");
      }
      if (far <= kReached) return Status::Ok();
    }
    arm_.base->Stop();
    return DeadlineExceededError("the pose was not reached in time");
  }

  void CancelMove() override {}  // MoveTo looks
  bool StopAsked() const override { return arm_.stop_published; }
  std::string RunOfDriver() const override { return "run " + std::to_string(arm_.run); }
  std::optional<double> StatusInterval() const override { return arm_.interval_s; }

 private:
  KinovaBase& Now() {
    arm_.base->AdvanceTo(time_.NowNanos() - arm_.epoch_ns);
    return *arm_.base;
  }

  void Spend(int calls) { time_.SleepUntil(time_.NowNanos() + Nanos(calls * arm_.config.call_s)); }

  void Do(ArmService service) {
    KinovaBase& base = Now();
    const bool was = base.in_torque_mode();
    if (service == ArmService::kZeroTorques) base.ZeroTorques(), ++arm_.zeroed;
    if (service == ArmService::kTorqueMode) base.SetTorqueMode(true);
    if (service == ArmService::kPositionMode && was && arm_.faults.ignored_position_modes > 0) {
      --arm_.faults.ignored_position_modes;
    } else if (service == ArmService::kPositionMode) {
      base.SetTorqueMode(false);
      if (was) creeps_from_ns_ = time_.NowNanos();
    }
    arm_.torque_modes += !was && base.in_torque_mode();
  }

  // The node's thread.
  void Serve() {
    int64_t next = time_.NowNanos();
    while (!ended_) {
      time_.SleepUntil(next + Nanos(arm_.random.Uniform(0.0, arm_.config.jitter_s)));
      if (ended_) return;
      Tick();
      if (Now().in_torque_mode()) arm_.torque_mode_s += arm_.interval_s;
      if (arm_.fall_back_wanted.exchange(false)) Now().Stop();
      if (OutageIsDue()) BeAway();
      next = std::max(next + Nanos(arm_.interval_s), time_.NowNanos());
    }
  }

  void Tick() {
    const auto node = time_.Lock(node_);
    Spend(1);
    JointReport report;
    const std::vector<Degrees> angles = Positions();
    report.stamp_ns = time_.NowNanos() + 7'000'000'000;  // a clock of its own
    Spend(2);
    const std::vector<Degrees> velocities = Now().Velocities();
    Spend(1);
    const std::vector<double> torques = Now().Torques();
    for (size_t i = 0; i < angles.size(); ++i) {
      report.q[i] = kinova::ToRadians(angles[i]).value;
      report.v[i] = kinova::ToRadians(velocities[i]).value;
      report.effort[i] = torques[i];
    }
    report.number = arm_.number++;
    report.received_ns = time_.NowNanos();
    if (arm_.random.Uniform() >= arm_.faults.lost_states && !arm_.faults.away) listener_(report);
    Spend(kCalls - 4);
    TakeTorque();
  }

  std::vector<Degrees> Positions() {
    const bool frozen = arm_.faults.freeze_after_s > 0 &&
                        arm_.base->seconds_in_torque_mode() > arm_.faults.freeze_after_s;
    if (!frozen || last_.empty()) last_ = Now().Angles();
    std::vector<Degrees> seen = last_;
    const double crept_s = creeps_from_ns_ < 0 ? 0.0 : 1e-9 * static_cast<double>(time_.NowNanos() - creeps_from_ns_);
    seen[5].value += kCreep * std::min(crept_s, arm_.faults.creeps_s);
    return seen;
  }

  void TakeTorque() {
    if (!std::exchange(has_pending_, false)) return;
    const JointArray tau = pending_;
    if (first_torque_ns_ < 0) first_torque_ns_ = time_.NowNanos();
    if (time_.NowNanos() - first_torque_ns_ < Nanos(arm_.config.lost_at_start_s)) return;
    const std::vector<double> sent(tau.begin(), tau.begin() + arm_.base->joints());
    ++arm_.torques;
    for (const double torque : sent) arm_.most_torque_nm = std::max(arm_.most_torque_nm, std::abs(torque));
    Now().SendTorque(sent);
  }

  bool OutageIsDue() {
    const double in_torque = arm_.base->seconds_in_torque_mode();
    const bool timed =
        arm_.config.outage_after_s > 0 && !arm_.outage_done && in_torque > arm_.config.outage_after_s;
    arm_.outage_done |= timed;
    return timed || arm_.outage_wanted.exchange(false) ||
           arm_.random.Uniform() < arm_.config.outages_per_s * arm_.interval_s;
  }

  void BeAway() {
    ++arm_.outages;
    away_ = true;
    time_.SleepUntil(time_.NowNanos() + Nanos(arm_.config.outage_s));
    away_ = false;
    first_torque_ns_ = -1;
    arm_.number = 0;
  }

  StandInArm& arm_;
  DriverTime& time_;
  Listener listener_;
  std::thread node_thread_;
  std::mutex node_;  // busy with a call; all else: one thread of this time runs at a time
  std::atomic<bool> ended_{false}, away_{false};
  JointArray pending_{};
  bool has_pending_ = false;
  int64_t first_torque_ns_ = -1, creeps_from_ns_ = -1;
  std::vector<Degrees> last_;
};

}  // namespace

StandInArm::StandInArm(const StandInConfig& the_config, const LinkFaults& the_faults, uint64_t seed,
                       std::shared_ptr<DriverTime> the_time)
    : config(the_config),
      faults(the_faults),
      time(std::move(the_time)),
      epoch_ns(time->NowNanos()),
      random(seed),
      base(KinovaBase::Create(config, seed).value()) {}

std::unique_ptr<kinova::ArmLink> LinkTo(StandInArm& arm) { return std::make_unique<StandInLink>(arm); }

}  // namespace rg::robot_agent::stand_in
