#include "common/sim/output_writer.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rg::sim {

OutputWriter::OutputWriter(const Simulator::Impl& impl, const KernelState& x, int lane,
                           const internal::DirectionPlan* plan, const SensitivityBuffers* buffers,
                           double start, const std::vector<double>& times, bool derivatives_at_end,
                           Trajectory* out)
    : impl_(impl),
      x_(x),
      lane_(lane),
      plan_(plan),
      buffers_(buffers),
      start_(start),
      times_(times),
      at_end_(derivatives_at_end),
      out_(out),
      row_(impl.row.data()) {
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
  const Eigen::Index derived = at_end_ ? std::min<Eigen::Index>(1, count) : count;
  out->dposition.setZero(n * derived, columns);
  out->dvelocity.setZero(n * derived, columns);
  out->dfinal_state.setZero(columns == 0 ? 0 : out->state.rows(), columns);
  for (int& next : next_) next = 0;
}

void OutputWriter::AfterStep(double begin, double h) {
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

void OutputWriter::AtOutput(int k) {
  for (int j = 0; j < impl_.n(); ++j) Sample(j, k, 1.0, 0.0, false);
  x_.StoreStacked(impl_.data(), lane_,
                  out_->state.data() + static_cast<Eigen::Index>(k) * out_->state.rows());
  out_->reached = k + 1;
}

void OutputWriter::AtStart(int k) {
  AtOutput(k);
  if (!impl_.data().has_sensor_delay) return;
  for (int j = 0; j < impl_.n(); ++j) {
    if (impl_.data().sensors[j].delay < 0 || next_[j] > k) continue;
    SampleBefore(j, k, times_[k] - impl_.SensorDelay(j) - start_);
  }
}

std::optional<OutputWriter::Past> OutputWriter::Earlier(int j, int ahead) const {
  const int k = next_[j] + ahead;
  if (impl_.data().sensors[j].delay < 0 || k >= static_cast<int>(times_.size())) return {};
  const double at = times_[k] - impl_.SensorDelay(j);
  return at < start_ ? std::optional<Past>({at, Derived(k)}) : std::nullopt;
}

void OutputWriter::Before(int j, double at, double h, double at_once) {
  const internal::JointSensor& sensor = impl_.data().sensors[j];
  const int k = next_[j]++;
  Sample(j, k, (at - start_) / h, h, true);
  const int column = Derived(k) ? plan_->OutputColumn(sensor.delay) : -1;
  if (column < 0) return;
  const double change = (at_once - EndVelocity(j)) / h;
  const Eigen::Index row = Row(j, k);
  if (sensor.delays_position) out_->dposition(row, column) -= 0.5 * (at - start_) * change;
  if (sensor.delays_velocity) out_->dvelocity(row, column) -= change;
}

void OutputWriter::Finish() {
  if (plan_ == nullptr) return;
  Eigen::Index row = 0;
  buffers_->ForEachStateRow(impl_.data(), lane_, [&](const internal::SensitivityRow& from) {
    for (int c = 0; c < plan_->num_directions(); ++c) row_[c] = from[c];
    plan_->Combine(row_, out_->dfinal_state.row(row++).data());
  });
}

// Cubic Hermite interpolation over a step of length h at s ∈ [0, 1]; before the step (s < 0, only before
// the whole simulation) the motion is followed back with the step's mean acceleration (v1 − v0)/h.
OutputWriter::Blend OutputWriter::PositionAt(double s, double h) {
  if (s < 0) return {1, h * (s - 0.5 * s * s), 0, 0.5 * h * s * s};
  const double s2 = s * s, s3 = s2 * s;
  return {2 * s3 - 3 * s2 + 1, h * (s3 - 2 * s2 + s), 3 * s2 - 2 * s3, h * (s3 - s2)};
}

// Time derivative of the interpolant.
OutputWriter::Blend OutputWriter::Slope(double s, double h, bool position) {
  if (!position) return {0, -1 / h, 0, 1 / h};
  if (s < 0) return {0, 1 - s, 0, s};
  return {6 * (s * s - s) / h, 3 * s * s - 4 * s + 1, 6 * (s - s * s) / h, 3 * s * s - 2 * s};
}

// Which of the two outputs of a joint are written now: the delayed or the others.
bool OutputWriter::Writes(const internal::JointSensor& sensor, bool position, bool delayed) const {
  const bool is_delayed = sensor.delay >= 0 && (position ? sensor.delays_position : sensor.delays_velocity);
  return is_delayed == delayed;
}

void OutputWriter::Sample(int j, int k, double s, double h, bool delayed) {
  const internal::JointSensor& sensor = impl_.data().sensors[j];
  const bool now = !delayed;
  const Blend position = now ? Blend{0, 0, 1, 0} : PositionAt(s, h);
  const Blend velocity = now ? Blend{0, 0, 0, 1} : VelocityAt(s);
  if (Writes(sensor, true, delayed)) Write(j, k, position, true, now ? Blend{} : Slope(s, h, true));
  if (Writes(sensor, false, delayed)) Write(j, k, velocity, false, now ? Blend{} : Slope(s, h, false));
}

// Before the first step only the present (the begin) is known; offset ≤ 0 is followed back.
void OutputWriter::SampleBefore(int j, int k, double offset) {
  const internal::JointSensor& sensor = impl_.data().sensors[j];
  if (Writes(sensor, true, true)) Write(j, k, {0, 0, 1, offset}, true, {0, 0, 0, 1});
  if (Writes(sensor, false, true)) Write(j, k, {0, 0, 0, 1}, false, {});
}

OutputWriter::State OutputWriter::Ends(int j, bool begin) const {
  const int motor = impl_.data().sensors[j].motor_state, k = impl_.data().kernel[j];
  const auto at = [&](const double* x, int i) { return x[i * x_.lanes + lane_]; };
  if (motor >= 0) {
    const double* z = begin ? x_.begin_z : x_.z;
    return {at(z, motor), at(z, motor + 1)};
  }
  return begin ? State{at(x_.begin_q, k), at(x_.begin_v, k)} : State{at(x_.q, k), at(x_.v, k)};
}

double OutputWriter::Value(int j, const Blend& b) const {
  const State end = Ends(j, false);
  double value = (b.q1 != 0 ? b.q1 * end.q : 0.0) + (b.v1 != 0 ? b.v1 * end.v : 0.0);
  if (b.q0 != 0 || b.v0 != 0) {
    const State begin = Ends(j, true);
    value += b.q0 * begin.q + b.v0 * begin.v;
  }
  return value;
}

// Σ weight · row of the sensitivities, in directions.
const double* OutputWriter::DirectionRow(int j, const Blend& b) {
  const internal::PlantData& d = impl_.data();
  const int count = plan_->num_directions(), motor = d.sensors[j].motor_state, k = d.kernel[j];
  const int row = motor >= 0 ? 2 + motor - d.program.joints[k].first_state : 0;
  std::fill_n(row_, count, 0.0);
  const auto add = [&](int which, double by_q, double by_v) {
    const internal::SensitivityRow q = buffers_->Row(which, row, k, lane_);
    const internal::SensitivityRow v = buffers_->Row(which, row + 1, k, lane_);
    for (int c = 0; c < count; ++c) row_[c] += by_q * q[c] + by_v * v[c];
  };
  add(buffers_->current, b.q1, b.v1);
  if (b.q0 != 0 || b.v0 != 0) add(1 - buffers_->current, b.q0, b.v0);
  return row_;
}

void OutputWriter::Write(int j, int k, const Blend& blend, bool position, const Blend& slope) {
  const internal::JointSensor& sensor = impl_.data().sensors[j];
  const double offset = position ? impl_.Offset(j) : 0.0;
  (position ? out_->position : out_->velocity)(j, k) = Value(j, blend) + offset;
  if (!Derived(k)) return;
  double* target = (position ? out_->dposition : out_->dvelocity).row(Row(j, k)).data();
  plan_->Combine(DirectionRow(j, blend), target);
  const int offset_column = plan_->OutputColumn(sensor.offset);
  if (position && offset_column >= 0) target[offset_column] += 1.0;
  const int delay_column = plan_->OutputColumn(sensor.delay);
  const bool is_delayed = !Writes(sensor, position, false);
  if (delay_column >= 0 && is_delayed) target[delay_column] -= Value(j, slope);
}

}  // namespace rg::sim
