// Simulated sets whose joints are not all driven ones: held by another controller, or without a drive.
#pragma once

#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "common/base/file.h"
#include "common/base/rng.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/recording_set.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid::testing {

// Joint j has no effort column: what moved it is forgotten.
inline void Prescribe(recordings::RecordingSet* set, int j) {
  set->prescribed.push_back(set->joints[static_cast<size_t>(j)]);
  for (recordings::Recording& r : set->recordings) {
    r.joints = set->joints;
    r.prescribed.push_back(j);
    if (r.has_effort_command()) r.effort_command.row(j).setZero();
    if (r.has_effort_measured()) r.effort_measured.row(j).setZero();
  }
}

// arm2 whose elbow hangs free, torque on the shoulder alone; `push`: of a torque on the elbow of which the
// files say nothing. The last of three recordings is kept aside.
inline recordings::RecordingSet Pendubot(std::vector<effects::EffectSpec> effects = {}, double push = 0.0,
                                         double start = 0.0) {
  const sim::Plant truth = LoadPlant("arm2", std::move(effects));
  recordings::RecordingSet set;
  set.folder = ".";
  set.urdf_path = RobotPath("arm2");
  set.urdf_text = *ReadFile(set.urdf_path);
  set.joints = truth.joint_names();
  set.noise.position_stddev = 2e-4, set.noise.velocity_stddev = 4e-3;
  sim::Simulator simulator(truth);
  Rng rng(7);
  for (int k = 0; k < 3; ++k) {
    recordings::Recording r;
    r.name = "rec_" + std::to_string(k), r.joints = set.joints;
    constexpr int kRows = 501;
    r.t.resize(kRows), r.q.resize(2, kRows), r.v.resize(2, kRows), r.effort_command.setZero(2, kRows);
    sim::State x = simulator.MakeState(Eigen::VectorXd::Zero(2), Eigen::VectorXd::Zero(2));
    for (int i = 0; i < kRows; ++i) {
      const double t = 0.01 * i;
      Eigen::VectorXd u(2);
      u << 4.0 * std::sin(3.1 * t + k) - 2.0 * x.v[0], push * std::sin(2.0 * t + k);
      r.t[i] = start + t;
      for (int j = 0; j < 2; ++j) {
        r.q(j, i) = x.q[j] + *set.noise.position_stddev * rng.Normal();
        r.v(j, i) = x.v[j] + *set.noise.velocity_stddev * rng.Normal();
      }
      r.effort_command(0, i) = u[0];
      RG_CHECK(simulator.Advance(x, u, 0.01).ok());
    }
    r.split = k == 2 ? recordings::Split::kHoldout : recordings::Split::kFit;
    set.recordings.push_back(std::move(r));
  }
  return set;
}

// arm2 with another text in the place of some.
inline std::string Arm2With(const std::string& old, const std::string& fresh) {
  std::string text = *ReadFile(RobotPath("arm2"));
  const size_t at = text.find(old);
  RG_CHECK(at != std::string::npos) << old;
  return text.replace(at, old.size(), fresh);
}

// arm2 whose tool turns about its own axis and has no inertia: joint_tool.
inline std::string ArmWithFlange() {
  return Arm2With(R"(<joint name="joint_tool" type="fixed">)",
                  R"(<joint name="joint_tool" type="continuous"><axis xyz="0 0 1"/>)");
}

// arm2 with a second, heavy rod on its upper arm that turns against the elbow.
inline std::string ArmWithLinkage() {
  return Arm2With(R"(<joint name="joint_tool")", R"(<link name="rod"><inertial><origin xyz="0 0 -0.2"/>
      <mass value="1.5"/><inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="linkage" type="continuous"><parent link="upper_arm"/><child link="rod"/>
      <origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/><mimic joint="elbow" multiplier="-1.5" offset="0.4"/></joint>
    <joint name="joint_tool")");
}

// Three recordings of a robot, the last one kept aside. `values`: of some of the truth's parameters, by name.
inline recordings::RecordingSet SetOf(const std::string& urdf, std::vector<effects::EffectSpec> effects,
                                      const std::map<std::string, double>& values, uint64_t seed,
                                      double duration_s = 6.0) {
  auto model = model::ParseUrdf(urdf, "robot.urdf", {});
  RG_CHECK(model.ok()) << model.status().ToString();
  const auto robot = std::make_shared<const model::RobotModel>(std::move(model).value());
  auto truth = sim::Plant::Create(robot, {}, std::move(effects));
  RG_CHECK(truth.ok()) << truth.status().ToString();
  Eigen::VectorXd true_values = truth->parameters().Nominal();
  for (const auto& [name, value] : values) true_values[*truth->parameters().IndexOf(name)] = value;
  recordings::RecordingSet set;
  set.folder = ".", set.urdf_path = "robot.urdf", set.urdf_text = urdf;
  set.joints = truth->joint_names();
  set.noise.position_stddev = 3e-4, set.noise.velocity_stddev = 5e-3;
  for (int k = 0; k < 3; ++k) {
    const MakeOptions make = {
        .duration_s = duration_s, .position_noise = 3e-4, .velocity_noise = 5e-3, .amplitude = 1.2};
    set.recordings.push_back(MakeRecording(*truth, true_values, seed + static_cast<uint64_t>(k), make));
    set.recordings.back().joints = set.joints;
    set.recordings.back().name = "rec_" + std::to_string(k);
  }
  set.recordings.back().split = recordings::Split::kHoldout;
  return set;
}

}  // namespace rg::sysid::testing
