// What the loop has to know of a robot besides its URDF: <folder>/<name>.json.
//
//   {"name": "mico2", "urdf": "mico2.urdf", "joints": ["joint_1", …], "home": [0, 3.14, …],
//    "end_effector": "end_effector", "peak_torque": [30.5, …], "truth": "mico2_truth.json"}
// `joints` (default: all movable) move, the others are locked at 0. `truth` is what a simulated robot
// really is.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::cli {

struct RobotProfile {
  std::string name;
  std::string folder;
  std::string urdf;  // path
  std::vector<std::string> joints;
  std::vector<double> home;         // rad or m; empty: zero
  std::string end_effector;         // empty: the model's choice
  std::vector<double> peak_torque;  // N·m; empty: the URDF's limits
  std::string truth;                // path; empty: there is no simulated one
};

// Names in `folder` that have a profile, sorted.
Result<std::vector<std::string>> ListRobotProfiles(const std::string& folder);
// `name` is a profile's name, or the path of a profile file.
Result<RobotProfile> LoadRobotProfile(const std::string& folder, const std::string& name);

}  // namespace rg::cli
