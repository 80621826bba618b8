// A plant: rigid-body model + effects. Immutable; copies share their data; safe to share by threads.
//
// State x = (q, v, z): joint positions, velocities (n each, model order), internal states of effects
// (bristles, lags, motors behind an elastic joint, a flexible base). z is empty for a rigid plant.
#pragma once

#include <Eigen/Core>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "common/effects/effect.h"
#include "common/sim/parameter_table.h"

namespace rg::model {
class RobotModel;
}

namespace rg::sim {

namespace internal {
struct PlantData;
}

struct PlantOptions {
  Eigen::Vector3d gravity{0, 0, -9.81};  // m/s², base frame: the nominal of gravity.x|y|z
  // Nominal values of further base parameters, by name, where they are not the URDF's: as identified before.
  std::map<std::string, double> nominal;
  // Joints that move as they are told: their motion comes with the command (CommandSignal::motion), its
  // reaction on the others counts, and nothing acts on them.
  std::vector<std::string> prescribed;
  // Joints without a drive: none of its effects is there (EffectInfo::NeedsDrive).
  std::vector<std::string> passive;
};

class Plant {
 public:
  // Refuses what effects::ValidateSpec refuses, joints that the model lacks or that do not take the effect,
  // the same effect twice on one joint, and combinations that are not defined (two elastic transmissions on
  // one joint).
  static Result<Plant> Create(std::shared_ptr<const model::RobotModel> model,
                              const PlantOptions& options = {},
                              std::vector<effects::EffectSpec> effects = {});

  const model::RobotModel& model() const;
  std::shared_ptr<const model::RobotModel> shared_model() const;
  const PlantOptions& options() const;
  const std::vector<effects::EffectSpec>& effects() const;
  const ParameterTable& parameters() const;

  int num_joints() const;           // n
  int num_internal_states() const;  // nz
  int num_states() const { return 2 * num_joints() + num_internal_states(); }
  const std::vector<std::string>& joint_names() const;
  // Joints that move as they are told, ascending.
  const std::vector<int>& prescribed() const;
  bool IsPrescribed(int joint) const;
  bool IsPassive(int joint) const;
  // Whether the effect may act on the joint: nothing on a prescribed one, nothing of a drive on a passive
  // one, no rotor inertia where it is a base parameter (ParameterKind::kArmature).
  bool Takes(std::string_view effect, int joint) const;
  // "bristle.joint_2", "motor_position.joint_3": what z(k) is.
  const std::vector<std::string>& internal_state_names() const;

  // The same robot with one more effect, or without an effect (on all its joints).
  Result<Plant> WithEffect(effects::EffectSpec effect) const;
  Plant WithoutEffect(const std::string& id) const;
  // The same robot and effects where these joints are prescribed and passive. The table has the same rows.
  Result<Plant> WithRoles(std::vector<std::string> prescribed, std::vector<std::string> passive) const;

  // Values of this plant's table, taken from `other` by name, nominal where it has none.
  Eigen::VectorXd ValuesFrom(const ParameterTable& other, const Eigen::VectorXd& values) const;

  const internal::PlantData& data() const { return *data_; }

 private:
  explicit Plant(std::shared_ptr<const internal::PlantData> data) : data_(std::move(data)) {}
  std::shared_ptr<const internal::PlantData> data_;
};

// The parameters of Collins et al. in the paper's order: gravity 3, mass, damping, force_gain, then
// inertia xx, yy, zz of every link: 71 on the Mico².
std::vector<int> PaperParameters(const Plant& plant);

}  // namespace rg::sim
