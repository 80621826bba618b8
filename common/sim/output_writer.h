// Writes measured outputs and their sensitivities of one window. Private to this folder.
#pragma once

#include <optional>
#include <vector>

#include "common/sim/simulator_impl.h"

namespace rg::sim {

// Lives through one window, which runs in one lane of `x`. Without a plan no sensitivities; `buffers` then
// null. A delayed sensor reads between a step's two ends: the steps must alternate between the buffers' sets.
class OutputWriter {
 public:
  OutputWriter(const Simulator::Impl& impl, const KernelState& x, int lane,
               const internal::DirectionPlan* plan, const SensitivityBuffers* buffers, double start,
               const std::vector<double>& times, bool derivatives_at_end, Trajectory* out);

  // Whether output k is written with its sensitivities.
  bool Derived(int k) const {
    return plan_ != nullptr && (!at_end_ || k + 1 == static_cast<int>(times_.size()));
  }

  // After the step [begin, begin + h]: samples of delayed sensors that fall into it.
  void AfterStep(double begin, double h);
  // At output time k, which is the present time.
  void AtOutput(int k);
  // The same before any step: delayed sensors that have not looked back yet do so with x0's velocity alone,
  // until the first step knows the acceleration and AfterStep writes them anew.
  void AtStart(int k);

  void SetLane(int lane) { lane_ = lane; }

  // The next sample of joint j, the one `ahead` after it, …: where it is of before the start, the time it is
  // of.
  struct Past {
    double at;
    bool derived;
  };
  std::optional<Past> Earlier(int j, int ahead = 0) const;
  // The next sample, after a trial step of h from the start under the mean command of [at, start]; `at_once`:
  // the velocity after the same step under the command at `at`, which is what enters as `at` moves (read
  // where the sample is derived).
  void Before(int j, double at, double h, double at_once);
  double EndVelocity(int j) const { return Ends(j, false).v; }

  void Finish();

 private:
  // A value as a combination of position and velocity at a step's two ends.
  struct Blend {
    double q0 = 0, v0 = 0, q1 = 0, v1 = 0;
  };
  struct State {
    double q, v;
  };
  static Blend PositionAt(double s, double h);
  static Blend VelocityAt(double s) { return {0, 1 - s, 0, s}; }
  static Blend Slope(double s, double h, bool position);

  bool Writes(const internal::JointSensor& sensor, bool position, bool delayed) const;
  void Sample(int j, int k, double s, double h, bool delayed);
  void SampleBefore(int j, int k, double offset);
  State Ends(int j, bool begin) const;
  double Value(int j, const Blend& b) const;
  const double* DirectionRow(int j, const Blend& b);
  void Write(int j, int k, const Blend& blend, bool position, const Blend& slope);
  // Of output k and joint j in the sensitivities.
  Eigen::Index Row(int j, int k) const {
    return (at_end_ ? 0 : static_cast<Eigen::Index>(k) * impl_.n()) + j;
  }

  const Simulator::Impl& impl_;
  const KernelState& x_;
  int lane_;
  const internal::DirectionPlan* plan_;
  const SensitivityBuffers* buffers_;
  double start_;
  const std::vector<double>& times_;
  bool at_end_;
  Trajectory* out_;
  int next_[integrators::kMaxJoints];
  double* row_;  // of directions
};

}  // namespace rg::sim
