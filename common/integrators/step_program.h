// What the step kernels work on: a plant and its parameter values as plain arrays, the same on every
// instruction set. sim/plant.cc fills in the program once, sim/simulator.cc the values whenever
// parameters change.
//
// The kernel's joints are the tree's: the robot's own and those that effects add (flexible base,
// sloshing mass).
#pragma once

#include <cstdint>

#include "common/dynamics/tree.h"

namespace rg::integrators {

inline constexpr int kMaxJoints = dynamics::kMaxBodies;
inline constexpr int kMaxOps = 160;    // effect × joint
inline constexpr int kMaxLocals = 64;  // variables of one joint's law
inline constexpr int kMaxStates = 6;   // internal states of one joint
inline constexpr int kMaxDrives = 2;   // that turn with two joints
inline constexpr int kMaxPointForces = 4;
inline constexpr int kMaxPointParameters = 8;

// Order of a joint law's local variables. After them: its internal states, then its parameters.
enum LocalVariable { kEndVelocity, kVelocity, kPosition, kCommand, kCoupled, kFirstState };

// The first parameters of every joint.
enum JointParameter { kForceGain, kDamping, kFriction, kFirstEffectParameter };

// One effect on one joint.
struct LawOp {
  int kind = 0;       // number in effects::EffectList
  int parameter = 0;  // first of its parameters among the joint's
  int state = 0;      // first of its states among the joint's
  int option = 0;
};

struct JointProgram {
  int first_op = 0;          // into StepProgram::ops, in the order of Phase
  int num_actuator_ops = 0;  // those before Phase::kCoupling
  int num_ops = 0;
  int first_state = 0;  // into z
  int num_states = 0;
  int first_parameter = 0;  // into StepValues::joint_parameters
  int num_parameters = kFirstEffectParameter;
  int coupled_to = -1;  // joint whose drive torque reaches this one, or -1
  int sees = -1;        // joint whose position this one's law depends on, or -1; not beside coupled_to
  // It moves as it is told: its command is not a torque but its velocity at the step's end.
  bool prescribed = false;

  int num_locals() const { return kFirstState + num_states + num_parameters; }
};

struct PointForce {
  int kind = 0;
  int option = 0;
  int num_parameters = 0;
  int first_parameter = 0;  // into StepValues::point_parameters
};

// A drive that turns with w = v_joint + κ·v_other (coupled_drives.h).
struct CoupledDrive {
  int joint = -1;
  int other = -1;
  int ratio = 0;  // κ's place among its law's parameters
};

struct StepProgram {
  dynamics::Tree tree;
  int num_states = 0;  // of z
  int max_states = 0;  // of one joint
  // Laws: those of the joints, then those of the coupled drives, which are not among the tree's bodies.
  JointProgram joints[kMaxJoints];
  int num_drives = 0;
  CoupledDrive drives[kMaxDrives];
  bool all_free = true;  // no joint is prescribed or follows another one (tree.ties)
  LawOp ops[kMaxOps];
  int num_point_forces = 0;
  PointForce point_forces[kMaxPointForces];
  int point_body = -1;  // body the forces act on, and the point in its frame
  double point[3] = {0, 0, 0};

  int num_laws() const { return tree.n + num_drives; }
};

struct StepValues {
  double phi[kMaxJoints][10];  // barycentric inertial parameters of the bodies
  double gravity[3];
  const double* joint_parameters = nullptr;
  const double* point_parameters = nullptr;
  double reference_mass[kMaxJoints];  // per law; constants of the plant, see effects/joint_law.h
  double stick_velocity = 1e-6;
  double rk4_sign_width = 1e-2;
};

// A kernel steps one window or, in SIMD lanes, several side by side: then every number of the state is
// `lanes` numbers in a row (64-byte aligned), one per window, and so is every number of the sensitivities.
// Plant, parameter values and directions are the same for all.
struct StepInput {
  const double* q = nullptr;                // n
  const double* v = nullptr;                // n
  const double* z = nullptr;                // num_states
  const double* t = nullptr;                // 1
  const double* h = nullptr;                // 1
  const double* command = nullptr;          // n, averages over the step (0 for joints without a drive); end
                                            // velocities of prescribed joints
  const double* command_weights = nullptr;  // per Directions::commands: d(average command)/d(column)
};

struct StepOutput {
  double* q = nullptr;
  double* v = nullptr;
  double* z = nullptr;
};

enum class StepStatus { kOk, kNonFinite, kMassMatrixNotPositive, kNotConverged };
struct StepResult {
  StepStatus status = StepStatus::kOk;  // of the first failure that was seen
  int joint = -1;
  unsigned failed = 0;  // one bit per lane; outputs of lanes that failed mean nothing
};

// Sensitivities of (q, v, z) to a set of directions. Each direction is a column of 2 + max_states rows: q, v,
// then the k-th internal state of each joint (zero where it has fewer); each row has as many entries as the
// kernel's capacity of joints. 64-byte aligned.
struct Sensitivity {
  double* columns = nullptr;
};

// Which columns a parameter enters directly. All other columns only pass on what the state carries.
struct Directions {
  int columns = 0;
  int first_direct = 0;  // columns before this one enter no force directly: the initial state's
  int gravity = -1;      // first of three columns, or -1
  // Body b's inertial directions: columns first_body[b] … + num_body[b], direction k is
  // basis[b][k·10 … k·10 + 9] in φ.
  int first_body[kMaxJoints];
  int num_body[kMaxJoints];
  double basis[kMaxJoints][100];
  struct Local {
    int joint;
    int local;  // LocalVariable or kFirstState + num_states + parameter
    int column;
  };
  bool friction[kMaxJoints] = {};  // whether the joint's own friction level is among them
  // Bit k: the joint's local variable k is among `locals` or `commands`.
  uint64_t used_locals[kMaxJoints] = {};
  int num_locals = 0;
  const Local* locals = nullptr;
  struct Command {
    int joint;
    int column;
  };
  int num_commands = 0;
  const Command* commands = nullptr;
  struct Point {
    int force;
    int parameter;
    int column;
  };
  int num_points = 0;
  const Point* points = nullptr;
};

}  // namespace rg::integrators
