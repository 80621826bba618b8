// Runs over recorded commands: measured outputs and their sensitivities at given times.
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "common/base/check.h"
#include "common/sim/simulator_impl.h"

namespace rg::sim {
namespace {

// Equal steps not longer than `limit`; a part in 10⁹ of slack for times that are sums.
long StepsFor(double duration, double limit) {
  return std::max(1L, static_cast<long>(std::ceil(duration / limit - 1e-9)));
}

// A value as a combination of position and velocity at a step's two ends.
struct Blend {
  double q0 = 0, v0 = 0, q1 = 0, v1 = 0;
};

// Cubic Hermite interpolation over a step of length h at s ∈ [0, 1]; before the step (s < 0, only before
// the whole simulation) the motion is followed back with the step's mean acceleration (v1 − v0)/h.
Blend PositionAt(double s, double h) {
  if (s < 0) return {1, h * (s - 0.5 * s * s), 0, 0.5 * h * s * s};
  const double s2 = s * s, s3 = s2 * s;
  return {2 * s3 - 3 * s2 + 1, h * (s3 - 2 * s2 + s), 3 * s2 - 2 * s3, h * (s3 - s2)};
}
Blend VelocityAt(double s) { return {0, 1 - s, 0, s}; }

}  // namespace

// Writes measured outputs. Lives through one Simulate.
class OutputWriter {
 public:
  OutputWriter(Simulator::Impl& impl, internal::DirectionPlan* plan, double start,
               const std::vector<double>& times, Trajectory* out)
      : impl_(impl), plan_(plan), start_(start), times_(times), out_(out) {
    out->times = times;
    const auto n = static_cast<Eigen::Index>(impl.n());
    const auto count = static_cast<Eigen::Index>(times.size());
    constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
    out->position.setConstant(n, count, kNaN);
    out->velocity.setConstant(n, count, kNaN);
    out->state.setConstant(2 * n + impl.data().num_internal_states(), count, kNaN);
    out->outcome = {};
    out->reached = 0;
    const Eigen::Index columns = plan == nullptr ? 0 : plan->num_columns();
    out->dposition.setZero(n * count, columns);
    out->dvelocity.setZero(n * count, columns);
    out->dfinal_state.setZero(columns == 0 ? 0 : out->state.rows(), columns);
    for (int& next : next_) next = 0;
  }

  // After the step [begin, begin + h]: samples of delayed sensors that fall into it.
  void AfterStep(double begin, double h) {
    if (!impl_.data().has_sensor_delay) return;
    for (int j = 0; j < impl_.n(); ++j) {
      const double delay = impl_.SensorDelay(j);
      if (impl_.data().sensors[j].delay < 0) continue;
      while (next_[j] < static_cast<int>(times_.size())) {
        const double at = times_[next_[j]] - delay;
        if (at > begin + h * (1 + 1e-9)) break;
        const double s = at < start_ ? (at - begin) / h : std::clamp((at - begin) / h, 0.0, 1.0);
        Sample(j, next_[j]++, s, h, true);
      }
    }
  }

  // At output time k, which is the present time; `h` and `begin` are those of the step that led here
  // (h = 0 before the first).
  void AtOutput(int k) {
    for (int j = 0; j < impl_.n(); ++j) Sample(j, k, 1.0, 0.0, false);
    impl_.StoreStacked(out_->state.data() + static_cast<Eigen::Index>(k) * out_->state.rows());
    out_->reached = k + 1;
  }
  // The same before any step: delayed sensors that have not looked back yet do so with x0's velocity alone,
  // until the first step knows the acceleration and AfterStep writes them anew.
  void AtStart(int k) {
    AtOutput(k);
    if (!impl_.data().has_sensor_delay) return;
    for (int j = 0; j < impl_.n(); ++j) {
      if (impl_.data().sensors[j].delay < 0 || next_[j] > k) continue;
      SampleBefore(j, k, times_[k] - impl_.SensorDelay(j) - start_);
    }
  }

  // The next sample of joint j, where it is of before the start: the time it is of.
  std::optional<double> Earlier(int j) const {
    if (impl_.data().sensors[j].delay < 0 || next_[j] >= static_cast<int>(times_.size())) return {};
    const double at = times_[next_[j]] - impl_.SensorDelay(j);
    return at < start_ ? std::optional<double>(at) : std::nullopt;
  }
  // That sample, after a trial step of h from the start under the mean command of [at, start]; `at_once`:
  // the velocity after the same step under the command at `at`, which is what enters as `at` moves.
  void Before(int j, double at, double h, double at_once) {
    const internal::JointSensor& sensor = impl_.data().sensors[j];
    const int k = next_[j]++;
    Sample(j, k, (at - start_) / h, h, true);
    const int column = plan_ == nullptr ? -1 : plan_->OutputColumn(sensor.delay);
    if (column < 0) return;
    const double change = (at_once - EndVelocity(j)) / h;
    const Eigen::Index row = static_cast<Eigen::Index>(k) * impl_.n() + j;
    if (sensor.delays_position) out_->dposition(row, column) -= 0.5 * (at - start_) * change;
    if (sensor.delays_velocity) out_->dvelocity(row, column) -= change;
  }
  double EndVelocity(int j) const { return *ValueRows(j, false).v; }

  void Finish() {
    if (plan_ == nullptr) return;
    const internal::PlantData& d = impl_.data();
    const integrators::Sensitivity& s = impl_.buffers.at[impl_.buffers.current];
    const int stride = plan_->directions().stride;
    Eigen::Index row = 0;
    auto write = [&](const double* from) {
      plan_->Combine(from, out_->dfinal_state.row(row).data());
      ++row;
    };
    for (int j = 0; j < impl_.n(); ++j) write(s.q + (d.first_joint + j) * stride);
    for (int j = 0; j < impl_.n(); ++j) write(s.v + (d.first_joint + j) * stride);
    for (int k = 0; k < d.program.num_states; ++k) write(s.z + k * stride);
    for (const int k : d.extra_joints) {
      write(s.q + k * stride);
      write(s.v + k * stride);
    }
  }

 private:
  // Which of the two outputs of a joint are written now: the delayed or the others.
  bool Writes(const internal::JointSensor& sensor, bool position, bool delayed) const {
    const bool is_delayed = sensor.delay >= 0 && (position ? sensor.delays_position : sensor.delays_velocity);
    return is_delayed == delayed;
  }

  void Sample(int j, int k, double s, double h, bool delayed) {
    const internal::JointSensor& sensor = impl_.data().sensors[j];
    const bool now = !delayed;
    const Blend position = now ? Blend{0, 0, 1, 0} : PositionAt(s, h);
    const Blend velocity = now ? Blend{0, 0, 0, 1} : VelocityAt(s);
    if (Writes(sensor, true, delayed)) Write(j, k, position, true, now ? Blend{} : Slope(s, h, true));
    if (Writes(sensor, false, delayed)) Write(j, k, velocity, false, now ? Blend{} : Slope(s, h, false));
  }
  // Before the first step only the present (the begin) is known; offset ≤ 0 is followed back.
  void SampleBefore(int j, int k, double offset) {
    const internal::JointSensor& sensor = impl_.data().sensors[j];
    if (Writes(sensor, true, true)) Write(j, k, {0, 0, 1, offset}, true, {0, 0, 0, 1});
    if (Writes(sensor, false, true)) Write(j, k, {0, 0, 0, 1}, false, {});
  }
  // Time derivative of the interpolant.
  static Blend Slope(double s, double h, bool position) {
    if (!position) return {0, -1 / h, 0, 1 / h};
    if (s < 0) return {0, 1 - s, 0, s};
    return {6 * (s * s - s) / h, 3 * s * s - 4 * s + 1, 6 * (s - s * s) / h, 3 * s * s - 2 * s};
  }

  struct Rows {
    const double *q, *v;
  };
  Rows ValueRows(int j, bool begin) const {
    const int motor = impl_.data().sensors[j].motor_state, k = impl_.data().first_joint + j;
    if (motor >= 0) {
      const auto& z = begin ? impl_.begin_z : impl_.z;
      return {&z[motor], &z[motor + 1]};
    }
    return begin ? Rows{&impl_.begin_q[k], &impl_.begin_v[k]} : Rows{&impl_.q[k], &impl_.v[k]};
  }
  double Value(int j, const Blend& b) const {
    const Rows end = ValueRows(j, false);
    double value = (b.q1 != 0 ? b.q1 * *end.q : 0.0) + (b.v1 != 0 ? b.v1 * *end.v : 0.0);
    if (b.q0 != 0 || b.v0 != 0) {
      const Rows begin = ValueRows(j, true);
      value += b.q0 * *begin.q + b.v0 * *begin.v;
    }
    return value;
  }
  // Σ weight · row of the sensitivities, in directions.
  const double* DirectionRow(int j, const Blend& b) {
    const int stride = plan_->directions().stride;
    const internal::PlantData& d = impl_.data();
    std::fill(impl_.begin_row.begin(), impl_.begin_row.end(), 0.0);
    auto add = [&](const integrators::Sensitivity& s, double by_q, double by_v) {
      const int motor = d.sensors[j].motor_state, k = d.first_joint + j;
      const double* q = motor >= 0 ? s.z + motor * stride : s.q + k * stride;
      const double* v = motor >= 0 ? s.z + (motor + 1) * stride : s.v + k * stride;
      for (int c = 0; c < stride; ++c) impl_.begin_row[c] += by_q * q[c] + by_v * v[c];
    };
    const SensitivityBuffers& buffers = impl_.buffers;
    add(buffers.at[buffers.current], b.q1, b.v1);
    if (b.q0 != 0 || b.v0 != 0) add(buffers.at[1 - buffers.current], b.q0, b.v0);
    return impl_.begin_row.data();
  }

  void Write(int j, int k, const Blend& blend, bool position, const Blend& slope) {
    const internal::JointSensor& sensor = impl_.data().sensors[j];
    const double offset = position ? impl_.Offset(j) : 0.0;
    (position ? out_->position : out_->velocity)(j, k) = Value(j, blend) + offset;
    if (plan_ == nullptr) return;
    const Eigen::Index row = static_cast<Eigen::Index>(k) * impl_.n() + j;
    double* target = (position ? out_->dposition : out_->dvelocity).row(row).data();
    plan_->Combine(DirectionRow(j, blend), target);
    const int offset_column = plan_->OutputColumn(sensor.offset);
    if (position && offset_column >= 0) target[offset_column] += 1.0;
    const int delay_column = plan_->OutputColumn(sensor.delay);
    const bool is_delayed = !Writes(sensor, position, false);
    if (delay_column >= 0 && is_delayed) target[delay_column] -= Value(j, slope);
  }

  Simulator::Impl& impl_;
  internal::DirectionPlan* plan_;
  double start_;
  const std::vector<double>& times_;
  Trajectory* out_;
  int next_[integrators::kMaxJoints];
};

namespace {

// Average commands over [t, t + h], and their derivative by the delays in the plan.
void SetCommands(Simulator::Impl& impl, const CommandSignal& signal, double t, double h,
                 internal::DirectionPlan* plan) {
  const internal::PlantData& d = impl.data();
  for (int j = 0; j < impl.n(); ++j) {
    const double delay = impl.Delay(j);
    impl.command[d.first_joint + j] = signal.Average(j, t - delay, t - delay + h);
  }
  if (plan == nullptr) return;
  for (auto& command : plan->commands()) {
    const int j = command.joint - d.first_joint;
    const double from = t - impl.Delay(j);
    command.weight = (signal.At(j, from) - signal.At(j, from + h)) / h;
  }
}

// What late sensors say of the time before the start: the motion followed back under the commands of then.
void LookBack(Simulator::Impl& s, const State& x0, const CommandSignal& signal, internal::DirectionPlan* plan,
              OutputWriter* writer) {
  if (!s.data().has_sensor_delay) return;
  const double h = s.options.step_s;
  SensitivityBuffers* buffers = plan == nullptr ? nullptr : &s.buffers;
  const auto restart = [&] {
    s.Load(x0);
    s.step_count = 0;
    s.buffers.current = 0;
    if (plan != nullptr) plan->Start(&s.buffers.at[0]);
  };
  for (int j = 0; j < s.n(); ++j) {
    for (auto at = writer->Earlier(j); at; at = writer->Earlier(j)) {
      SetCommands(s, signal, *at, 1e-9, nullptr);
      bool ok = s.Step(x0.time, h, nullptr, nullptr).ok();
      const double at_once = writer->EndVelocity(j);
      restart();
      SetCommands(s, signal, *at, x0.time - *at, plan);
      ok = ok && s.Step(x0.time, h, plan, buffers).ok();
      if (ok) writer->Before(j, *at, h, at_once);
      restart();
      if (!ok) return;
    }
  }
}

}  // namespace

Trajectory Simulator::Simulate(const State& x0, const CommandSignal& command,
                               const std::vector<double>& times, const SensitivityRequest& request) {
  Trajectory out;
  SimulateInto(x0, command, times, request, &out);
  return out;
}

void Simulator::SimulateInto(const State& x0, const CommandSignal& signal, const std::vector<double>& times,
                             const SensitivityRequest& request, Trajectory* out) {
  Impl& s = *impl_;
  RG_CHECK(signal.num_joints() == s.n()) << signal.num_joints() << " commands for " << s.n() << " joints";
  RG_CHECK(std::is_sorted(times.begin(), times.end()) && (times.empty() || times[0] >= x0.time - 1e-9));
  s.Load(x0);
  s.step_count = 0;
  internal::DirectionPlan* plan = nullptr;
  if (request.any()) {
    plan = &s.PlanFor(request);
    s.buffers.current = 0;
    plan->Start(&s.buffers.at[0]);
  }
  SensitivityBuffers* buffers = plan == nullptr ? nullptr : &s.buffers;
  OutputWriter writer(s, plan, x0.time, times, out);
  // An output at the start alone is Measure's: it asks for no motion.
  if (!times.empty() && times.back() > x0.time) LookBack(s, x0, signal, plan, &writer);
  double time = x0.time;
  for (size_t k = 0; k < times.size(); ++k) {
    const double duration = times[k] - time;
    if (duration <= 0) {
      writer.AtStart(static_cast<int>(k));
      continue;
    }
    const long steps = StepsFor(duration, s.options.step_s);
    const double h = duration / static_cast<double>(steps);
    for (long i = 0; i < steps; ++i) {
      const double t = time + static_cast<double>(i) * h;
      SetCommands(s, signal, t, h, plan);
      out->outcome = s.Step(t, h, plan, buffers);
      if (!out->outcome.ok()) return;
      writer.AfterStep(t, h);
    }
    time = times[k];
    writer.AtOutput(static_cast<int>(k));
  }
  writer.Finish();
}

}  // namespace rg::sim
