// A small robot for whole programs: two heavy links, with physics that its URDF lacks.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "tests/integration/cli/program.h"

namespace rg {

inline std::string Replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

// Writes small.robot.json, small_agent.json, truth.json and arm.urdf into the scratch folder: arm2 with links
// that 25 Hz can hold. `effects`: of the truth, as robot_agent/simulated_robot/truth.h has them.
inline void WriteSmallRobot(const ScratchFolder& scratch, const nlohmann::json& effects, double excitation,
                            double sensor_rate_hz = 100) {
  using nlohmann::json;
  std::string urdf = ReadFile(std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/arm2.urdf").value();
  urdf = Replaced(urdf, "mass value=\"1.8\"", "mass value=\"6\"");
  urdf = Replaced(urdf, "mass value=\"1.1\"", "mass value=\"4\"");
  urdf = Replaced(urdf, "ixx=\"0.01999125\" iyy=\"0.01999125\" izz=\"0.0011025\"",
                  "ixx=\"0.2\" iyy=\"0.2\" izz=\"0.02\"");
  urdf = Replaced(urdf, "ixx=\"0.0084975\" iyy=\"0.0084975\" izz=\"0.000495\"",
                  "ixx=\"0.1\" iyy=\"0.1\" izz=\"0.01\"");
  urdf = Replaced(urdf, "damping=\"0.1\"", "damping=\"2\"");
  urdf = Replaced(urdf, "damping=\"0.05\"", "damping=\"1\"");
  urdf = Replaced(urdf, "effort=\"25\"", "effort=\"80\"");
  urdf = Replaced(urdf, "effort=\"12\"", "effort=\"40\"");
  const auto write = [&](const char* name, const std::string& text) {
    ASSERT_TRUE(WriteFileAtomically(scratch / name, text).ok());
  };
  write("arm.urdf", urdf);
  const std::vector<double> home = {0.4, 0.5};
  write("small.robot.json", json{{"name", "small"},
                                 {"urdf", "arm.urdf"},
                                 {"home", home},
                                 {"peak_torque", {60, 30}},
                                 {"truth", "truth.json"}}
                                .dump());
  write(
      "truth.json",
      json{{"format", "realitygrad.robot_truth/1"},
           {"robot", "small"},
           {"urdf", "arm.urdf"},
           {"effects", effects},
           {"torque_limit", {80, 40}},
           {"initial_pose", home},
           {"position_controller", {{"stiffness", {600, 300}}, {"damping", {60, 30}}, {"speed", {1, 1}}}},
           {"sensors", {{"rate_hz", sensor_rate_hz}, {"position_stddev", 3e-4}, {"velocity_stddev", 0.005}}}}
          .dump());
  write("small_agent.json", json{{"format", "realitygrad.agent/1"},
                                 {"name", "small"},
                                 {"driver", "simulated"},
                                 {"simulated", {{"truth", "truth.json"}, {"lock_step", true}}},
                                 {"start_pose", home},
                                 {"pose_tolerance", 0.2},
                                 {"excitation", excitation},
                                 {"urdf", "arm.urdf"},
                                 {"limits",
                                  {{"lower", {-2.78, -2.48}},
                                   {"upper", {2.78, 2.48}},
                                   {"velocity", {6, 8}},
                                   {"torque", {80, 40}},
                                   {"torque_rate", {4000, 2000}},
                                   {"task_box", nullptr}}}}
                                .dump());
}

}  // namespace rg
