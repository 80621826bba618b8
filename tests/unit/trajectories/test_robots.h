// Robots of deploy/robots, for the tests of this folder; test_plants.h makes plants of them.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "common/model/urdf_loader.h"

namespace rg::trajectories {

inline std::shared_ptr<const model::RobotModel> LoadRobot(const std::string& name) {
  const char* source = std::getenv("RG_SOURCE_DIR");
  model::LoadOptions options;
  if (name == "mico2") options.joints = {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"};
  auto model = model::LoadUrdf(
      std::string(source != nullptr ? source : ".") + "/deploy/robots/" + name + ".urdf", options);
  EXPECT_TRUE(model.ok()) << model.status().ToString();
  return std::make_shared<const model::RobotModel>(std::move(model).value());
}

// Joints (0, π, π, 0, 0, 0).
inline Eigen::VectorXd Candle() {
  return Eigen::VectorXd{{0.0, 3.14159265358979, 3.14159265358979, 0.0, 0.0, 0.0}};
}

}  // namespace rg::trajectories
