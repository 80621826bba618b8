#include "tests/fault/robot_agent/stand_in_scenarios.h"

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/rng.h"
#include "robot_agent/drivers/kinova/kinova_driver.h"
#include "robot_agent/safety/latch.h"
#include "robot_agent/spool_delivery.h"
#include "services/rollouts/recording_bundle.h"
#include "tests/support/robot_agent/virtual_time.h"
#include "tests/unit/robot_agent/rig.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;
using stand_in::StandInArm;

constexpr int kRollouts = 2;       // one after the other, as an agent runs them
constexpr double kSeconds = 1.6;   // of each
constexpr int kKilledStatus = 99;  // instead of a signal, so that a crash is not taken for it
constexpr int kTornTicks = 3;      // what a kill may cost

// What happened, from outside the agent: survives the process.
class Account {
 public:
  explicit Account(const std::string& folder)
      : file_(open((folder + "/account.txt").c_str(), O_CREAT | O_WRONLY | O_APPEND | O_CLOEXEC, 0600)) {}
  ~Account() { close(file_); }
  void Note(const std::string& line) const {
    const std::string whole = line + "\n";
    if (write(file_, whole.data(), whole.size()) != static_cast<ssize_t>(whole.size())) _exit(3);
  }

 private:
  const int file_;
};

class Session {
 public:
  Session(const Scenario& scenario, const std::string& folder)
      : scenario_(scenario),
        folder_(folder),
        account_(folder),
        time_(std::make_shared<VirtualTime>()),
        arm_(scenario.config, scenario.link, scenario.seed, time_),
        rig_(true) {
    rig_.config.driver = "kinova";
    rig_.config.pose_tolerance = 0.06;
    rig_.config.velocity_source = VelocitySource::kDifferenced;
    rig_.config.min_free_mb = 1.0;
    rig_.spool.reset();
    options_ = kinova::ParseKinovaOptions("{}", "mico2").value();
    options_.session_path = folder + "/spool/" + kinova::kSessionFile;
  }

  // The agent's life, until it is killed.
  void Live() {
    std::thread killer;
    if (scenario_.fault == Trouble::kKilled) killer = time_->Start([this] { KillLater(); });
    for (int k = 0; k < kRollouts && !latched_; ++k) Rollout("r" + std::to_string(k + 1));
    ended_ = true;
    if (killer.joinable()) time_->Join(killer);
    End();
  }

  // The agent that comes after it: the store asks for the same rollouts again.
  void Repeat() {
    const bool locked = Latch(folder_ + "/spool").Read().has_value();
    for (int k = 0; k < kRollouts; ++k) Rollout("r" + std::to_string(k + 1));
    if (locked && arm_.torque_modes > 0) account_.Note("moved though latched");
    (void)Latch(folder_ + "/spool").Clear().ok();  // a person has looked
    Rollout("next");
    End();
  }

 private:
  void KillLater() {
    const int64_t when = time_->NowNanos() + std::llround(1e9 * scenario_.at_s);
    while (!ended_ && time_->NowNanos() < when) time_->SleepUntil(time_->NowNanos() + 5'000'000);
    if (ended_) return;
    usleep(100'000);  // the disk's time is the machine's: what a real rollout has on it by now
    _exit(kKilledStatus);
  }

  void Rollout(const std::string& id) {
    CancelToken stop;
    rig_.spec.id = id;
    rig_.spec.duration_s = kSeconds;
    rig_.spec.goal_seed = scenario_.seed + id.size() + static_cast<uint64_t>(id.back());
    const RolloutPlan plan = rig_.Plan();
    int commands = 0;
    FunctionController spring = rig_.ToGoal(plan);
    FunctionController controller([&](double t, const double* q, const double* v, double* tau) {
      spring.Command(t, q, v, tau);
      Disturb(t, id, tau, &stop);
      account_.Note((commands++ == 0 ? "begins " : "command ") + id);
    });
    rig_.spool = Spool::Open(folder_ + "/spool").value();
    SalvageRecordings(*rig_.spool);
    kinova::KinovaDriver driver(options_, stand_in::LinkTo(arm_), time_);
    const auto result = rig_.Run(driver, plan, controller, {}, &stop);
    rig_.spool.reset();
    latched_ = Latch(folder_ + "/spool").Read().has_value();
    Tell(id, result);
  }

  void Disturb(double t, const std::string& id, double* tau, CancelToken* stop) const {
    if (id != "r1" || t < scenario_.at_s) return;
    if (scenario_.fault == Trouble::kControllerNan) tau[2] = std::nan("");
    if (scenario_.fault == Trouble::kControllerWild) tau[1] = 5 * rig_.config.limits.torque[1];
    if (scenario_.fault == Trouble::kOperatorStop) stop->Cancel();
  }

  void Tell(const std::string& id, const Result<RolloutResult>& result) const {
    if (!result.ok())
      return account_.Note("refused " + id + " " + std::string(StatusCodeName(result.status().code())) + " " +
                           result.status().message());
    account_.Note((result->was_there ? "there " : "ended ") + id + " " +
                  std::string(EndReasonName(result->reason)) + " " + result->detail);
  }

  void End() {
    // Its driver is gone: what the arm was left in.
    time_->SleepUntil(time_->NowNanos() + 1'000'000'000);
    arm_.base->AdvanceTo(time_->NowNanos() - arm_.epoch_ns);
    if (arm_.base->in_torque_mode() && !Latch(folder_ + "/spool").Read()) account_.Note("floating");
    if (!arm_.base->failure().empty()) account_.Note("physics " + arm_.base->failure());
    double most = 0.0;
    for (const double torque : rig_.config.limits.torque) most = std::max(most, torque);
    if (arm_.most_torque_nm > most + 15.0) account_.Note("torque " + std::to_string(arm_.most_torque_nm));
    if (latched_) account_.Note("latched");
  }

  const Scenario& scenario_;
  const std::string folder_;
  const Account account_;
  const std::shared_ptr<VirtualTime> time_;
  StandInArm arm_;
  Rig rig_;
  kinova::KinovaOptions options_;
  bool latched_ = false;
  std::atomic<bool> ended_{false};
};

// The exit status of a child that does `work`.
int InAProcess(const std::string& log, const std::function<void()>& work) {
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child == 0) {
    if (std::freopen(log.c_str(), "a", stderr) == nullptr || std::freopen(log.c_str(), "a", stdout) == nullptr) _exit(3);
    work();
    std::fflush(nullptr);
    _exit(0);
  }
  int status = 0;
  waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

struct Seen {
  int begins = 0, commands = 0;
  bool ended = false, there = false, refused = false;
  std::string words;
};

// The recording of a rollout that began, ready for its delivery.
void CheckRecording(const std::string& folder, const std::string& id, const Seen& seen, bool killed, Verdict* v) {
  const auto bytes = ReadFile(folder + "/spool/ready/" + id + ".tar");
  const auto bundle = bytes.ok() ? rollouts::UnpackBundle(*bytes) : Result<rollouts::Bundle>(bytes.status());
  const json rollout = bundle.ok() && bundle->contains("rollout.json")
                           ? json::parse(bundle->at("rollout.json"), nullptr, false)
                           : json();
  if (!rollout.is_object()) {
    ++v->lost;
    v->wrong.push_back("the recording of " + id + " is lost: " + bytes.status().message());
    return;
  }
  ++v->recordings;
  const std::string reason = rollout.value("end_reason", "");
  if (id == "r1") v->reason = reason;
  v->completed += reason == "completed";
  v->salvaged += reason == "interrupted";
  if (reason.empty()) v->wrong.push_back(id + " has no reason for its end");
  const int samples = rollout.value("samples", 0);
  if (samples < seen.commands - (killed ? kTornTicks : 0)) {
    ++v->lost;
    v->wrong.push_back(id + ": " + std::to_string(seen.commands) + " commands, " + std::to_string(samples) + " samples");
  }
}

std::map<std::string, Seen> ReadAccount(const std::string& folder, Verdict* v) {
  std::map<std::string, Seen> rollouts;
  std::istringstream lines(ReadFile(folder + "/account.txt").value());
  for (std::string line; std::getline(lines, line);) {
    std::istringstream in(line);
    std::string event, id, rest;
    in >> event >> id;
    std::getline(in, rest);
    Seen& seen = rollouts[id];
    if (event == "begins") ++seen.begins;
    if (event == "begins" || event == "command") ++seen.commands;
    if (event == "ended") seen.ended = true, seen.words = rest;
    if (event == "there") seen.there = true;
    if (event == "refused") seen.refused = true, seen.words = rest, ++v->refused;
    if (event == "latched") ++v->latched;
    if (event == "moved") v->wrong.push_back("the arm moved though it was latched");
    if (event == "floating") v->wrong.push_back("the arm was left in torque mode");
    if (event == "physics" || event == "torque") v->wrong.push_back(line);
  }
  return rollouts;
}

// What each fault has to come to, of the first rollout.
void CheckOutcome(const Scenario& scenario, const Seen& first, Verdict* v) {
  const auto expect = [&](bool good, const std::string& what) {
    if (!good) v->wrong.push_back(what + "; it was: " + v->reason + first.words);
  };
  const auto is = [&](std::initializer_list<const char*> reasons) {
    return std::any_of(reasons.begin(), reasons.end(), [&](const char* r) { return v->reason == r; });
  };
  // The spring that stands for a policy is too fast for some goals: then the fence was first.
  if (first.begins > 0 && is({"velocity_limit"})) return;
  switch (scenario.fault) {
    case Trouble::kNone:
      expect(is({"completed"}), "a rollout without a fault completes");
      break;
    case Trouble::kWrongSign:
    case Trouble::kDeadJoint:
      expect(first.begins == 0, "an arm whose torques are wrong is not begun with");
      break;
    case Trouble::kControllerNan:
      expect(is({"controller_nan"}), "NaN stops");
      break;
    case Trouble::kControllerWild:
      expect(is({"torque_limit"}), "five times the torque stops");
      break;
    case Trouble::kOperatorStop:
      expect(is({"operator_stop"}), "the operator's stop stops");
      break;
    case Trouble::kFrozen:
      expect(first.begins == 0 || is({"frozen_state", "mode_lost", "completed"}), "frozen positions stop");
      break;
    case Trouble::kFallBack:
      expect(first.begins == 0 || is({"mode_lost", "frozen_state", "completed"}), "an arm that left its mode stops");
      break;
    case Trouble::kOutage:
    case Trouble::kOutages:
      expect(first.begins == 0 || is({"stale_state", "driver_lost", "mode_lost", "completed"}), "an arm that is away stops");
      break;
    default:
      break;
  }
}

}  // namespace

const char* TroubleName(Trouble fault) {
  static constexpr const char* kNames[] = {
      "none",       "outage",           "outages",       "fall_back",       "wrong_sign",
      "dead_joint", "frozen",           "hanging_services", "deaf_to_stops", "controller_nan",
      "controller_wild", "operator_stop", "killed"};
  static_assert(std::size(kNames) == static_cast<size_t>(Trouble::kCount));
  return kNames[static_cast<size_t>(fault)];
}

Scenario DrawScenario(uint64_t seed) {
  Rng random(seed);
  Scenario scenario;
  scenario.seed = seed;
  scenario.fault = static_cast<Trouble>(seed % static_cast<uint64_t>(Trouble::kCount));
  auto& config = scenario.config;
  config = stand_in::LoadStandInConfig(SourceDir() + "/deploy/robots/mico2_stand_in.json").value();
  const auto whole = [&](int least, int most) {
    return least + static_cast<int>(random.Uniform(0.0, 1.0) * (most - least + 1));
  };
  for (auto& offset : config.sensor_offset_nm) offset = random.Uniform(-3.5, 3.5);
  config.turns[0] = whole(-1, 1), config.turns[3] = whole(-2, 2), config.turns[5] = whole(-1, 1);
  config.refuse_torque_mode = whole(0, 2);
  config.call_s = random.Uniform(0.002, 0.0032);
  config.jitter_s = random.Uniform(0.0, 0.01);
  config.lost_at_start_s = random.Uniform(0.0, 0.4);
  scenario.link.lost_states = random.Uniform(0.0, 0.02);
  scenario.at_s = random.Uniform(0.1, 0.8 * kSeconds);
  const int joint = whole(0, 5);
  switch (scenario.fault) {
    case Trouble::kOutage:
      config.outage_after_s = random.Uniform(0.1, 9.0);
      break;
    case Trouble::kOutages:
      config.outages_per_s = 0.03;
      break;
    case Trouble::kFallBack:
      config.leave_torque_mode_s = random.Uniform(0.3, 9.0);
      break;
    case Trouble::kWrongSign:
      config.torque_sign[joint] = -1;
      break;
    case Trouble::kDeadJoint:
      config.torque_sign[joint] = 0;
      break;
    case Trouble::kFrozen:
      scenario.link.freeze_after_s = random.Uniform(0.3, 9.0);
      break;
    case Trouble::kHangingServices:
      scenario.link.hang_after_s = random.Uniform(0.3, 9.0);
      break;
    case Trouble::kDeafToStops:
      scenario.link.ignored_position_modes = whole(1, 4);
      break;
    case Trouble::kKilled:
      scenario.at_s = random.Uniform(0.5, 28.0);
      break;
    default:
      break;
  }
  return scenario;
}

Verdict RunScenario(const Scenario& scenario, const std::string& folder) {
  Verdict v;
  std::filesystem::create_directories(folder + "/spool");
  const std::string log = folder + "/log.txt";
  const bool to_be_killed = scenario.fault == Trouble::kKilled;
  const int lived = InAProcess(log, [&] { Session(scenario, folder).Live(); });
  const bool killed = to_be_killed && lived == kKilledStatus;
  if (lived != 0 && !killed) v.wrong.push_back("the agent ended with status " + std::to_string(lived));
  Scenario calm = scenario;
  calm.fault = Trouble::kNone;
  calm.link = {};
  calm.config.outage_after_s = calm.config.outages_per_s = calm.config.leave_torque_mode_s = 0.0;
  calm.config.torque_sign.assign(calm.config.torque_sign.size(), 1.0);
  const auto asked_before = ReadAccount(folder, &v);
  v = {.wrong = v.wrong};
  const int repeated = InAProcess(log, [&] { Session(calm, folder).Repeat(); });
  if (repeated != 0) v.wrong.push_back("the agent after it ended with status " + std::to_string(repeated));
  const auto rollouts = ReadAccount(folder, &v);
  for (const auto& [id, seen] : rollouts) {
    if (id != "r1" && id != "r2" && id != "next") continue;
    v.begun += seen.begins > 0;
    if (seen.begins > 1) {
      ++v.moved_twice;
      v.wrong.push_back("the arm moved twice for " + id);
    }
    if (seen.begins > 0) CheckRecording(folder, id, seen, killed, &v);
  }
  const auto next = rollouts.find("next");
  if (next == rollouts.end() || next->second.begins == 0)
    v.wrong.push_back("the next rollout did not begin: " + (next == rollouts.end() ? "" : next->second.words));
  if (const auto first = asked_before.find("r1"); first != asked_before.end())
    CheckOutcome(scenario, first->second, &v);
  if (v.wrong.empty()) std::filesystem::remove_all(folder);
  return v;
}

}  // namespace rg::robot_agent
