#include "robot_agent/simulated_robot/robot_server.h"

#include <unistd.h>

#include <cstdlib>

#include "common/base/clock.h"
#include "common/base/log.h"

namespace rg::robot_agent {
namespace {

class Server {
 public:
  Server(RobotWorld& world, const PacketSocket& socket, bool allow_faults)
      : world_(world), socket_(socket), allow_faults_(allow_faults), n_(world.Info().joints.size()) {}

  Status Run() {
    while (!ended_) {
      RobotMessage message;
      const auto received = socket_.Receive(&message, sizeof message, lock_step_ ? 3600.0 : 1e-3);
      if (received.code == StatusCode::kUnavailable) break;
      if (!lock_step_ && greeted_) world_.AdvanceTo(WorldTime());
      if (received.code == StatusCode::kOk) Take(message, received.bytes);
      if (!lock_step_ && greeted_) PublishNew();
    }
    if (!world_.failure().empty()) return InternalError("physics: " + world_.failure());
    return Status::Ok();
  }

 private:
  int64_t WorldTime() const { return RealClock().SteadyNanos() - epoch_ns_; }

  void Take(const RobotMessage& message, size_t bytes) {
    const Status checked = CheckMessage(message, bytes);
    if (!checked.ok()) {
      spdlog::warn("message dropped: {}", checked.ToString());
      return;
    }
    if (frozen_) return;
    switch (message.type) {
      case MessageType::kHello:
        return Greet(message);
      case MessageType::kEnterTorque:
        world_.EnterTorque(message.a.data());
        return Acknowledge();
      case MessageType::kTorque:
        return world_.Torque(message.a.data());
      case MessageType::kHold:
        world_.Hold();
        return Acknowledge();
      case MessageType::kMoveTo:
        world_.MoveTo(message.a.data());
        return Acknowledge();
      case MessageType::kAdvance:
        return Advance(message.time_ns);
      case MessageType::kFault:
        return Inject(message);
      case MessageType::kBye:
        ended_ = true;
        return;
      default:
        spdlog::warn("message of unknown type {} dropped", static_cast<int>(message.type));
    }
  }

  void Greet(const RobotMessage& hello) {
    lock_step_ = hello.flags & RobotMessage::kLockStep;
    epoch_ns_ = lock_step_ ? 0 : RealClock().SteadyNanos() - world_.time_ns();
    greeted_ = true;
    RobotMessage head;
    head.type = MessageType::kInfo;
    head.time_ns = lock_step_ ? world_.time_ns() : RealClock().SteadyNanos();
    head.joints = static_cast<uint32_t>(n_);
    std::string bytes(reinterpret_cast<const char*>(&head), sizeof head);
    bytes += InfoToJson(world_.Info());
    (void)socket_.Send(bytes.data(), bytes.size()).ok();
  }

  void Acknowledge() {
    RobotMessage ack;
    ack.type = MessageType::kAck;
    ack.sequence = world_.next_sequence();
    ack.mode = world_.mode();
    Reply(ack);
  }

  void Advance(int64_t until_ns) {
    world_.AdvanceTo(until_ns);
    RobotMessage reply;
    RobotState state;
    if (world_.NewestState(&state)) Fill(state, &reply);
    reply.type = MessageType::kAdvanced;
    // The request's time, not the last whole cycle's: what is left is made up in the next one.
    reply.time_ns = until_ns;
    Reply(reply);
  }

  void PublishNew() {
    RobotState state;
    if (!world_.TakeState(&state)) return;
    RobotMessage message;
    Fill(state, &message);
    message.type = MessageType::kState;
    message.time_ns = RealClock().SteadyNanos();
    Reply(message);
  }

  void Fill(const RobotState& state, RobotMessage* message) const {
    message->sequence = state.sequence;
    message->stamp_ns = epoch_ns_ + state.stamp_ns;
    message->mode = state.mode;
    message->flags = RobotMessage::kHasState | (state.moving ? RobotMessage::kMoving : 0);
    message->a = state.q;
    message->b = state.v;
    message->c = state.effort;
  }

  void Reply(RobotMessage& message) {
    message.joints = static_cast<uint32_t>(n_);
    if (frozen_ || drop_replies_) return;
    (void)socket_.Send(&message, sizeof message).ok();  // a driver that does not read misses states
  }

  void Inject(const RobotMessage& message) {
    if (!allow_faults_) {
      spdlog::warn("fault refused: start with --allow-faults");
      return;
    }
    const auto fault = static_cast<Fault>(message.code);
    if (fault == Fault::kDie) std::_Exit(1);
    if (fault == Fault::kFreeze) frozen_ = true;
    if (fault == Fault::kDropReplies) drop_replies_ = true;
    world_.Inject(fault, message.a[0]);
  }

  RobotWorld& world_;
  const PacketSocket& socket_;
  const bool allow_faults_;
  const size_t n_;
  int64_t epoch_ns_ = 0;
  bool lock_step_ = false, greeted_ = false, ended_ = false;
  bool frozen_ = false, drop_replies_ = false;
};

}  // namespace

Status ServeRobot(RobotWorld& world, const PacketSocket& socket, bool allow_faults) {
  return Server(world, socket, allow_faults).Run();
}

}  // namespace rg::robot_agent
