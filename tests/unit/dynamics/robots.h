// Robots and states for the dynamics tests: those of deploy/robots and random trees.
#pragma once

#include <string>
#include <vector>

#include "common/base/rng.h"
#include "common/model/urdf_loader.h"

namespace rg::dynamics {

inline model::RobotModel LoadRobot(const std::string& name, const model::LoadOptions& options = {}) {
  auto model = model::LoadUrdf("deploy/robots/" + name, options);
  RG_CHECK(model.ok()) << model.status().ToString();
  return std::move(model).value();
}

inline model::RobotModel MicoArm() {
  model::LoadOptions options;
  for (int i = 1; i <= 6; ++i) options.joints.push_back("joint_" + std::to_string(i));
  return LoadRobot("mico2.urdf", options);
}

inline std::string Three(double x, double y, double z) {
  char text[96];
  std::snprintf(text, sizeof(text), "%.17g %.17g %.17g", x, y, z);
  return text;
}

// URDF text of a tree with `joints` moving joints, branching, of all types, arbitrary axes and turned
// inertias, with massless and fixed links in between.
inline std::string RandomTreeUrdf(Rng rng, int joints) {
  const auto number = [&] { return rng.Uniform(-1.0, 1.0); };
  const auto origin = [&] {
    return "<origin xyz=\"" + Three(0.3 * number(), 0.3 * number(), 0.3 * number()) + "\" rpy=\"" +
           Three(3 * number(), 1.5 * number(), 3 * number()) + "\"/>";
  };
  const auto inertial = [&] {
    const double a = rng.Uniform(0.01, 0.05), b = rng.Uniform(0.01, 0.05), c = rng.Uniform(0.01, 0.05);
    return "<inertial>" + origin() + "<mass value=\"" + std::to_string(rng.Uniform(0.2, 3.0)) +
           "\"/><inertia ixx=\"" + std::to_string(a + b) + "\" iyy=\"" + std::to_string(b + c) + "\" izz=\"" +
           std::to_string(a + c) + "\" ixy=\"0.001\" ixz=\"-0.002\" iyz=\"0.0015\"/></inertial>";
  };
  std::string links = "<link name=\"base\">" + inertial() + "</link>", text;
  std::vector<std::string> parents = {"base"};
  const char* types[] = {"revolute", "continuous", "prismatic"};
  for (int k = 0; k < joints; ++k) {
    const std::string name = "body" + std::to_string(k), tip = "tip" + std::to_string(k);
    // A parent among the last few, so that there are both long paths and forks.
    const size_t back = 1 + rng.Index(std::min<uint64_t>(3, parents.size()));
    links += "<link name=\"" + name + "\">" + inertial() + "</link><link name=\"" + tip + "\">" +
             (rng.Uniform() < 0.5 ? inertial() : "") + "</link>";
    text += "<joint name=\"j" + std::to_string(k) + "\" type=\"" + types[rng.Index(3)] +
            "\"><parent link=\"" + parents[parents.size() - back] + "\"/><child link=\"" + name + "\"/>" +
            origin() + "<axis xyz=\"" + Three(number(), number(), number()) +
            "\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>";
    text += "<joint name=\"f" + std::to_string(k) + "\" type=\"fixed\"><parent link=\"" + name +
            "\"/><child link=\"" + tip + "\"/>" + origin() + "</joint>";
    parents.push_back(tip);
  }
  return "<robot name=\"tree\">" + links + text + "</robot>";
}

inline model::RobotModel RandomTree(const Rng& rng, int joints) {
  auto model = model::ParseUrdf(RandomTreeUrdf(rng, joints), "tree.urdf");
  RG_CHECK(model.ok()) << model.status().ToString();
  return std::move(model).value();
}

inline std::vector<model::RobotModel> AllRobots() {
  std::vector<model::RobotModel> out = {MicoArm(),
                                        LoadRobot("mico2.urdf"),
                                        LoadRobot("arm2.urdf"),
                                        LoadRobot("pendulum.urdf"),
                                        LoadRobot("arm7.urdf"),
                                        LoadRobot("slide.urdf")};
  for (int joints : {1, 3, 5, 8, 9, 16}) out.push_back(RandomTree(Rng(7).Split(joints), joints));
  return out;
}

inline Eigen::VectorXd RandomVector(Rng& rng, int n, double size = 1.0) {
  Eigen::VectorXd out(n);
  for (int i = 0; i < n; ++i) out[i] = rng.Uniform(-size, size);
  return out;
}

struct RandomState {
  Eigen::VectorXd q, v, a;
};
inline RandomState DrawState(Rng& rng, int n) {
  return {RandomVector(rng, n, 3.0), RandomVector(rng, n, 2.0), RandomVector(rng, n, 5.0)};
}

}  // namespace rg::dynamics
