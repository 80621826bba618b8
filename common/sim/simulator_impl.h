// The simulator's workspace. Private to this folder.
#pragma once

#include <cstdlib>
#include <memory>
#include <optional>
#include <vector>

#include "common/integrators/step_kernel.h"
#include "common/sim/direction_plan.h"
#include "common/sim/parameter_values.h"
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

// Two sets of sensitivities between which the steps alternate, and what the kernels need beside.
struct SensitivityBuffers {
  AlignedBuffer memory;
  integrators::Sensitivity at[2];
  double* direct = nullptr;
  int current = 0;

  void Resize(const internal::PlantData& plant, int stride);
};

struct Simulator::Impl {
  Impl(const Plant& plant, const SimulatorOptions& options);

  const internal::PlantData& data() const { return plant.data(); }
  int n() const { return data().num_joints(); }

  // Kernel state from a State and back.
  void Load(const State& x);
  void Store(State* x) const;
  void StoreStacked(double* x) const;

  // One step of length h from time t; commands must be set. On success the state and, with a plan, the
  // sensitivities are those of the step's end; the state at its begin stays in begin_*.
  // Where the motion is too fast for h (a light wrist spinning freely at 100 rad/s), the step is halved, up
  // to kMaxHalvings times; the command keeps its average.
  Outcome Step(double t, double h, internal::DirectionPlan* plan, SensitivityBuffers* buffers);
  Outcome StepInParts(double t, double h, int halvings, internal::DirectionPlan* plan,
                      SensitivityBuffers* buffers);
  static constexpr int kMaxHalvings = 6;
  // A plan for this request with the present parameters; laid out anew only when the request changes.
  internal::DirectionPlan& PlanFor(const SensitivityRequest& request);
  internal::DirectionPlan& ControlPlan();
  void SetValues(const Eigen::VectorXd& values);

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

  // Kernel state, and that of the last step's begin.
  std::vector<double> q, v, z, begin_q, begin_v, begin_z, next_q, next_v, next_z, command;
  long step_count = 0;

  std::optional<internal::DirectionPlan> plan, control_plan;
  SensitivityRequest plan_request;
  long plan_version = -1, control_version = -1;
  SensitivityBuffers buffers, control_buffers;
  std::vector<double> row, begin_row;
};

}  // namespace rg::sim
