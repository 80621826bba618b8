// realitygrad-kinova-stand-in: the node m1n6s200_driver of kinova-ros, with an arm behind it that is as bad
// as a real one. One thread serves timer, torques and services, as there; actions have one of their own.
#include <actionlib/server/simple_action_server.h>
#include <kinova_msgs/ArmJointAnglesAction.h>
#include <kinova_msgs/ClearTrajectories.h>
#include <kinova_msgs/HomeArm.h>
#include <kinova_msgs/JointAngles.h>
#include <kinova_msgs/JointTorque.h>
#include <kinova_msgs/SetEndEffectorOffset.h>
#include <kinova_msgs/SetTorqueControlMode.h>
#include <kinova_msgs/SetTorqueControlParameters.h>
#include <kinova_msgs/Start.h>
#include <kinova_msgs/Stop.h>
#include <kinova_msgs/ZeroTorques.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/JointState.h>
#include <std_msgs/Empty.h>
#include <signal.h>
#include <time.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <cmath>
#include <iostream>
#include <mutex>

#include "common/base/clock.h"
#include "common/base/rng.h"
#include "robot_agent/drivers/kinova/joint_report.h"
#include "robot_agent/stand_in/kinova_base.h"

namespace rg::robot_agent::stand_in {
namespace {

using kinova::Degrees;
using Moves = actionlib::SimpleActionServer<kinova_msgs::ArmJointAnglesAction>;

constexpr double kReached = 2.0;    // degrees, modulo a turn
constexpr double kStallTime = 1.5;  // s with less than
constexpr double kStallWay = 1.0;   // degrees of motion
constexpr int kFingerJoints = 4;

std::atomic<bool> stop{false};
std::atomic<bool> outage_wanted{false}, fall_back_wanted{false}, stop_wanted{false};  // SIGUSR1, SIGUSR2, SIGHUP

void SleepFor(double seconds) {
  const auto nanos = static_cast<int64_t>(1e9 * seconds);
  const timespec time{nanos / 1'000'000'000, nanos % 1'000'000'000};
  nanosleep(&time, nullptr);
}

template <class Message>
Message Fields(const std::vector<double>& values) {
  Message message;
  float* const fields[] = {&message.joint1, &message.joint2, &message.joint3, &message.joint4,
                           &message.joint5, &message.joint6, &message.joint7};
  for (size_t i = 0; i < values.size(); ++i) *fields[i] = static_cast<float>(values[i]);
  return message;
}

template <class Message>
std::vector<double> Values(const Message& message, int n) {
  const std::vector<double> all = {message.joint1, message.joint2, message.joint3, message.joint4,
                                   message.joint5, message.joint6, message.joint7};
  return {all.begin(), all.begin() + n};
}

std::vector<double> Numbers(const std::vector<Degrees>& angles) {
  std::vector<double> numbers;
  for (const Degrees angle : angles) numbers.push_back(angle.value);
  return numbers;
}

double ModuloTurn(double degrees) { return degrees - 360.0 * std::round(degrees / 360.0); }

// The base, called by one thread at a time; every call of its interface takes its time.
class Interface {
 public:
  Interface(KinovaBase& base, double call_s) : base_(base), call_s_(call_s), epoch_(Now()) {}

  template <class Work>
  auto Call(Work work) {
    const std::lock_guard<std::recursive_mutex> lock(mutex_);
    SleepFor(call_s_);
    base_.AdvanceTo(Now() - epoch_);
    return work(base_);
  }
  // A command on its way: does not wait for an answer.
  template <class Work>
  auto Push(Work work) {
    const std::lock_guard<std::recursive_mutex> lock(mutex_);
    base_.AdvanceTo(Now() - epoch_);
    return work(base_);
  }

 private:
  static int64_t Now() { return RealClock().SteadyNanos(); }
  KinovaBase& base_;
  const double call_s_;
  const int64_t epoch_;
  std::recursive_mutex mutex_;
};

// Everything that the node offers; an error of the interface takes all of it away.
class Offers {
 public:
  // As a person would, from anywhere.
  void PublishStop() { stops_.publish(std_msgs::Empty()); }

  Offers(const StandInConfig& config, Interface& interface, int joints, double interval_s, Rng& random)
      : config_(config), interface_(interface), n_(joints), random_(random), node_("~") {
    names_ = kinova::RosJointNames(config.robot_name, n_);
    for (const char* finger : {"finger_1", "finger_2", "finger_tip_1", "finger_tip_2"})
      names_.push_back(config.robot_name + "_joint_" + finger);
    states_ = node_.advertise<sensor_msgs::JointState>("out/joint_state", 2);
    angles_ = node_.advertise<kinova_msgs::JointAngles>("out/joint_angles", 2);
    torques_ = node_.advertise<kinova_msgs::JointAngles>("out/joint_torques", 2);
    commands_ = node_.advertise<kinova_msgs::JointAngles>("out/joint_command", 2);
    stops_ = node_.advertise<std_msgs::Empty>("/realitygrad/stop", 1);
    wanted_ = node_.subscribe("in/joint_torque", 1, &Offers::OnTorque, this);
    OfferServices();
    moves_ = std::make_unique<Moves>(
        node_, "joints_action/joint_angles", [this](const auto& goal) { Move(goal); }, false);
    moves_->start();
    timer_ = node_.createWallTimer(ros::WallDuration(interval_s), &Offers::Tick, this);
  }

 private:
  void OfferServices() {
    services_.push_back(node_.advertiseService("in/set_torque_control_mode", &Offers::SetMode, this));
    services_.push_back(
        node_.advertiseService("in/set_torque_control_parameters", &Offers::SetParameters, this));
    services_.push_back(node_.advertiseService("in/set_zero_torques", &Offers::Zero, this));
    services_.push_back(node_.advertiseService("in/set_end_effector_offset", &Offers::SetOffset, this));
    services_.push_back(node_.advertiseService("in/clear_trajectories", &Offers::Clear, this));
    services_.push_back(node_.advertiseService("in/home_arm", &Offers::Home, this));
    services_.push_back(node_.advertiseService("in/start", &Offers::Start, this));
    services_.push_back(node_.advertiseService("in/stop", &Offers::Stop, this));
  }

  // Nine calls, the stamp after the first: positions are older than it, velocities and torques younger.
  void Tick(const ros::WallTimerEvent&) {
    SleepFor(random_.Uniform(0.0, config_.jitter_s));
    sensor_msgs::JointState state;
    state.name = names_;
    const auto angles = interface_.Call([](KinovaBase& base) { return base.Angles(); });
    state.header.stamp = ros::Time::now();
    const auto commanded = interface_.Call([](KinovaBase& base) { return base.Angles(); });
    const auto velocities = interface_.Call([](KinovaBase& base) { return base.Velocities(); });
    const auto torques = interface_.Call([](KinovaBase& base) { return base.Torques(); });
    for (int i = 0; i < n_; ++i) {
      state.position.push_back(kinova::ToRadians(angles[i]).value);
      state.velocity.push_back(kinova::ToRadians(velocities[i]).value);
      state.effort.push_back(torques[i]);
    }
    for (auto* values : {&state.position, &state.velocity, &state.effort})
      values->resize(n_ + kFingerJoints, 0.0);
    states_.publish(state);
    angles_.publish(Fields<kinova_msgs::JointAngles>(Numbers(angles)));
    torques_.publish(Fields<kinova_msgs::JointAngles>(torques));
    commands_.publish(Fields<kinova_msgs::JointAngles>(Numbers(commanded)));
    // Tool pose, wrench, fingers and the rest, which nobody here reads.
    for (int call = 4; call < 9; ++call) interface_.Call([](KinovaBase&) {});
  }

  void OnTorque(const kinova_msgs::JointTorque& message) {
    const double now = RealClock().SteadySeconds();
    if (first_torque_ < 0.0) first_torque_ = now;
    if (stopped_ || now - first_torque_ < config_.lost_at_start_s) return;
    ++torques_taken_;
    interface_.Push([&](KinovaBase& base) { base.SendTorque(Values(message, n_)); });
  }

  bool SetMode(kinova_msgs::SetTorqueControlModeRequest& request,
               kinova_msgs::SetTorqueControlModeResponse&) {
    interface_.Call([&](KinovaBase& base) {
      const double seconds = base.seconds_in_torque_mode();
      base.SetTorqueMode(request.state != 0);
      std::cerr << "stand-in: " << (base.in_torque_mode() ? "torque mode" : "position mode") << ", asked for "
                << (request.state != 0 ? "torque" : "position") << " mode after " << torques_taken_
                << " torques in " << seconds << " s\n";
      torques_taken_ = 0;
    });
    return true;
  }
  bool SetParameters(kinova_msgs::SetTorqueControlParametersRequest&,
                     kinova_msgs::SetTorqueControlParametersResponse&) {
    interface_.Call([](KinovaBase&) {});
    return true;
  }
  bool Zero(kinova_msgs::ZeroTorquesRequest&, kinova_msgs::ZeroTorquesResponse&) {
    interface_.Call([](KinovaBase& base) { base.ZeroTorques(); });
    return true;
  }
  bool SetOffset(kinova_msgs::SetEndEffectorOffsetRequest&, kinova_msgs::SetEndEffectorOffsetResponse&) {
    return true;
  }
  bool Clear(kinova_msgs::ClearTrajectoriesRequest&, kinova_msgs::ClearTrajectoriesResponse&) {
    interface_.Call([](KinovaBase& base) { base.Stop(); });
    return true;
  }
  bool Home(kinova_msgs::HomeArmRequest&, kinova_msgs::HomeArmResponse& response) {
    response.homearm_result = "the stand-in has no home";
    return true;
  }
  bool Start(kinova_msgs::StartRequest&, kinova_msgs::StartResponse& response) {
    stopped_ = false;
    response.start_result = "Start requested";
    return true;
  }
  bool Stop(kinova_msgs::StopRequest&, kinova_msgs::StopResponse& response) {
    stopped_ = true;
    interface_.Call([](KinovaBase& base) { base.Stop(); });
    response.stop_result = "Stop requested";
    return true;
  }

  void Move(const kinova_msgs::ArmJointAnglesGoalConstPtr& goal) {
    kinova_msgs::ArmJointAnglesResult result;
    std::vector<Degrees> pose;
    for (const double angle : Values(goal->angles, n_)) pose.push_back({angle});
    const auto angles = [this] {
      return Numbers(interface_.Push([](KinovaBase& base) { return base.Angles(); }));
    };
    interface_.Call([&](KinovaBase& base) { base.MoveTo(pose); });
    std::vector<double> before = angles();
    double moved_at = RealClock().SteadySeconds();
    while (ros::ok() && !stop) {
      SleepFor(0.1);
      const std::vector<double> now = angles();
      double away = 0.0, way = 0.0;
      for (int i = 0; i < n_; ++i) {
        away = std::max(away, std::abs(ModuloTurn(now[i] - pose[i].value)));
        way = std::max(way, std::abs(now[i] - before[i]));
      }
      result.angles = Fields<kinova_msgs::JointAngles>(now);
      if (way > kStallWay) before = now, moved_at = RealClock().SteadySeconds();
      if (moves_->isPreemptRequested() || stopped_) {
        interface_.Call([](KinovaBase& base) { base.Stop(); });
        return moves_->setPreempted(result);
      }
      if (away <= kReached) return moves_->setSucceeded(result);
      if (RealClock().SteadySeconds() - moved_at > kStallTime) {
        interface_.Call([](KinovaBase& base) { base.Stop(); });
        return moves_->setAborted(result, "Trajectory command failed");
      }
    }
    moves_->setAborted(result, "ended");
  }

  const StandInConfig& config_;
  Interface& interface_;
  const int n_;
  Rng& random_;
  ros::NodeHandle node_;
  std::vector<std::string> names_;
  double first_torque_ = -1.0;
  int torques_taken_ = 0;
  std::atomic<bool> stopped_{false};
  ros::Publisher states_, angles_, torques_, commands_, stops_;
  ros::Subscriber wanted_;
  std::vector<ros::ServiceServer> services_;
  std::unique_ptr<Moves> moves_;
  ros::WallTimer timer_;
};

// True once, when an error of the interface is due.
class OutageClock {
 public:
  OutageClock(const StandInConfig& config, Rng& random)
      : config_(config), random_(random), last_(RealClock().SteadySeconds()) {}

  bool Due(double seconds_in_torque_mode) {
    const double now = RealClock().SteadySeconds();
    const double chance = config_.outages_per_s * (now - last_);
    last_ = now;
    const bool timed =
        config_.outage_after_s > 0 && !done_ && seconds_in_torque_mode > config_.outage_after_s;
    done_ = done_ || timed;
    return timed || random_.Uniform() < chance;
  }

 private:
  const StandInConfig& config_;
  Rng& random_;
  double last_;
  bool done_ = false;
};

Status Serve(const StandInConfig& config, uint64_t seed) {
  auto created = KinovaBase::Create(config, seed);
  if (!created.ok()) return created.status();
  KinovaBase& base = *created.value();
  Rng random(seed);
  double interval = 0.1;
  ros::param::get("~status_interval_seconds", interval);
  Interface interface(base, config.call_s);
  OutageClock outages(config, random);
  auto offers = std::make_unique<Offers>(config, interface, base.joints(), interval, random);
  std::cerr << "stand-in: a " << config.robot_type << " as " << ros::this_node::getName() << ", states every "
            << interval << " s\n";
  while (ros::ok() && !stop) {
    ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.01));
    const double torque_s =
        interface.Push([](KinovaBase& b) { return b.failure().empty() ? b.seconds_in_torque_mode() : -1.0; });
    if (torque_s < 0.0) return InternalError("physics: " + base.failure());
    if (stop_wanted.exchange(false)) offers->PublishStop();
    if (fall_back_wanted.exchange(false)) interface.Push([](KinovaBase& b) { b.Stop(); });
    if (!outages.Due(torque_s) && !outage_wanted.exchange(false)) continue;
    std::cerr << "stand-in: an error of the arm's interface\n";
    offers.reset();
    SleepFor(config.outage_s);
    offers = std::make_unique<Offers>(config, interface, base.joints(), interval, random);
  }
  return Status::Ok();
}

}  // namespace
}  // namespace rg::robot_agent::stand_in

int main(int argc, char** argv) {
  namespace stand_in = rg::robot_agent::stand_in;
  std::string path;
  uint64_t seed = 1;
  double interval = 0.0;
  CLI::App app("A stand-in for kinova-ros and its arm, for the agent's driver `kinova`.",
               "realitygrad-kinova-stand-in");
  app.add_option("--config", path, "realitygrad.stand_in/1, e.g. deploy/robots/mico2_stand_in.json")
      ->required()
      ->check(CLI::ExistingFile);
  app.add_option("--seed", seed, "seed of noise, jitter and random outages");
  app.add_option("--state-interval", interval,
                 "sets the node's parameter status_interval_seconds, as kinova_robot.launch does from "
                 "feedback_publish_rate");
  app.footer(
      "SIGUSR1: an error of the arm's interface now. SIGUSR2: the base falls back to position mode now. "
      "SIGHUP: somebody publishes on /realitygrad/stop.");
  CLI11_PARSE(app, argc, argv);
  const auto config = stand_in::LoadStandInConfig(path);
  if (!config.ok()) {
    std::cerr << "realitygrad-kinova-stand-in: " << config.status().message() << "\n";
    return 1;
  }
  for (const int number : {SIGINT, SIGTERM}) signal(number, [](int) { stand_in::stop = true; });
  signal(SIGUSR1, [](int) { stand_in::outage_wanted = true; });
  signal(SIGUSR2, [](int) { stand_in::fall_back_wanted = true; });
  signal(SIGHUP, [](int) { stand_in::stop_wanted = true; });
  ros::init(ros::M_string(), config.value().robot_name + "_driver",
            ros::init_options::NoSigintHandler | ros::init_options::NoRosout);
  if (!ros::master::check()) {
    std::cerr << "realitygrad-kinova-stand-in: no ROS master at " << ros::master::getURI() << "\n";
    return 1;
  }
  ros::start();
  if (interval > 0.0) ros::param::set("~status_interval_seconds", interval);
  const rg::Status status = stand_in::Serve(config.value(), seed);
  ros::shutdown();
  if (status.ok()) return 0;
  std::cerr << "realitygrad-kinova-stand-in: " << status.message() << "\n";
  return 1;
}
