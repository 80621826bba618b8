// The simulated robot's truth: physics that the model under identification does not know.
//
// realitygrad.robot_truth/1, JSON:
//   "format", "robot"       "mico2"
//   "urdf"                  path, relative to the truth file; "joints" (the moving ones), "locked" {joint: q}
//   "model"                 instead of these, relative too: a model.json (of a diagnosis, an identification);
//                           "parameters" and "effects" then come on top of what it holds
//   "based_on"              another truth file, relative: its fields stand where this one is silent
//   "gravity"               [3], default (0, 0, -9.81)
//   "parameters"            {"<name of the plant's parameter table>": {"scale": s} | {"add": d} | {"value":
//   x}}:
//                           wrong masses, inertias, …, as departures from the URDF
//   "effects"               [{"effect": id, "joints": [...], "parameters": {name: x | [x per joint]},
//                           "options": {…}}]; ids and names of the effect catalogue
//   "more_effects"          the same, after "effects" (with "based_on": after the other file's)
//   "torque_limit"          [n] what the drives can give, N·m
//   "gravity_compensation"  "none": a command is the whole torque (the base's gravity model is nulled);
//                           "nominal" | "true": the base adds g(q) of the URDF's | of the true masses |
//                           ("given") of
//   "compensation_parameters"  departures from the URDF, as in "parameters": what the base believes
//   "silence"               {"timeout_s": 0.25, "action": "position_mode" | "zero_torque"}: what the base
//                           does when commands stop coming in torque mode
//   "position_controller"   {"stiffness": [n] N·m/rad, "damping": [n] N·m·s/rad, "speed": [n] rad/s}
//   "initial_pose"          [n]
//   "sensors"               {"rate_hz", "latency_s" (measured -> delivered), "position_stddev",
//                           "position_resolution", "velocity_stddev", "velocity_gain": [n] (what the
//                           firmware's velocity is multiplied by), "effort_stddev", "effort_filter_s"}
//   "command_latency_s"     received -> in force
//   "step_s"                cycle of commands, modes and position control; the physics steps are
//                           "physics_step_s"
// Unknown fields are refused, sizes and ranges checked; the error names file and field.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/sim/plant.h"

namespace rg::robot_agent {

enum class GravityCompensation { kNone, kNominal, kTrue, kGiven };
enum class SilenceAction { kPositionMode, kZeroTorque };

struct RobotTruth {
  std::string robot;
  sim::Plant plant;        // with the hidden effects
  Eigen::VectorXd values;  // of plant.parameters(): the hidden truth
  Eigen::VectorXd torque_limit;
  GravityCompensation compensation = GravityCompensation::kNone;
  Eigen::VectorXd compensation_values;  // of plant.parameters(); kGiven only
  double silence_timeout_s = 0.25;
  SilenceAction silence_action = SilenceAction::kPositionMode;
  Eigen::VectorXd stiffness, damping, speed;  // position control
  Eigen::VectorXd initial_pose;
  double rate_hz = 100.0;
  double latency_s = 0.0, command_latency_s = 0.0;
  double position_stddev = 0.0, position_resolution = 0.0;
  double velocity_stddev = 0.0;
  Eigen::VectorXd velocity_gain;
  double effort_stddev = 0.0, effort_filter_s = 0.0;
  double step_s = 1e-3, physics_step_s = 5e-4;

  int n() const { return plant.num_joints(); }
};

Result<RobotTruth> LoadRobotTruth(const std::string& path);

}  // namespace rg::robot_agent
