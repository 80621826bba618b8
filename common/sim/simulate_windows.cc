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
  SensitivityBuffers buffers;  // the steps work in place
  long version = -1;           // of the parameters in scratch
  long plan_count = -1;        // of the plan that the buffers are for
};

void DeleteLaneRunner::operator()(LaneRunner* runner) const { delete runner; }

namespace {

// The window in one lane: which step comes next.
class Lane {
 public:
  bool busy() const { return writer_.has_value(); }
  int window() const { return window_; }
  double t() const { return begin_ + static_cast<double>(step_) * h_; }
  double h() const { return h_; }

  // False where the window ends where it begins.
  bool Start(int window, const SimulationWindow& run, double step_s, OutputWriter writer) {
    window_ = window;
    run_ = &run;
    step_s_ = step_s;
    begin_ = run.x0.time;
    writer_.emplace(std::move(writer));
    output_ = 0;
    const std::vector<double>& times = *run.times;
    for (; output_ < times.size() && times[output_] - begin_ <= 0; ++output_) {
      writer_->AtStart(static_cast<int>(output_));
    }
    return NextInterval();
  }
  // After the step; false where the window has ended.
  bool Advance() {
    if (++step_ < steps_) return true;
    begin_ = (*run_->times)[output_];
    for (; output_ < run_->times->size() && (*run_->times)[output_] <= begin_; ++output_) {
      writer_->AtOutput(static_cast<int>(output_));
    }
    return NextInterval();
  }
  void Stop() { writer_.reset(); }

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
  std::optional<OutputWriter> writer_;
  double step_s_ = 0, begin_ = 0, h_ = 1e-3;
  size_t output_ = 0;
  long step_ = 0, steps_ = 0;
};

}  // namespace

LaneRunner* Simulator::Impl::Lanes() {
  const integrators::StepKernels* found =
      integrators::GetLaneStepKernels(data().program, options.isa);
  if (found == nullptr || options.integrator == Integrator::kRk4 || data().has_sensor_delay) return nullptr;
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
  const bool side_by_side =
      found != nullptr && impl_->options.integrator != Integrator::kRk4 && !impl_->data().has_sensor_delay;
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
  LaneRunner* runner = s.Lanes();
  if (runner == nullptr) {
    for (size_t k = 0; k < windows.size(); ++k) {
      SimulateInto(windows[k].x0, *windows[k].command, *windows[k].times, request, &(*out)[k]);
    }
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
  std::vector<Lane> lanes(count);
  std::vector<int> alone;  // windows that did not get through side by side
  size_t next = 0;
  const auto refill = [&](int lane) {
    while (next < windows.size()) {
      const auto k = static_cast<int>(next++);
      const SimulationWindow& w = windows[k];
      r.x.LoadStart(d, w.x0, *w.command, lane);
      if (plan != nullptr) plan->Start(r.buffers.layout, lane, &r.buffers.at[0]);
      OutputWriter writer(s, r.x, lane, plan, plan == nullptr ? nullptr : &r.buffers, w.x0.time, *w.times,
                          &(*out)[k]);
      if (lanes[lane].Start(k, w, s.options.step_s, std::move(writer))) return;
    }
    // Nothing to do: a state at rest that is stepped along.
    r.x.Clear(lane);
    if (plan != nullptr) plan->Start(r.buffers.layout, lane, &r.buffers.at[0]);
  };
  for (int lane = 0; lane < count; ++lane) refill(lane);
  static const integrators::Sensitivity kNone{};
  const integrators::Sensitivity& columns = plan == nullptr ? kNone : r.buffers.at[0];
  while (std::any_of(lanes.begin(), lanes.end(), [](const Lane& lane) { return lane.busy(); })) {
    for (int lane = 0; lane < count; ++lane) {
      r.t()[lane] = lanes[lane].busy() ? lanes[lane].t() : 0.0;
      r.h()[lane] = lanes[lane].h();
      if (!lanes[lane].busy()) continue;
      s.SetCommands(*windows[lanes[lane].window()].command, r.t()[lane], r.h()[lane], plan, lane, &r.x);
    }
    const integrators::StepInput input{
        r.x.q, r.x.v, r.x.z, r.t(), r.h(), r.x.command, r.x.command_weights.doubles()};
    const integrators::StepOutput output{r.x.next_q, r.x.next_v, r.x.next_z};
    const integrators::StepResult result =
        r.step(d.program, s.kernel_values, input, plan == nullptr ? nullptr : &plan->directions(),
               r.buffers.direct, columns, columns, output, r.scratch.data());
    r.x.Shift();
    for (int lane = 0; lane < count; ++lane) {
      if (!lanes[lane].busy()) {
        r.x.Clear(lane);
      } else if (result.failed >> lane & 1u) {
        alone.push_back(lanes[lane].window());
        lanes[lane].Stop();
        refill(lane);
      } else {
        r.x.SetGiven(d, *windows[lanes[lane].window()].command, r.t()[lane] + r.h()[lane], lane);
        if (!lanes[lane].Advance()) refill(lane);
      }
    }
  }
  // Steps that have to be halved, and failures, which are to be told exactly.
  for (const int k : alone) {
    SimulateInto(windows[k].x0, *windows[k].command, *windows[k].times, request, &(*out)[k]);
  }
}

}  // namespace rg::sim
