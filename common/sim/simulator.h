// Steps a plant through time, with exact derivatives of the discrete steps (no tape, no differences).
//
// One Simulator per thread: it owns its workspace and allocates nothing in Advance and Simulate once
// State, Linearization or Trajectory have their size. Parameters stay until the next SetParameters.
//
//   Simulator sim(plant);
//   sim.SetParameters(p);
//   State x = sim.MakeState(q, v);
//   Linearization lin;
//   Outcome outcome = sim.Advance(x, u, 0.04, &lin);             // control, robot simulation
//   Trajectory out = sim.Simulate(x, command, times, {.initial_state = true, .parameters = paper});
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "common/base/status.h"
#include "common/math/isa.h"
#include "common/sim/command_signal.h"
#include "common/sim/plant.h"
#include "common/sim/trajectory.h"

namespace rg::sim {

// What a step of length h does. Joint forces (damping, friction, elasticity, bristles) are implicit in
// all but rk4: stiff ones need no small step and sticking friction holds.
enum class Integrator {
  // The paper's: v⁺ = v + h·a(q, v), q⁺ = q + h·v⁺. First order.
  kSemiImplicitEuler,
  // Drift h/2, implicit velocity step at q + h/2·v with Coriolis forces and smooth joint forces at the
  // mean velocity, drift h/2. Second order; one mass matrix per step. The default.
  kLeapfrog,
  // Classical Runge-Kutta, fourth order, explicit: for smooth plants without internal states and
  // without stiff damping (10 to 40 ms steps in control). Sign functions are smoothed over
  // SimulatorOptions::rk4_sign_width.
  kRk4,
};

struct SimulatorOptions {
  Integrator integrator = Integrator::kLeapfrog;
  double step_s = 1e-3;          // > 0; intervals are cut into equal steps not longer than this
  double stick_velocity = 1e-6;  // rad/s or m/s > 0: a joint held by friction creeps slower than this
  double rk4_sign_width = 1e-2;  // rad/s > 0
  // One that the processor has. Results are the same bit for bit on one, to 1e-9 across.
  math::Isa isa = math::DetectIsa();
};

// Commands of the past, as far as the longest actuator delay needs them. A value: copies with the state.
class CommandHistory {
 public:
  struct Piece {
    double begin = 0;  // s; holds until the next piece's begin
    Eigen::VectorXd u;
  };
  const std::vector<Piece>& pieces() const { return pieces_; }

 private:
  friend class Simulator;
  std::vector<Piece> pieces_;  // oldest first
};

// States of the past, as far as the longest sensor delay needs them.
class StateHistory {
 private:
  friend class Simulator;
  struct Sample {
    double time = 0;
    Eigen::VectorXd q, v;
  };
  std::vector<Sample> samples_;
};

struct State {
  Eigen::VectorXd q;  // n
  Eigen::VectorXd v;  // n
  Eigen::VectorXd z;  // nz
  double time = 0;    // s
  CommandHistory commands;
  StateHistory states;

  Eigen::VectorXd Stacked() const;  // (q, v, z)
};

// Of one Advance: dx⁺ = A·dx + B·du, the command history held fixed. With an actuator delay B holds
// what u does inside this interval.
struct Linearization {
  RowMatrix A;  // nx × nx
  RowMatrix B;  // nx × n
};

// One of several runs that SimulateWindows takes at once; what it points to is the caller's.
struct SimulationWindow {
  State x0;
  const CommandSignal* command = nullptr;
  const std::vector<double>* times = nullptr;
  bool derivatives_at_end = false;  // of outputs, at the last time alone: dposition and dvelocity are n × c
};

class Simulator {
 public:
  // The plant's data is kept alive. RG_CHECKs Supports(plant, options).
  explicit Simulator(const Plant& plant, const SimulatorOptions& options = {});
  ~Simulator();
  Simulator(Simulator&&) noexcept;
  Simulator& operator=(Simulator&&) noexcept;

  // Steps and widths positive; rk4 only for plants without internal states.
  static Status Supports(const Plant& plant, const SimulatorOptions& options);

  const Plant& plant() const;
  const SimulatorOptions& options() const;

  // values: plant.parameters().size(); starts at nominal. Any finite values are taken (an optimiser may
  // leave the physical bounds); where they make no sense, the outcome says so.
  void SetParameters(const Eigen::VectorXd& values);
  const Eigen::VectorXd& parameters() const;

  // A state at rest or in motion with the internal states that fit it: motors where they hold the
  // command's torque, lags settled at u, bristles relaxed, a mass on a rod where it hangs. u: n, default
  // zero.
  State MakeState(const Eigen::VectorXd& q, const Eigen::VectorXd& v, double time = 0,
                  const Eigen::VectorXd* u = nullptr) const;
  // The same from a recorded command signal, its past included.
  State MakeState(const Eigen::VectorXd& q, const Eigen::VectorXd& v, double time,
                  const CommandSignal& command) const;

  // The state that a measured position and velocity stand for under this plant's sensors: encoder offsets
  // taken off, delayed positions carried forward by delay·velocity, and, where the encoder sits on a motor,
  // the link placed where the transmission holds it under the command. Internal states as MakeState.
  State MakeStateFromMeasurement(const Eigen::VectorXd& q, const Eigen::VectorXd& v, double time,
                                 const CommandSignal& command) const;

  // u (n) held over [x.time, x.time + duration]; duration > 0. On failure x stays as it was. Of a prescribed
  // joint u is its velocity at the end, to which it goes evenly from x; its state is nothing's derivative
  // there, nor has it any.
  Outcome Advance(State& x, const Eigen::VectorXd& u, double duration,
                  Linearization* linearization = nullptr);

  // What the sensors say of a state: encoder offsets, sensor delays, motor-side encoders. q, v: n.
  void Measure(const State& x, Eigen::VectorXd* q, Eigen::VectorXd* v) const;

  // Adds dx (q, v, z) to a state that an estimator found to be off, and to its past, which sensors that are late
  // still report: dq − age·dv to a position, dv to a velocity of that age.
  void Correct(State& x, const Eigen::VectorXd& dx) const;

  // Runs from x0 (at x0.time) to the last output time. times: increasing, the first ≥ x0.time. Commands
  // before x0.time come from the signal. Prescribed joints move as the signal's motion says, which it must
  // bring, from the start on: what x0 says of them does not count.
  Trajectory Simulate(const State& x0, const CommandSignal& command, const std::vector<double>& times,
                      const SensitivityRequest& request = {});
  // The same into a trajectory whose memory is used again.
  void SimulateInto(const State& x0, const CommandSignal& command, const std::vector<double>& times,
                    const SensitivityRequest& request, Trajectory* out);

  // Many runs with the same parameters, each as Simulate, side by side in SIMD lanes: as many at once as a
  // register holds, the next one begins where one ends. A run's result is Simulate's to rounding, and does
  // not depend on the others by a bit. One by one where the plant does not allow lanes (more than eight
  // kernel joints, rk4), and for runs that fail or need steps in parts.
  void SimulateWindows(const std::vector<SimulationWindow>& windows, const SensitivityRequest& request,
                       std::vector<Trajectory>* out);
  // Runs that are taken at once: 1, 2, 4 or 8.
  int lanes() const;

  // Joint accelerations (n) at a state under a held command: forces at the instantaneous velocity. Prescribed
  // joints are not accelerated.
  // Returns false where the mass matrix is not positive definite.
  bool Acceleration(const State& x, const Eigen::VectorXd& u, Eigen::VectorXd* a);

  struct Impl;  // the workspace, private to this folder

 private:
  void RecordCommand(State* x, const Eigen::VectorXd& u, double oldest);
  void RecordState(State* x, double duration);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rg::sim
