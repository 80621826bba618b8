// Turns a model and a list of effects into PlantData: parameter table, step program, sensors.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/effects/effect_catalog.h"
#include "common/sim/parameter_values.h"
#include "common/sim/plant_data.h"

namespace rg::sim::internal {

class PlantBuilder {
 public:
  PlantBuilder(std::shared_ptr<const model::RobotModel> model, const PlantOptions& options,
               std::vector<effects::EffectSpec> effects);
  Status Build();
  std::shared_ptr<const PlantData> Take();

 private:
  // An effect on a joint, waiting for its place among the joint's ops.
  struct PendingOp {
    int phase;
    int kind;
    int option;
    int first_parameter;  // among the joint's own
    int coupled_to;       // kernel joint, or -1
  };

  Status TakeRoles();
  Status CheckRole(const effects::EffectSpec& spec, const std::string& joint) const;
  Status CheckEffects() const;
  int ToolLink() const;
  Status LayOutTree();
  void AddBaseParameters();
  Status AddEffect(const effects::EffectSpec& spec);
  Status LayOutDrives();
  void AddDrive(const effects::EffectSpec& spec, int kind);
  Status AddJointEffect(const effects::EffectSpec& spec, int kind, int joint);
  void AddRobotEffect(const effects::EffectSpec& spec, int kind);
  void AddMovingMass(const std::vector<int>& rows);
  // Adds the effect's rows for one owner; returns the index of each, -1 for those that do not apply.
  std::vector<int> AddRows(const effects::EffectSpec& spec, int kind, const std::string& owner, int joint);
  void AddLaw(int law, int kind, int option, const std::vector<int>& rows, int coupled_to = -1);
  void Add(Parameter row, std::vector<ParameterUse> uses);
  Status LayOutProgram();
  void NameInternalStates();
  double RotorOf(int joint, const Eigen::MatrixXd& M) const;
  double DriveMobility(int k, const ParameterValues& values, const Eigen::MatrixXd& inverse) const;
  void SetReferenceMasses();

  std::shared_ptr<PlantData> data_;
  std::vector<std::vector<PendingOp>> ops_;  // per law
  std::vector<int> joint_parameters_;        // per law: number so far
  std::map<std::string, int> extra_;         // name of an extra joint -> kernel joint
};

}  // namespace rg::sim::internal
