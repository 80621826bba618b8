// Runs over recorded commands: measured outputs and their sensitivities at given times.
#include <algorithm>
#include <cmath>
#include <optional>

#include "common/base/check.h"
#include "common/sim/output_writer.h"
#include "common/sim/simulator_impl.h"

namespace rg::sim {

long StepsFor(double duration, double limit) {
  return std::max(1L, static_cast<long>(std::ceil(duration / limit - 1e-9)));
}

namespace {

void SetCommands(Simulator::Impl& s, const CommandSignal& signal, double t, double h,
                 const internal::DirectionPlan* plan) {
  s.SetCommands(signal, t, h, plan, 0, &s.x);
}

// What late sensors say of the time before the start: the motion followed back under the commands of then.
void LookBack(Simulator::Impl& s, const State& x0, const CommandSignal& signal, internal::DirectionPlan* plan,
              OutputWriter* writer) {
  if (!s.data().has_sensor_delay) return;
  const double h = s.options.step_s;
  SensitivityBuffers* buffers = plan == nullptr ? nullptr : &s.buffers;
  const auto restart = [&] {
    s.x.LoadStart(s.data(), x0, signal, 0);
    s.step_count = 0;
    s.buffers.current = 0;
    if (plan != nullptr) plan->Start(s.buffers.layout, 0, &s.buffers.at[0]);
  };
  for (int j = 0; j < s.n(); ++j) {
    for (auto past = writer->Earlier(j); past; past = writer->Earlier(j)) {
      bool ok = true;
      double at_once = 0;
      if (past->derived) {
        SetCommands(s, signal, past->at, 1e-9, nullptr);
        ok = s.Step(x0.time, h, nullptr, nullptr).ok();
        at_once = writer->EndVelocity(j);
        restart();
      }
      internal::DirectionPlan* with = past->derived ? plan : nullptr;
      SetCommands(s, signal, past->at, x0.time - past->at, with);
      ok = ok && s.Step(x0.time, h, with, with == nullptr ? nullptr : buffers).ok();
      if (ok) writer->Before(j, past->at, h, at_once);
      restart();
      if (!ok) return;
    }
  }
}

}  // namespace

void Simulator::Impl::SetCommands(const CommandSignal& signal, double t, double h,
                                  const internal::DirectionPlan* p, int lane, KernelState* to) const {
  const internal::PlantData& d = data();
  for (int j = 0; j < n(); ++j) {
    const double from = t - Delay(j);
    to->command[d.kernel[j] * to->lanes + lane] = signal.Average(j, from, from + h);
  }
  for (size_t i = 0; i < d.prescribed.size(); ++i) {
    to->command[d.kernel[d.prescribed[i]] * to->lanes + lane] =
        signal.motion()->At(static_cast<int>(i), t + h).v;
  }
  if (p == nullptr) return;
  double* weight = to->command_weights.doubles() + lane;
  for (const auto& command : p->commands()) {
    const auto j =
        static_cast<int>(std::find(d.kernel.begin(), d.kernel.end(), command.joint) - d.kernel.begin());
    const double from = t - Delay(j);
    *weight = (signal.At(j, from) - signal.At(j, from + h)) / h;
    weight += to->lanes;
  }
}

Trajectory Simulator::Simulate(const State& x0, const CommandSignal& command,
                               const std::vector<double>& times, const SensitivityRequest& request) {
  Trajectory out;
  SimulateInto(x0, command, times, request, &out);
  return out;
}

void Simulator::SimulateInto(const State& x0, const CommandSignal& signal, const std::vector<double>& times,
                             const SensitivityRequest& request, Trajectory* out) {
  impl_->Simulate(x0, signal, times, request, false, out);
}

void Simulator::Impl::Simulate(const State& x0, const CommandSignal& signal, const std::vector<double>& times,
                               const SensitivityRequest& request, bool derivatives_at_end, Trajectory* out) {
  RG_CHECK(signal.num_joints() == n()) << signal.num_joints() << " commands for " << n() << " joints";
  RG_CHECK(std::is_sorted(times.begin(), times.end()) && (times.empty() || times[0] >= x0.time - 1e-9));
  x.LoadStart(data(), x0, signal, 0);
  step_count = 0;
  internal::DirectionPlan* plan = nullptr;
  if (request.any()) {
    plan = &PlanFor(request);
    buffers.current = 0;
    plan->Start(buffers.layout, 0, &buffers.at[0]);
  }
  SensitivityBuffers* used = plan == nullptr ? nullptr : &buffers;
  OutputWriter writer(*this, x, 0, plan, used, x0.time, times, derivatives_at_end, out);
  // An output at the start alone is Measure's: it asks for no motion.
  if (!times.empty() && times.back() > x0.time) LookBack(*this, x0, signal, plan, &writer);
  double time = x0.time;
  for (size_t k = 0; k < times.size(); ++k) {
    const double duration = times[k] - time;
    if (duration <= 0) {
      writer.AtStart(static_cast<int>(k));
      continue;
    }
    const long steps = StepsFor(duration, options.step_s);
    const double h = duration / static_cast<double>(steps);
    for (long i = 0; i < steps; ++i) {
      const double t = time + static_cast<double>(i) * h;
      SetCommands(signal, t, h, plan, 0, &x);
      out->outcome = Step(t, h, plan, used);
      if (!out->outcome.ok()) return;
      x.SetGiven(data(), signal, t + h, 0);
      writer.AfterStep(t, h);
    }
    time = times[k];
    writer.AtOutput(static_cast<int>(k));
  }
  writer.Finish();
}

}  // namespace rg::sim
