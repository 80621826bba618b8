// How a plant is laid out for the step kernels. Private to this folder.
#pragma once

#include <algorithm>
#include <array>
#include <memory>
#include <string>
#include <vector>

#include "common/dynamics/dynamics.h"
#include "common/effects/effect.h"
#include "common/integrators/step_program.h"
#include "common/model/robot_model.h"
#include "common/sim/parameter_table.h"
#include "common/sim/plant.h"

namespace rg::sim::internal {

// One place where a parameter enters.
struct ParameterUse {
  enum class Where {
    kGravity,       // a: axis
    kLink,          // a: link of the tree's model, b: component of model::LinkParameters
    kLaw,           // a: law (of a kernel joint or a coupled drive), b: its parameter
    kPoint,         // a: point force, b: parameter
    kPayload,       // b: parameter of the payload
    kRod,           // b: mass, length or radius of a mass on a rod
    kGravityTurn,   // b: parameter of gravity_misalignment
    kCommandDelay,  // a: joint
    kSensorDelay,   // a: joint
    kSensorOffset,  // a: joint
  };
  Where where;
  int a = 0;
  int b = 0;
};

struct JointSensor {
  int motor_state = -1;  // first of the kernel's z rows (position, then velocity) if the encoder sits
                         // on the motor, else -1
  int offset = -1;       // parameters, or -1
  int delay = -1;
  bool delays_position = true;
  bool delays_velocity = true;
};

// A mass that hangs on a rod.
struct Rod {
  int hinge = -1;  // axis of the tool link that it turns about first (0 x, 1 y, 2 z); -1: there is none
  int link = -1;   // of the tree's model
  std::array<int, 3> parameters;  // mass, length, radius
  // To find where it hangs: the robot without it, and the tool link on that.
  std::shared_ptr<const dynamics::Mechanism> arm;
  model::Frame tool;
};

struct PlantData {
  std::shared_ptr<const model::RobotModel> model;
  std::shared_ptr<const model::RobotModel> tree_model;  // with the bodies that effects add
  PlantOptions options;
  std::vector<effects::EffectSpec> effects;
  ParameterTable table;
  std::vector<std::vector<ParameterUse>> uses;  // per parameter
  std::vector<std::string> joint_names;
  std::vector<std::string> internal_state_names;

  // Kernel joints, places in program.tree: those that the base stands on, the robot's n, those that follow
  // one of them, those that hang on it.
  int first_joint = 0;            // number of joint 0 among the tree's model's
  std::vector<int> kernel;        // per joint: its kernel joint
  std::vector<int> extra_joints;  // kernel joints that effects add
  std::vector<int> prescribed;    // joints, ascending
  std::vector<char> passive;      // per joint
  // Per joint: its links have no inertia about its axis, and a rotor's is a base parameter.
  std::vector<char> without_inertia;
  integrators::StepProgram program;
  int num_joint_parameters = 0;
  int num_point_parameters = 0;
  std::vector<double> reference_mass;  // per law

  std::vector<int> command_delay;  // per joint: parameter, or -1
  std::vector<JointSensor> sensors;
  bool has_command_delay = false;
  bool has_sensor_delay = false;
  int payload = -1;       // first parameter of the payload, or -1
  int gravity_turn = -1;  // first parameter of gravity_misalignment, or -1
  Rod rod;

  // What the kernel's joint k is in the tree's model.
  const model::Joint& KernelJoint(int k) const { return tree_model->body_joint(program.tree.body[k]); }
  // Whose law is number k: a kernel joint's, or that of the drive of one.
  const std::string& LawName(int k) const {
    const int drive = k - num_kernel_joints();
    return KernelJoint(drive < 0 ? k : program.drives[drive].joint).name;
  }
  // Whether kernel joint k's motor turns with another joint too.
  bool HasCoupledDrive(int k) const {
    return std::any_of(program.drives, program.drives + program.num_drives,
                       [k](const integrators::CoupledDrive& drive) { return drive.joint == k; });
  }
  // Kernel joint of a body of the tree's model; -1 of the base.
  int PlaceOf(int body) const { return body < 0 ? -1 : program.tree.place[body]; }
  // The last joint's child link, which a payload is fixed to.
  int PayloadLink() const { return tree_model->joint(first_joint + num_joints() - 1).child_link; }
  bool IsPrescribed(int joint) const {
    return std::binary_search(prescribed.begin(), prescribed.end(), joint);
  }
  bool Takes(const effects::EffectInfo& effect, int joint) const {
    const auto j = static_cast<size_t>(joint);
    if (IsPrescribed(joint) || (passive[j] && effect.NeedsDrive())) return false;
    const int armature = effect.FindParameter("armature");
    return !(without_inertia[j] && armature >= 0 && effect.parameters[armature].form.empty());
  }

  int num_joints() const { return static_cast<int>(joint_names.size()); }
  int num_kernel_joints() const { return program.tree.n; }
  int num_internal_states() const { return program.num_states + 2 * static_cast<int>(extra_joints.size()); }
};

// What effects add to the tree.
struct ExtraBodies {
  bool flexible_base = false;
  bool mass_in_springs = false;
  int rod_hinge = -1;  // see Rod::hinge
};
// The model with a rocking base, and a mass in springs or on a rod on `tool`, an index of links().
std::shared_ptr<const model::RobotModel> WithExtraBodies(std::shared_ptr<const model::RobotModel> model,
                                                         const ExtraBodies& extra, int tool);
inline constexpr int kBaseJoints = 2;   // about x, then y
inline constexpr int kSloshJoints = 3;  // along x, y, z
inline constexpr int kRodJoints = 2;    // about the hinge's axes

}  // namespace rg::sim::internal
