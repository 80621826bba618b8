// Robots and plants for tests of the simulator and of what stands on it.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/base/check.h"
#include "common/model/urdf_loader.h"
#include "common/sim/plant.h"

namespace rg::testing {

inline std::shared_ptr<const model::RobotModel> LoadRobot(const std::string& name) {
  model::LoadOptions options;
  if (name == "mico2") options.joints = {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"};
  auto model = model::LoadUrdf("deploy/robots/" + name + ".urdf", options);
  RG_CHECK(model.ok()) << model.status().ToString();
  return std::make_shared<const model::RobotModel>(std::move(model).value());
}

inline std::vector<std::string> JointNames(const model::RobotModel& model) {
  std::vector<std::string> names;
  for (const auto& joint : model.joints()) names.push_back(joint.name);
  return names;
}

inline sim::Plant MakePlant(const std::string& robot, std::vector<effects::EffectSpec> effects = {},
                            const sim::PlantOptions& options = {}) {
  auto plant = sim::Plant::Create(LoadRobot(robot), options, std::move(effects));
  RG_CHECK(plant.ok()) << plant.status().ToString();
  return std::move(plant).value();
}

}  // namespace rg::testing
