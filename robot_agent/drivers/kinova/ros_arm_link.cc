#include "robot_agent/drivers/kinova/ros_arm_link.h"

#include <actionlib/client/simple_action_client.h>
#include <kinova_msgs/ArmJointAnglesAction.h>
#include <kinova_msgs/JointTorque.h>
#include <kinova_msgs/SetTorqueControlMode.h>
#include <kinova_msgs/SetTorqueControlParameters.h>
#include <kinova_msgs/ZeroTorques.h>
#include <ros/callback_queue.h>
#include <ros/ros.h>
#include <sensor_msgs/JointState.h>
#include <std_msgs/Empty.h>

#include <cmath>
#include <condition_variable>
#include <cstdlib>
#include <deque>
#include <mutex>
#include <thread>

#include "common/base/clock.h"

namespace rg::robot_agent::kinova {
namespace {

constexpr double kSlice = 0.02;          // s between looks at a stop on the way to a pose
constexpr double kCancelPatience = 0.4;  // s

using MoveClient = actionlib::SimpleActionClient<kinova_msgs::ArmJointAnglesAction>;

std::string MasterOf(const KinovaOptions& options) {
  if (!options.master_uri.empty()) return options.master_uri;
  const char* from_environment = std::getenv("ROS_MASTER_URI");
  return from_environment != nullptr && *from_environment != 0 ? from_environment : "http://localhost:11311";
}

// The process's node, started once.
Status StartNode(const std::string& master) {
  static std::mutex mutex;
  static std::string started;
  const std::lock_guard lock(mutex);
  if (started.empty()) {
    ros::M_string remappings;
    remappings["__master"] = master;
    ros::init(
        remappings, "realitygrad_agent",
        ros::init_options::AnonymousName | ros::init_options::NoSigintHandler | ros::init_options::NoRosout);
    started = master;
  }
  if (started != master)
    return FailedPreconditionError("this process talks to the ROS master at " + started + ", not to " +
                                   master);
  // NodeHandles would wait for a master for ever.
  if (!ros::master::check())
    return UnavailableError("no ROS master at " + master +
                            " (start roscore, or set \"master\" or ROS_MASTER_URI)");
  ros::start();  // by hand: the node outlives the links
  return Status::Ok();
}

// Services block for as long as the peer likes, so they are called from a thread that may be left behind.
class ServiceThread {
 public:
  ServiceThread() : shared_(std::make_shared<Shared>()) {
    std::thread([shared = shared_] { Serve(*shared); }).detach();
  }
  ~ServiceThread() {
    const std::lock_guard lock(shared_->mutex);
    shared_->ended = true;
    shared_->changed.notify_all();
  }

  // False: not done within the time; it is then done, or never, later.
  bool Run(std::function<void()> work, double timeout_s) {
    std::unique_lock lock(shared_->mutex);
    const uint64_t number = ++shared_->asked;
    shared_->work.push_back(std::move(work));
    shared_->changed.notify_all();
    return shared_->changed.wait_for(lock, std::chrono::duration<double>(timeout_s),
                                     [&] { return shared_->done >= number; });
  }

 private:
  struct Shared {
    std::mutex mutex;
    std::condition_variable changed;
    std::deque<std::function<void()>> work;
    uint64_t asked = 0, done = 0;
    bool ended = false;
  };
  static void Serve(Shared& shared) {
    std::unique_lock lock(shared.mutex);
    while (true) {
      shared.changed.wait(lock, [&] { return shared.ended || !shared.work.empty(); });
      if (shared.ended) return;
      auto work = std::move(shared.work.front());
      shared.work.pop_front();
      lock.unlock();
      work();
      lock.lock();
      ++shared.done;
      shared.changed.notify_all();
    }
  }
  std::shared_ptr<Shared> shared_;
};

class RosArmLink final : public ArmLink {
 public:
  explicit RosArmLink(const KinovaOptions& options)
      : n_(options.n()),
        master_(MasterOf(options)),
        node_("/" + options.robot_name + "_driver"),
        stop_topic_(options.stop_topic),
        names_(RosJointNames(options.robot_name, n_)) {}

  ~RosArmLink() override { Close(); }

  Status Open(Listener listener) override {
    Close();
    RG_RETURN_IF_ERROR(StartNode(master_));
    listener_ = std::move(listener);
    handle_ = std::make_unique<ros::NodeHandle>();
    handle_->setCallbackQueue(&queue_);
    states_ = handle_->subscribe(node_ + "/out/joint_state", 8, &RosArmLink::OnState, this,
                                 ros::TransportHints().tcpNoDelay());
    stops_ = handle_->subscribe(stop_topic_, 1, &RosArmLink::OnStop, this);
    torques_ = handle_->advertise<kinova_msgs::JointTorque>(node_ + "/in/joint_torque", 1);
    move_ = std::make_unique<MoveClient>(*handle_, node_ + "/joints_action/joint_angles", false);
    spinner_ = std::make_unique<ros::AsyncSpinner>(1, &queue_);
    spinner_->start();
    return Status::Ok();
  }

  bool TorquesAreHeard() const override { return torques_.getNumSubscribers() > 0; }

  void PublishTorque(const JointArray& tau) override {
    kinova_msgs::JointTorque message;
    float* const fields[] = {&message.joint1, &message.joint2, &message.joint3, &message.joint4,
                             &message.joint5, &message.joint6, &message.joint7};
    for (int i = 0; i < n_; ++i) *fields[i] = static_cast<float>(tau[i]);
    torques_.publish(message);
  }

  Status Call(ArmService service, double timeout_s) override {
    switch (service) {
      case ArmService::kTorqueMode:
      case ArmService::kPositionMode: {
        kinova_msgs::SetTorqueControlMode mode;
        mode.request.state = service == ArmService::kTorqueMode;
        return CallNamed("set_torque_control_mode", mode, timeout_s);
      }
      case ArmService::kZeroTorques:
        return CallNamed("set_zero_torques", kinova_msgs::ZeroTorques(), timeout_s);
      case ArmService::kTorqueParameters:
        return CallNamed("set_torque_control_parameters", kinova_msgs::SetTorqueControlParameters(),
                         timeout_s);
    }
    return InternalError("unknown service");
  }

  Status MoveTo(const std::vector<Degrees>& pose, double timeout_s, const std::atomic<bool>& stop) override {
    const double give_up = RealClock().SteadySeconds() + timeout_s;
    while (!stop && !move_->waitForServer(ros::Duration(kSlice)))
      if (RealClock().SteadySeconds() > give_up)
        return NotFoundError(node_ + "/joints_action/joint_angles is not offered");
    kinova_msgs::ArmJointAnglesGoal goal;
    float* const fields[] = {&goal.angles.joint1, &goal.angles.joint2, &goal.angles.joint3,
                             &goal.angles.joint4, &goal.angles.joint5, &goal.angles.joint6,
                             &goal.angles.joint7};
    for (int i = 0; i < n_; ++i) *fields[i] = static_cast<float>(pose[i].value);
    {
      const std::lock_guard lock(goals_);
      if (stop) return AbortedError("stopped before the way to the pose began");
      move_->sendGoal(goal);
    }
    double stopped_at = INFINITY;
    while (!move_->waitForResult(ros::Duration(kSlice))) {
      const double now = RealClock().SteadySeconds();
      if (stop) stopped_at = std::min(stopped_at, now);
      if (now > stopped_at + kCancelPatience) return AbortedError("stopped; the arm's driver does not answer");
      if (now < give_up) continue;
      move_->cancelGoal();
      return DeadlineExceededError("the pose was not reached within " + std::to_string(timeout_s) + " s");
    }
    const actionlib::SimpleClientGoalState state = move_->getState();
    if (state == actionlib::SimpleClientGoalState::SUCCEEDED) return Status::Ok();
    return AbortedError("the arm's driver ended the way to the pose: " + state.toString() + " " +
                        state.getText());
  }

  void CancelMove() override {
    const std::lock_guard lock(goals_);
    move_->cancelAllGoals();
  }

  bool StopAsked() const override { return stop_asked_; }

  // The address that it has with the master, on a port of its own.
  std::string RunOfDriver() const override {
    XmlRpc::XmlRpcValue request, response, payload;
    request[0] = ros::this_node::getName();
    request[1] = node_;
    if (!ros::master::execute("lookupNode", request, response, payload, false)) return "";
    return payload.getType() == XmlRpc::XmlRpcValue::TypeString ? static_cast<std::string>(payload) : "";
  }

  std::optional<double> StatusInterval() const override {
    double interval = 0.0;
    if (ros::param::get(node_ + "/status_interval_seconds", interval)) return interval;
    return std::nullopt;
  }

 private:
  void Close() {
    if (spinner_) spinner_->stop();
    spinner_.reset();
    move_.reset();
    states_.shutdown();
    stops_.shutdown();
    torques_.shutdown();
  }

  template <class Service>
  Status CallNamed(const std::string& name, Service service, double timeout_s) {
    struct Outcome {
      std::mutex mutex;
      Status status;
    };
    const auto outcome = std::make_shared<Outcome>();
    const std::string full = node_ + "/in/" + name;
    const bool done = services_.Run(
        [full, service, outcome]() mutable {
          const Status called = CallIfOffered(full, service);
          const std::lock_guard lock(outcome->mutex);
          outcome->status = called;
        },
        timeout_s);
    if (!done)
      return DeadlineExceededError("service " + full + " did not answer within " + std::to_string(timeout_s) +
                                   " s");
    const std::lock_guard lock(outcome->mutex);
    return outcome->status;
  }

  template <class Service>
  static Status CallIfOffered(const std::string& name, Service& service) {
    if (ros::service::exists(name, false)) {
      if (ros::service::call(name, service)) return Status::Ok();
      return FailedPreconditionError("service " + name + " failed");
    }
    if (!ros::master::check()) return UnavailableError("the ROS master is away");
    return NotFoundError("service " + name + " is not offered");
  }

  void OnStop(const std_msgs::Empty::ConstPtr&) { stop_asked_ = true; }

  void OnState(const sensor_msgs::JointState::ConstPtr& message) {
    JointReport report;
    report.received_ns = RealClock().SteadyNanos();
    report.stamp_ns = static_cast<int64_t>(message->header.stamp.toNSec());
    report.number = message->header.seq;
    const Status picked =
        PickJoints({message->name, message->position, message->velocity, message->effort}, names_, &report);
    if (picked.ok()) {
      listener_(report);
    } else {
      listener_(picked);
    }
  }

  const int n_;
  const std::string master_, node_, stop_topic_;
  const std::vector<std::string> names_;
  Listener listener_;
  ros::CallbackQueue queue_;
  std::unique_ptr<ros::NodeHandle> handle_;
  ros::Subscriber states_, stops_;
  std::atomic<bool> stop_asked_{false};
  ros::Publisher torques_;
  std::unique_ptr<MoveClient> move_;
  std::mutex goals_;  // none is sent after they were cancelled
  std::unique_ptr<ros::AsyncSpinner> spinner_;
  ServiceThread services_;
};

}  // namespace

std::unique_ptr<ArmLink> MakeRosArmLink(const KinovaOptions& options) {
  return std::make_unique<RosArmLink>(options);
}

}  // namespace rg::robot_agent::kinova
