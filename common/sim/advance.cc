// One control interval with a held command: model predictive control and the simulated robot.
#include <algorithm>
#include <cmath>

#include "common/base/check.h"
#include "common/sim/simulator_impl.h"

namespace rg::sim {
namespace {

constexpr double kSlack = 0.05;  // s of history kept beyond the longest delay

// Average over [begin, end] of the pieces (the first one holds before, too), then `now` from `start` on.
double PieceAverage(const std::vector<CommandHistory::Piece>& pieces, int joint, double start, double now,
                    double begin, double end) {
  double sum = 0.0, upper = end;
  if (upper > start) {
    const double from = std::max(begin, start);
    sum += now * (upper - from);
    upper = std::min(upper, start);
  }
  for (size_t k = pieces.size(); k-- > 0 && upper > begin;) {
    const double from = k == 0 ? begin : std::max(begin, pieces[k].begin);
    if (from < upper) {
      sum += pieces[k].u[joint] * (upper - from);
      upper = from;
    }
  }
  if (upper > begin) sum += now * (upper - begin);  // nothing is known of the past: the command was held
  return sum / (end - begin);
}

}  // namespace

Outcome Simulator::Advance(State& x, const Eigen::VectorXd& u, double duration,
                           Linearization* linearization) {
  Impl& s = *impl_;
  const internal::PlantData& d = s.data();
  RG_CHECK(u.size() == s.n() && duration > 0) << u.size() << " " << duration;
  s.x.Load(d, x, 0);
  s.step_count = 0;
  internal::DirectionPlan* plan = nullptr;
  if (linearization != nullptr) {
    plan = &s.ControlPlan();
    s.control_buffers.current = 0;
    plan->Start(s.control_buffers.layout, 0, &s.control_buffers.at[0]);
    std::fill_n(s.x.command_weights.doubles(), plan->commands().size(), 1.0);
  }
  SensitivityBuffers* buffers = plan == nullptr ? nullptr : &s.control_buffers;
  for (int j = 0; j < s.n(); ++j) s.x.command[d.kernel[j]] = u[j];
  const long steps = StepsFor(duration, s.options.step_s);
  const double h = duration / static_cast<double>(steps);
  for (long i = 0; i < steps; ++i) {
    const double t = x.time + static_cast<double>(i) * h;
    if (d.has_command_delay) {
      for (int j = 0; j < s.n(); ++j) {
        const double begin = t - s.Delay(j);
        s.x.command[d.kernel[j]] = PieceAverage(x.commands.pieces_, j, x.time, u[j], begin, begin + h);
        if (plan != nullptr) {
          const double share = (begin + h - std::max(begin, x.time)) / h;
          s.x.command_weights.doubles()[j] = x.commands.pieces_.empty() ? 1.0 : std::clamp(share, 0.0, 1.0);
        }
      }
    }
    for (const int j : d.prescribed) {
      const double now = s.x.v[d.kernel[j]];
      s.x.command[d.kernel[j]] = now + (u[j] - now) / static_cast<double>(steps - i);
    }
    const Outcome outcome = s.Step(t, h, plan, buffers);
    if (!outcome.ok()) return outcome;
  }
  if (d.has_command_delay) {
    double longest = 0.0;
    for (int j = 0; j < s.n(); ++j) longest = std::max(longest, s.Delay(j));
    RecordCommand(&x, u, x.time + duration - longest - kSlack);
  }
  if (d.has_sensor_delay) RecordState(&x, duration);
  s.x.Store(d, &x);
  x.time += duration;
  if (plan != nullptr) {
    const int n = s.n(), nx = 2 * n + d.num_internal_states();
    linearization->A.resize(nx, nx);
    linearization->B.resize(nx, n);
    int row = 0;
    s.control_buffers.ForEachStateRow(d, 0, [&](const internal::SensitivityRow& from) {
      for (int k = 0; k < nx; ++k) linearization->A(row, k) = from[k];
      for (int k = 0; k < n; ++k) linearization->B(row, k) = from[nx + k];
      ++row;
    });
  }
  return {};
}

// Appends the command of the interval that begins at x->time and drops what nobody looks back to.
void Simulator::RecordCommand(State* x, const Eigen::VectorXd& u, double oldest) {
  auto& pieces = x->commands.pieces_;
  size_t drop = 0;
  while (drop + 1 < pieces.size() && pieces[drop + 1].begin <= oldest) ++drop;
  if (drop > 0) {
    std::rotate(pieces.begin(), pieces.begin() + drop, pieces.end());
    // The dropped pieces' memory serves for the new one.
    pieces.resize(pieces.size() - drop + 1);
  } else {
    pieces.emplace_back();
  }
  pieces.back().begin = x->time;
  pieces.back().u = u;
}

// The state before the interval joins the history (x still holds it).
void Simulator::RecordState(State* x, double duration) {
  double longest = 0.0;
  for (int j = 0; j < impl_->n(); ++j) longest = std::max(longest, impl_->SensorDelay(j));
  auto& samples = x->states.samples_;
  const double oldest = x->time + duration - longest - kSlack;
  size_t drop = 0;
  while (drop + 2 < samples.size() && samples[drop + 1].time <= oldest) ++drop;
  if (drop > 0) {
    std::rotate(samples.begin(), samples.begin() + drop, samples.end());
    samples.resize(samples.size() - drop + 1);
  } else {
    samples.emplace_back();
  }
  samples.back().time = x->time;
  samples.back().q.resize(x->q.size());
  samples.back().v.resize(x->v.size());
  for (int j = 0; j < impl_->n(); ++j) {
    const int motor = impl_->data().sensors[j].motor_state;
    samples.back().q[j] = motor >= 0 ? x->z[motor] : x->q[j];
    samples.back().v[j] = motor >= 0 ? x->z[motor + 1] : x->v[j];
  }
}

void Simulator::Correct(State& x, const Eigen::VectorXd& dx) const {
  const int n = impl_->n();
  RG_CHECK(dx.size() == 2 * n + x.z.size());
  x.q += dx.head(n);
  x.v += dx.segment(n, n);
  x.z += dx.tail(x.z.size());
  for (StateHistory::Sample& past : x.states.samples_) {
    for (int j = 0; j < n; ++j) {
      const int motor = impl_->data().sensors[j].motor_state;
      const double dq = motor >= 0 ? dx[2 * n + motor] : dx[j],
                   dv = motor >= 0 ? dx[2 * n + motor + 1] : dx[n + j];
      past.q[j] += dq - (x.time - past.time) * dv;
      past.v[j] += dv;
    }
  }
}

void Simulator::Measure(const State& x, Eigen::VectorXd* q, Eigen::VectorXd* v) const {
  const internal::PlantData& d = impl_->data();
  *q = x.q;
  *v = x.v;
  for (int j = 0; j < impl_->n(); ++j) {
    const internal::JointSensor& sensor = d.sensors[j];
    double now_q = x.q[j], now_v = x.v[j];
    if (sensor.motor_state >= 0) {
      now_q = x.z[sensor.motor_state];
      now_v = x.z[sensor.motor_state + 1];
    }
    double late_q = now_q, late_v = now_v;
    const double at = x.time - impl_->SensorDelay(j);
    if (sensor.delay >= 0 && at < x.time) {
      double t1 = x.time, q1 = now_q, v1 = now_v;
      const auto& samples = x.states.samples_;
      size_t k = samples.size();
      while (k > 0 && samples[k - 1].time > at) {
        --k;
        t1 = samples[k].time, q1 = samples[k].q[j], v1 = samples[k].v[j];
      }
      if (k == 0) {  // older than what is known: followed back
        late_q = q1 + v1 * (at - t1);
        late_v = v1;
      } else {
        const double h = t1 - samples[k - 1].time, r = (at - samples[k - 1].time) / h;
        const double q0 = samples[k - 1].q[j], v0 = samples[k - 1].v[j], r2 = r * r, r3 = r2 * r;
        late_q = (2 * r3 - 3 * r2 + 1) * q0 + h * (r3 - 2 * r2 + r) * v0 + (3 * r2 - 2 * r3) * q1 +
                 h * (r3 - r2) * v1;
        late_v = v0 + r * (v1 - v0);
      }
    }
    (*q)[j] = (sensor.delays_position ? late_q : now_q) + impl_->Offset(j);
    (*v)[j] = sensor.delays_velocity ? late_v : now_v;
  }
}

}  // namespace rg::sim
