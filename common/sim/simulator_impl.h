// The simulator's workspace. Private to this folder.
#pragma once

#include <cstdlib>
#include <memory>
#include <optional>
#include <vector>

#include "common/integrators/step_kernel.h"
#include "common/sim/direction_plan.h"
#include "common/sim/parameter_values.h"
#include "common/sim/sensitivity_layout.h"
#include "common/sim/simulator.h"

namespace rg::sim {

// Zeroed memory on a cache line, as the kernels want it.
class AlignedBuffer {
 public:
  AlignedBuffer() = default;
  void Resize(size_t bytes);
  void* data() const { return data_.get(); }
  double* doubles() const { return static_cast<double*>(data_.get()); }

 private:
  struct Free {
    void operator()(void* p) const { std::free(p); }
  };
  std::unique_ptr<void, Free> data_;
  size_t bytes_ = 0;
};

// The kernel's state of one window or of several side by side, and that of the last step's begin.
struct KernelState {
  // `lanes` numbers per entry; zero.
  KernelState(const internal::PlantData& plant, int lanes);

  void Load(const internal::PlantData& plant, const State& x, int lane);
  // The same as a run under `signal` begins: prescribed joints are where they are told to be.
  void LoadStart(const internal::PlantData& plant, const State& x, const CommandSignal& signal, int lane);
  // Positions of prescribed joints, and of what follows them, as they are told at time t: no rounding of
  // steps adds up.
  void SetGiven(const internal::PlantData& plant, const CommandSignal& signal, double t, int lane);
  void Store(const internal::PlantData& plant, State* x) const;  // of lane 0
  void StoreStacked(const internal::PlantData& plant, int lane, double* x) const;
  // Joints that follow others, from these.
  void Follow(const internal::PlantData& plant, int lane);
  // The next state becomes the present one, the present one begin_*.
  void Shift();
  // A state and command of zero in one lane.
  void Clear(int lane);

  int lanes;
  AlignedBuffer memory;
  size_t size;  // numbers in it
  double *q, *v, *z, *begin_q, *begin_v, *begin_z, *next_q, *next_v, *next_z, *command;
  AlignedBuffer command_weights;
};

// Two sets of sensitivities between which the steps alternate, and what the kernels need beside.
struct SensitivityBuffers {
  AlignedBuffer memory;
  internal::SensitivityLayout layout;
  integrators::Sensitivity at[2];
  double* direct = nullptr;
  int current = 0;

  void Resize(const internal::SensitivityLayout& layout, int columns);
  // Of set `which`.
  internal::SensitivityRow Row(int which, int row, int joint, int lane) const {
    return {at[which].columns + layout.Offset(row, joint, lane), layout.column_size()};
  }
  // Calls f(row) for each entry of the state (q, v, z), in its order, of the present set.
  template <class F>
  void ForEachStateRow(const internal::PlantData& d, int lane, F f) const {
    for (int row = 0; row < 2; ++row) {
      for (int j = 0; j < d.num_joints(); ++j) f(Row(current, row, d.kernel[j], lane));
    }
    for (int j = 0; j < d.num_kernel_joints(); ++j) {
      for (int k = 0; k < d.program.joints[j].num_states; ++k) f(Row(current, 2 + k, j, lane));
    }
    for (const int j : d.extra_joints) {
      f(Row(current, 0, j, lane));
      f(Row(current, 1, j, lane));
    }
  }
};

// Equal steps not longer than `limit` that make up `duration`; a part in 10⁹ of slack for times that are
// sums.
long StepsFor(double duration, double limit);

struct LaneRunner;  // simulate_windows.cc
struct DeleteLaneRunner {
  void operator()(LaneRunner* runner) const;
};

struct Simulator::Impl {
  Impl(const Plant& plant, const SimulatorOptions& options);

  const internal::PlantData& data() const { return plant.data(); }
  int n() const { return data().num_joints(); }

  // One step of length h from time t; commands must be set. On success the state and, with a plan, the
  // sensitivities are those of the step's end; the state at its begin stays in begin_*.
  // Where the motion is too fast for h (a light wrist spinning freely at 100 rad/s), the step is halved, up
  // to kMaxHalvings times; the command keeps its average.
  Outcome Step(double t, double h, internal::DirectionPlan* plan, SensitivityBuffers* buffers);
  Outcome StepInParts(double t, double h, int halvings, internal::DirectionPlan* plan,
                      SensitivityBuffers* buffers);
  static constexpr int kMaxHalvings = 6;
  void Simulate(const State& x0, const CommandSignal& signal, const std::vector<double>& times,
                const SensitivityRequest& request, bool derivatives_at_end, Trajectory* out);
  // A plan for this request with the present parameters; laid out anew only when the request changes.
  internal::DirectionPlan& PlanFor(const SensitivityRequest& request);  // and buffers
  internal::DirectionPlan& ControlPlan();
  void SetValues(const Eigen::VectorXd& values);
  // Average commands over [t, t + h] into one lane of `to`, the velocities at its end of prescribed joints,
  // and their derivative by the delays in the plan.
  void SetCommands(const CommandSignal& signal, double t, double h, const internal::DirectionPlan* plan,
                   int lane, KernelState* to) const;

  double Delay(int joint) const;        // of the command, s, ≥ 0
  double SensorDelay(int joint) const;  // s, ≥ 0
  double Offset(int joint) const;
  // Internal states that fit a resting command u (kernel order).
  void SettleInternalStates(const Eigen::VectorXd& q, const Eigen::VectorXd& v, const Eigen::VectorXd& u,
                            double time, Eigen::VectorXd* z) const;

  Plant plant;
  SimulatorOptions options;
  const integrators::StepKernels& kernels;
  integrators::StepFunction step;
  internal::ParameterValues values;
  integrators::StepValues kernel_values{};
  AlignedBuffer scratch;
  long version = 0;  // of the parameters

  // Null where windows cannot run side by side; otherwise with the present parameters.
  LaneRunner* Lanes();

  KernelState x;
  long step_count = 0;
  std::unique_ptr<LaneRunner, DeleteLaneRunner> lanes;

  std::optional<internal::DirectionPlan> plan, control_plan;
  SensitivityRequest plan_request;
  long plan_version = -1, control_version = -1;
  long plan_count = 0;  // plans made so far
  SensitivityBuffers buffers, control_buffers;
  mutable std::vector<double> row;  // of directions, scratch
};

}  // namespace rg::sim
