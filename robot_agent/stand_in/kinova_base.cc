#include "robot_agent/stand_in/kinova_base.h"

#include <cmath>

#include "robot_agent/simulated_robot/robot_world.h"
#include "robot_agent/simulated_robot/truth.h"

namespace rg::robot_agent::stand_in {

using kinova::Degrees;
using kinova::Radians;
using kinova::ToDegrees;
using kinova::ToRadians;

struct KinovaBase::Parts {
  Parts(const StandInConfig& config, RobotTruth truth, uint64_t seed)
      : config(config), truth(std::move(truth)), world(this->truth, seed), zero(this->truth.n(), 0.0) {}

  const StandInConfig config;
  const RobotTruth truth;
  RobotWorld world;
  RobotState newest;
  std::vector<double> zero;  // taken from what the sensors read
  int refusals = 0, asked = 0;
  int64_t torque_since_ns = 0;

  int n() const { return truth.n(); }
  double Turn(int joint) const { return 2.0 * kinova::kPi * config.turns[joint]; }
  double SensorReads(int joint, double effort) const {
    return effort + config.sensor_offset_nm[joint] - zero[joint];
  }

  // Torque mode begins only where the sensors agree with gravity.
  bool Refuses() {
    if (config.refuse_torque_mode < 0 || asked <= config.refuse_torque_mode) return true;
    const Eigen::VectorXd expected = world.BelievedGravity(world.true_state().q);
    for (int i = 0; i < n(); ++i) {
      const double reads = SensorReads(i, world.effort()[i]);
      if (std::abs(reads - expected[i]) > config.switch_threshold_nm) return true;
    }
    return NearStop();
  }

  bool NearStop() const {
    const double distance = ToRadians(Degrees{config.limit_distance_deg}).value;
    for (int i = 0; i < n(); ++i) {
      const auto& joint = truth.plant.model().joint(i);
      const double q = world.true_state().q[i];
      if (q < joint.lower + distance || q > joint.upper - distance) return true;
    }
    return false;
  }

  double SecondsInTorqueMode() const {
    return world.mode() == Mode::kTorque ? 1e-9 * static_cast<double>(world.time_ns() - torque_since_ns)
                                         : 0.0;
  }

  void FallBack() {
    if (world.mode() != Mode::kTorque) return;
    const bool timed = config.leave_torque_mode_s > 0 && SecondsInTorqueMode() > config.leave_torque_mode_s;
    if (timed || NearStop()) world.Hold();
  }
};

KinovaBase::KinovaBase(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
KinovaBase::~KinovaBase() = default;

Result<std::unique_ptr<KinovaBase>> KinovaBase::Create(const StandInConfig& config, uint64_t seed) {
  RG_ASSIGN_OR_RETURN(RobotTruth truth, LoadRobotTruth(config.truth_path));
  if (truth.n() != static_cast<int>(config.turns.size()))
    return InvalidError(config.truth_path + ": has " + std::to_string(truth.n()) + " joints, a " +
                        config.robot_type + " has " + std::to_string(config.turns.size()));
  if (truth.compensation == GravityCompensation::kNone)
    return InvalidError(config.truth_path +
                        ": gravity_compensation is none; the arm's base always adds its own");
  return std::unique_ptr<KinovaBase>(new KinovaBase(std::make_unique<Parts>(config, std::move(truth), seed)));
}

int KinovaBase::joints() const { return parts_->n(); }

void KinovaBase::AdvanceTo(int64_t time_ns) {
  // In steps of the base's own loop, so that a fall-back does not wait for the next call.
  constexpr int64_t kLoop = 10'000'000;
  RobotWorld& world = parts_->world;
  for (int64_t t = world.time_ns() + kLoop; t < time_ns; t += kLoop) {
    world.AdvanceTo(t);
    parts_->FallBack();
  }
  world.AdvanceTo(time_ns);
  parts_->FallBack();
  (void)world.NewestState(&parts_->newest);
}

std::vector<Degrees> KinovaBase::Angles() {
  std::vector<Degrees> angles;
  for (int i = 0; i < joints(); ++i)
    angles.push_back(ToDegrees(Radians{parts_->newest.q[i] + parts_->Turn(i)}));
  return angles;
}

std::vector<Degrees> KinovaBase::Velocities() {
  std::vector<Degrees> velocities;
  for (int i = 0; i < joints(); ++i) velocities.push_back(ToDegrees(Radians{parts_->newest.v[i]}));
  return velocities;
}

std::vector<double> KinovaBase::Torques() {
  std::vector<double> torques;
  for (int i = 0; i < joints(); ++i) torques.push_back(parts_->SensorReads(i, parts_->newest.effort[i]));
  return torques;
}

bool KinovaBase::in_torque_mode() const { return parts_->world.mode() == Mode::kTorque; }

void KinovaBase::SetTorqueMode(bool on) {
  if (!on) return parts_->world.Hold();
  if (in_torque_mode()) return;
  ++parts_->asked;
  if (parts_->Refuses()) {
    ++parts_->refusals;
    return;
  }
  const std::vector<double> zero(joints(), 0.0);
  parts_->world.EnterTorque(zero.data());
  parts_->torque_since_ns = parts_->world.time_ns();
}

void KinovaBase::SendTorque(const std::vector<double>& tau) {
  if (!in_torque_mode()) return;
  std::vector<double> turned;
  for (int i = 0; i < joints(); ++i) turned.push_back(parts_->config.torque_sign[i] * tau[i]);
  parts_->world.Torque(turned.data());
}

void KinovaBase::ZeroTorques() {
  for (int i = 0; i < joints(); ++i) parts_->zero[i] += parts_->SensorReads(i, parts_->world.effort()[i]);
}

void KinovaBase::MoveTo(const std::vector<Degrees>& pose) {
  std::vector<double> target;
  for (int i = 0; i < joints(); ++i) target.push_back(ToRadians(pose[i]).value - parts_->Turn(i));
  parts_->world.MoveTo(target.data());
}

void KinovaBase::Stop() { parts_->world.Hold(); }
int KinovaBase::refusals() const { return parts_->refusals; }
double KinovaBase::seconds_in_torque_mode() const { return parts_->SecondsInTorqueMode(); }
const std::string& KinovaBase::failure() const { return parts_->world.failure(); }

}  // namespace rg::robot_agent::stand_in
