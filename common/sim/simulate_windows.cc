// Several windows side by side in SIMD lanes.
#include <algorithm>
#include <cmath>
#include <optional>

#include "common/base/check.h"
#include "common/sim/output_writer.h"
#include "common/sim/simulator_impl.h"

namespace rg::sim {

// The lanes' own kernels and memory.
struct LaneRunner {
  LaneRunner(const internal::PlantData& plant, const SimulatorOptions& options,
             const integrators::StepKernels& kernels)
      : kernels(kernels),
        step(options.integrator == Integrator::kLeapfrog ? kernels.leapfrog : kernels.semi_implicit_euler),
        x(plant, kernels.lanes) {
    scratch.Resize(kernels.scratch_bytes);
    clocks.Resize(2 * kernels.lanes * sizeof(double));
  }

  double* t() { return clocks.doubles(); }
  double* h() { return clocks.doubles() + kernels.lanes; }

  const integrators::StepKernels& kernels;
  integrators::StepFunction step;
  AlignedBuffer scratch, clocks;
  KernelState x;
  SensitivityBuffers buffers;  // where no sensor is late the steps work in place
  long version = -1;           // of the parameters in scratch
  long plan_count = -1;        // of the plan that the buffers are for
};

void DeleteLaneRunner::operator()(LaneRunner* runner) const { delete runner; }

namespace {

// The window in one lane: which step comes next.
class Lane {
 public:
  bool busy() const { return writer_ != nullptr; }
  int window() const { return window_; }
  double t() const { return begin_ + static_cast<double>(step_) * h_; }
  double h() const { return h_; }

  // False where the window ends where it begins.
  bool Start(int window, const SimulationWindow& run, double step_s, OutputWriter* writer) {
    window_ = window;
    run_ = &run;
    step_s_ = step_s;
    begin_ = run.x0.time;
    writer_ = writer;
    output_ = 0;
    const std::vector<double>& times = *run.times;
    for (; output_ < times.size() && times[output_] - begin_ <= 0; ++output_) {
      writer_->AtStart(static_cast<int>(output_));
    }
    return NextInterval();
  }
  // After the step; false where the window has ended.
  bool Advance() {
    writer_->AfterStep(t(), h_);
    if (++step_ < steps_) return true;
    begin_ = (*run_->times)[output_];
    for (; output_ < run_->times->size() && (*run_->times)[output_] <= begin_; ++output_) {
      writer_->AtOutput(static_cast<int>(output_));
    }
    return NextInterval();
  }
  void Stop() { writer_ = nullptr; }

 private:
  bool NextInterval() {
    if (output_ == run_->times->size()) {
      writer_->Finish();
      Stop();
      return false;
    }
    const double duration = (*run_->times)[output_] - begin_;
    steps_ = StepsFor(duration, step_s_);
    h_ = duration / static_cast<double>(steps_);
    step_ = 0;
    return true;
  }

  int window_ = -1;
  const SimulationWindow* run_ = nullptr;
  OutputWriter* writer_ = nullptr;
  double step_s_ = 0, begin_ = 0, h_ = 1e-3;
  size_t output_ = 0;
  long step_ = 0, steps_ = 0;
};

// One step of all lanes from their clocks and commands; bit k of the result: lane k failed.
unsigned StepLanes(const Simulator::Impl& s, const internal::DirectionPlan* plan, bool in_place,
                   LaneRunner* runner) {
  static const integrators::Sensitivity kNone{};
  LaneRunner& r = *runner;
  const int now = r.buffers.current, then = in_place ? now : 1 - now;
  const integrators::StepInput input{
      r.x.q, r.x.v, r.x.z, r.t(), r.h(), r.x.command, r.x.command_weights.doubles()};
  const integrators::StepOutput output{r.x.next_q, r.x.next_v, r.x.next_z};
  const integrators::StepResult result =
      r.step(s.data().program, s.kernel_values, input, plan == nullptr ? nullptr : &plan->directions(),
             r.buffers.direct, plan == nullptr ? kNone : r.buffers.at[now],
             plan == nullptr ? kNone : r.buffers.at[then], output, r.scratch.data());
  r.x.Shift();
  if (plan != nullptr) r.buffers.current = then;
  return result.failed;
}

// What late sensors say of the time before the start (LookBack in simulate.cc), all samples of all windows
// side by side. Writes which windows failed.
void LookBackSideBySide(const Simulator::Impl& s, const std::vector<SimulationWindow>& windows,
                        const internal::DirectionPlan* plan, LaneRunner* runner,
                        std::vector<OutputWriter>* writers, std::vector<char>* failed) {
  struct Look {
    size_t window;
    int joint;
    double at;
  };
  std::vector<Look> valued, derived;
  for (size_t w = 0; w < windows.size(); ++w) {
    const std::vector<double>& times = *windows[w].times;
    if (times.empty() || !(times.back() > windows[w].x0.time)) continue;
    for (int j = 0; j < s.n(); ++j) {
      for (int k = 0;; ++k) {
        const std::optional<OutputWriter::Past> past = (*writers)[w].Earlier(j, k);
        if (!past) break;
        (past->derived ? derived : valued).push_back({w, j, past->at});
      }
    }
  }
  LaneRunner& r = *runner;
  const auto count = static_cast<size_t>(r.kernels.lanes);
  std::vector<double> at_once(count, 0.0);
  const auto take = [&](const std::vector<Look>& looks, size_t first, const internal::DirectionPlan* derive) {
    const size_t some = std::min(count, looks.size() - first);
    const auto step = [&](const internal::DirectionPlan* with, auto span) {
      r.buffers.current = 0;
      for (size_t lane = 0; lane < count; ++lane) {
        const auto l = static_cast<int>(lane);
        r.t()[lane] = 0, r.h()[lane] = s.options.step_s;
        r.x.Clear(l);
        if (with != nullptr) with->Start(r.buffers.layout, l, &r.buffers.at[0]);
        if (lane >= some) continue;
        const Look& look = looks[first + lane];
        const SimulationWindow& w = windows[look.window];
        r.t()[lane] = w.x0.time;
        r.x.LoadStart(s.data(), w.x0, *w.command, l);
        s.SetCommands(*w.command, look.at, span(w, look), with, l, &r.x);
      }
      const unsigned bad = StepLanes(s, with, false, &r);
      for (size_t lane = 0; lane < some; ++lane)
        if (bad >> lane & 1u) (*failed)[looks[first + lane].window] = 1;
    };
    const auto each = [&](auto f) {
      for (size_t lane = 0; lane < some; ++lane) {
        const Look& look = looks[first + lane];
        OutputWriter& writer = (*writers)[look.window];
        writer.SetLane(static_cast<int>(lane));
        if (!(*failed)[look.window]) f(look, writer, &at_once[lane]);
      }
    };
    if (derive != nullptr) {
      step(nullptr, [](const SimulationWindow&, const Look&) { return 1e-9; });
      each([](const Look& look, OutputWriter& writer, double* v) { *v = writer.EndVelocity(look.joint); });
    }
    step(derive, [](const SimulationWindow& w, const Look& look) { return w.x0.time - look.at; });
    each([&](const Look& look, OutputWriter& writer, const double* v) {
      writer.Before(look.joint, look.at, s.options.step_s, *v);
    });
  };
  // A joint's derived samples are its latest.
  for (size_t first = 0; first < valued.size(); first += count) take(valued, first, nullptr);
  for (size_t first = 0; first < derived.size(); first += count) take(derived, first, plan);
  r.buffers.current = 0;
}

}  // namespace

LaneRunner* Simulator::Impl::Lanes() {
  const integrators::StepKernels* found = integrators::GetLaneStepKernels(data().program, options.isa);
  if (found == nullptr || options.integrator == Integrator::kRk4) return nullptr;
  if (!lanes) lanes.reset(new LaneRunner(data(), options, *found));
  if (lanes->version != version) {
    lanes->kernels.prepare(data().program, kernel_values, lanes->scratch.data());
    lanes->version = version;
  }
  return lanes.get();
}

int Simulator::lanes() const {
  const integrators::StepKernels* found =
      integrators::GetLaneStepKernels(impl_->data().program, impl_->options.isa);
  const bool side_by_side = found != nullptr && impl_->options.integrator != Integrator::kRk4;
  return side_by_side ? found->lanes : 1;
}

void Simulator::SimulateWindows(const std::vector<SimulationWindow>& windows,
                                const SensitivityRequest& request, std::vector<Trajectory>* out) {
  Impl& s = *impl_;
  out->resize(windows.size());
  for (const SimulationWindow& w : windows) {
    RG_CHECK(w.command->num_joints() == s.n()) << w.command->num_joints() << " commands";
    RG_CHECK(std::is_sorted(w.times->begin(), w.times->end()) &&
             (w.times->empty() || (*w.times)[0] >= w.x0.time - 1e-9));
  }
  const auto simulate = [&](size_t k) {
    const SimulationWindow& w = windows[k];
    s.Simulate(w.x0, *w.command, *w.times, request, w.derivatives_at_end, &(*out)[k]);
  };
  LaneRunner* runner = s.Lanes();
  if (runner == nullptr) {
    for (size_t k = 0; k < windows.size(); ++k) simulate(k);
    return;
  }
  LaneRunner& r = *runner;
  const internal::PlantData& d = s.data();
  const internal::DirectionPlan* plan = nullptr;
  if (request.any()) {
    plan = &s.PlanFor(request);
    if (r.plan_count != s.plan_count) {
      r.buffers.Resize({d.program, r.kernels}, plan->num_directions());
      r.x.command_weights.Resize((plan->commands().size() + 1) * r.kernels.lanes * sizeof(double));
      r.plan_count = s.plan_count;
    }
  }
  const int count = r.kernels.lanes;
  r.buffers.current = 0;
  std::vector<OutputWriter> writers;
  writers.reserve(windows.size());
  for (size_t k = 0; k < windows.size(); ++k) {
    writers.emplace_back(s, r.x, 0, plan, plan == nullptr ? nullptr : &r.buffers, windows[k].x0.time,
                         *windows[k].times, windows[k].derivatives_at_end, &(*out)[k]);
  }
  std::vector<char> failed(windows.size(), 0);  // did not get through side by side
  if (d.has_sensor_delay) LookBackSideBySide(s, windows, plan, &r, &writers, &failed);
  std::vector<Lane> lanes(count);
  size_t next = 0;
  const auto refill = [&](int lane) {
    while (next < windows.size()) {
      const auto k = static_cast<int>(next++);
      if (failed[k]) continue;
      const SimulationWindow& w = windows[k];
      r.x.LoadStart(d, w.x0, *w.command, lane);
      if (plan != nullptr) plan->Start(r.buffers.layout, lane, &r.buffers.at[r.buffers.current]);
      writers[k].SetLane(lane);
      if (lanes[lane].Start(k, w, s.options.step_s, &writers[k])) return;
    }
    // Nothing to do: a state at rest that is stepped along.
    r.x.Clear(lane);
    if (plan != nullptr) plan->Start(r.buffers.layout, lane, &r.buffers.at[r.buffers.current]);
  };
  for (int lane = 0; lane < count; ++lane) refill(lane);
  while (std::any_of(lanes.begin(), lanes.end(), [](const Lane& lane) { return lane.busy(); })) {
    for (int lane = 0; lane < count; ++lane) {
      r.t()[lane] = lanes[lane].busy() ? lanes[lane].t() : 0.0;
      r.h()[lane] = lanes[lane].h();
      if (!lanes[lane].busy()) continue;
      s.SetCommands(*windows[lanes[lane].window()].command, r.t()[lane], r.h()[lane], plan, lane, &r.x);
    }
    const unsigned bad = StepLanes(s, plan, !d.has_sensor_delay, &r);
    for (int lane = 0; lane < count; ++lane) {
      if (!lanes[lane].busy()) {
        r.x.Clear(lane);
      } else if (bad >> lane & 1u) {
        failed[lanes[lane].window()] = 1;
        lanes[lane].Stop();
        refill(lane);
      } else {
        r.x.SetGiven(d, *windows[lanes[lane].window()].command, r.t()[lane] + r.h()[lane], lane);
        if (!lanes[lane].Advance()) refill(lane);
      }
    }
  }
  // Steps that have to be halved, and failures, which are to be told exactly.
  for (size_t k = 0; k < windows.size(); ++k) {
    if (failed[k]) simulate(k);
  }
}

}  // namespace rg::sim
