#include "common/sim/simulator.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <tuple>
#include <utility>

#include "common/base/check.h"
#include "common/sim/simulator_impl.h"

namespace rg::sim {

using integrators::StepStatus;

void AlignedBuffer::Resize(size_t bytes) {
  bytes = (bytes + 63) / 64 * 64;
  if (bytes > bytes_) {
    data_.reset(std::aligned_alloc(64, bytes));
    bytes_ = bytes;
  }
  std::memset(data_.get(), 0, bytes_);
}

KernelState::KernelState(const internal::PlantData& plant, int lanes) : lanes(lanes) {
  const size_t joints = (static_cast<size_t>(plant.num_kernel_joints()) * lanes + 7) / 8 * 8;
  const size_t states = (static_cast<size_t>(plant.program.num_states) * lanes + 7) / 8 * 8;
  size = 7 * joints + 3 * states;
  memory.Resize(size * sizeof(double));
  double* next = memory.doubles();
  for (double** x : {&q, &v, &begin_q, &begin_v, &next_q, &next_v, &command}) *x = next, next += joints;
  for (double** x : {&z, &begin_z, &next_z}) *x = next, next += states;
}

void KernelState::Shift() {
  for (auto [present, begin, next] : {std::tuple(&q, &begin_q, &next_q), std::tuple(&v, &begin_v, &next_v),
                                      std::tuple(&z, &begin_z, &next_z)}) {
    std::swap(*begin, *present);
    std::swap(*present, *next);
  }
}

void KernelState::Clear(int lane) {
  // Joint arrays lie behind one another, then the states.
  for (double* p = memory.doubles() + lane; p < memory.doubles() + size; p += lanes) *p = 0.0;
}

void KernelState::Load(const internal::PlantData& d, const State& x, int lane) {
  const int n = d.num_joints();
  RG_CHECK(x.q.size() == n && x.v.size() == n && x.z.size() == d.num_internal_states())
      << x.q.size() << " " << x.v.size() << " " << x.z.size();
  for (int i = 0; i < n; ++i) {
    q[d.kernel[i] * lanes + lane] = x.q[i];
    v[d.kernel[i] * lanes + lane] = x.v[i];
  }
  Follow(d, lane);
  int next = 0;
  for (; next < d.program.num_states; ++next) z[next * lanes + lane] = x.z[next];
  for (const int k : d.extra_joints) {
    q[k * lanes + lane] = x.z[next++];
    v[k * lanes + lane] = x.z[next++];
  }
}

void KernelState::Follow(const internal::PlantData& d, int lane) {
  for (int i = 0; i < d.program.tree.num_ties; ++i) {
    const dynamics::Tie& tie = d.program.tree.ties[i];
    q[tie.follower * lanes + lane] = tie.ratio * q[tie.driver * lanes + lane] + tie.offset;
    v[tie.follower * lanes + lane] = tie.ratio * v[tie.driver * lanes + lane];
  }
}

void KernelState::LoadStart(const internal::PlantData& d, const State& x, const CommandSignal& signal,
                            int lane) {
  Load(d, x, lane);
  if (d.prescribed.empty()) return;
  const GivenMotion* motion = signal.motion().get();
  RG_CHECK(motion != nullptr && motion->joints() == d.prescribed)
      << "the command brings no motion of the prescribed joints";
  for (size_t i = 0; i < d.prescribed.size(); ++i) {
    v[d.kernel[d.prescribed[i]] * lanes + lane] = motion->At(static_cast<int>(i), x.time).v;
  }
  SetGiven(d, signal, x.time, lane);
}

void KernelState::SetGiven(const internal::PlantData& d, const CommandSignal& signal, double t, int lane) {
  if (d.prescribed.empty()) return;
  for (size_t i = 0; i < d.prescribed.size(); ++i) {
    q[d.kernel[d.prescribed[i]] * lanes + lane] = signal.motion()->At(static_cast<int>(i), t).q;
  }
  Follow(d, lane);
}

void KernelState::StoreStacked(const internal::PlantData& d, int lane, double* x) const {
  const int n = d.num_joints();
  for (int i = 0; i < n; ++i) *x++ = q[d.kernel[i] * lanes + lane];
  for (int i = 0; i < n; ++i) *x++ = v[d.kernel[i] * lanes + lane];
  for (int k = 0; k < d.program.num_states; ++k) *x++ = z[k * lanes + lane];
  for (const int k : d.extra_joints) {
    *x++ = q[k * lanes + lane];
    *x++ = v[k * lanes + lane];
  }
}

void KernelState::Store(const internal::PlantData& d, State* x) const {
  const int n = d.num_joints();
  for (int i = 0; i < n; ++i) x->q[i] = q[d.kernel[i]], x->v[i] = v[d.kernel[i]];
  double* out = std::copy_n(z, d.program.num_states, x->z.data());
  for (const int k : d.extra_joints) {
    *out++ = q[k];
    *out++ = v[k];
  }
}

void SensitivityBuffers::Resize(const internal::SensitivityLayout& of, int columns) {
  layout = of;
  const size_t set = layout.column_size() * columns;
  const size_t forces = static_cast<size_t>(columns) * layout.capacity * layout.lanes;
  memory.Resize((2 * set + 4 * forces) * sizeof(double));
  at[0].columns = memory.doubles();
  at[1].columns = memory.doubles() + set;
  direct = memory.doubles() + 2 * set;
  current = 0;
}

Eigen::VectorXd State::Stacked() const {
  Eigen::VectorXd x(q.size() + v.size() + z.size());
  x << q, v, z;
  return x;
}

Simulator::Impl::Impl(const Plant& p, const SimulatorOptions& o)
    : plant(p),
      options(o),
      kernels(integrators::GetStepKernels(p.data().program, o.isa)),
      values(plant.data()),
      x(p.data(), 1) {
  const internal::PlantData& d = data();
  step = options.integrator == Integrator::kLeapfrog            ? kernels.leapfrog
         : options.integrator == Integrator::kSemiImplicitEuler ? kernels.semi_implicit_euler
                                                                : kernels.rk4;
  scratch.Resize(kernels.scratch_bytes);
  std::copy(d.reference_mass.begin(), d.reference_mass.end(), kernel_values.reference_mass);
  kernel_values.stick_velocity = options.stick_velocity;
  kernel_values.rk4_sign_width = options.rk4_sign_width;
  SetValues(d.table.Nominal());
}

void Simulator::Impl::SetValues(const Eigen::VectorXd& p) {
  values.Set(p);
  ++version;
  for (int k = 0; k < data().num_kernel_joints(); ++k) {
    const int body = data().program.tree.body[k];
    for (int i = 0; i < 10; ++i) kernel_values.phi[k][i] = values.phi()(i, body);
  }
  for (int i = 0; i < 3; ++i) kernel_values.gravity[i] = values.gravity()[i];
  kernel_values.joint_parameters = values.joint_parameters().data();
  kernel_values.point_parameters = values.point_parameters().data();
  kernels.prepare(data().program, kernel_values, scratch.data());
}

Outcome Simulator::Impl::Step(double t, double h, internal::DirectionPlan* p, SensitivityBuffers* b) {
  const Outcome outcome = StepInParts(t, h, 0, p, b);
  if (outcome.ok()) ++step_count;
  return outcome;
}

Outcome Simulator::Impl::StepInParts(double t, double h, int halvings, internal::DirectionPlan* p,
                                     SensitivityBuffers* b) {
  const internal::PlantData& d = data();
  const integrators::StepInput input{x.q, x.v, x.z, &t, &h, x.command, x.command_weights.doubles()};
  const integrators::StepOutput output{x.next_q, x.next_v, x.next_z};
  static const integrators::Sensitivity kNone{};
  const integrators::StepResult result =
      step(d.program, kernel_values, input, p == nullptr ? nullptr : &p->directions(),
           b == nullptr ? nullptr : b->direct, b == nullptr ? kNone : b->at[b->current],
           b == nullptr ? kNone : b->at[1 - b->current], output, scratch.data());
  if (result.status == StepStatus::kNotConverged && halvings < kMaxHalvings) {
    double ends[integrators::kMaxJoints];
    for (const int j : d.prescribed) {
      double& end = x.command[d.kernel[j]];
      ends[j] = end;
      end = 0.5 * (x.v[d.kernel[j]] + end);
    }
    const Outcome first = StepInParts(t, 0.5 * h, halvings + 1, p, b);
    for (const int j : d.prescribed) x.command[d.kernel[j]] = ends[j];
    return first.ok() ? StepInParts(t + 0.5 * h, 0.5 * h, halvings + 1, p, b) : first;
  }
  if (result.status != StepStatus::kOk) {
    Outcome outcome;
    outcome.kind = result.status == StepStatus::kNonFinite ? Outcome::Kind::kNonFinite
                   : result.status == StepStatus::kMassMatrixNotPositive
                       ? Outcome::Kind::kMassMatrixNotPositive
                       : Outcome::Kind::kNotConverged;
    outcome.step = step_count;
    outcome.time = t;
    outcome.joint = d.KernelJoint(std::max(result.joint, 0)).name;
    // A state that is already not finite makes the mass matrix so.
    for (int i = 0; i < d.num_kernel_joints(); ++i) {
      if (std::isfinite(x.q[i]) && std::isfinite(x.v[i]) && std::isfinite(x.command[i])) continue;
      outcome.kind = Outcome::Kind::kNonFinite;
      outcome.joint = d.KernelJoint(i).name;
      break;
    }
    return outcome;
  }
  x.Shift();
  if (b != nullptr) b->current = 1 - b->current;
  return {};
}

internal::DirectionPlan& Simulator::Impl::PlanFor(const SensitivityRequest& request) {
  if (!plan || plan_request.initial_state != request.initial_state ||
      plan_request.parameters != request.parameters) {
    plan.emplace(data(), internal::DirectionPlan::Leading{request.initial_state, false}, request.parameters);
    plan_request = request;
    ++plan_count;
    plan_version = -1;
    buffers.Resize({data().program, kernels}, plan->directions().columns);
    row.resize(plan->directions().columns);
    x.command_weights.Resize((plan->commands().size() + 1) * sizeof(double));
  }
  if (plan_version != version) {
    plan->Update(values);
    plan_version = version;
  }
  return *plan;
}

internal::DirectionPlan& Simulator::Impl::ControlPlan() {
  if (!control_plan) {
    control_plan.emplace(data(), internal::DirectionPlan::Leading{true, true}, std::vector<int>{});
    control_buffers.Resize({data().program, kernels}, control_plan->directions().columns);
    x.command_weights.Resize((control_plan->commands().size() + 1) * sizeof(double));
  }
  if (control_version != version) {
    control_plan->Update(values);
    control_version = version;
  }
  return *control_plan;
}

double Simulator::Impl::Delay(int joint) const {
  const int parameter = data().command_delay[joint];
  return parameter < 0 ? 0.0 : std::max(0.0, values.values()[parameter]);
}
double Simulator::Impl::SensorDelay(int joint) const {
  const int parameter = data().sensors[joint].delay;
  return parameter < 0 ? 0.0 : std::max(0.0, values.values()[parameter]);
}
double Simulator::Impl::Offset(int joint) const {
  const int parameter = data().sensors[joint].offset;
  return parameter < 0 ? 0.0 : values.values()[parameter];
}

Simulator::Simulator(const Plant& plant, const SimulatorOptions& options) {
  const Status supported = Supports(plant, options);
  RG_CHECK(supported.ok()) << supported.message();
  impl_ = std::make_unique<Impl>(plant, options);
}
Simulator::~Simulator() = default;
Simulator::Simulator(Simulator&&) noexcept = default;
Simulator& Simulator::operator=(Simulator&&) noexcept = default;

Status Simulator::Supports(const Plant& plant, const SimulatorOptions& options) {
  if (!(options.step_s > 0) || !std::isfinite(options.step_s)) return InvalidError("step_s must be positive");
  if (!(options.stick_velocity > 0)) return InvalidError("stick_velocity must be positive");
  if (!(options.rk4_sign_width > 0)) return InvalidError("rk4_sign_width must be positive");
  if (options.integrator == Integrator::kRk4 && !plant.prescribed().empty()) {
    return InvalidError("rk4 cannot step joints that move as they are told (" +
                        plant.joint_names()[plant.prescribed()[0]] + "); use leapfrog");
  }
  if (options.integrator == Integrator::kRk4 && plant.data().program.num_states > 0) {
    return InvalidError("rk4 cannot step internal states (" + plant.internal_state_names()[0] +
                        "); use leapfrog");
  }
  return Status::Ok();
}

const Plant& Simulator::plant() const { return impl_->plant; }
const SimulatorOptions& Simulator::options() const { return impl_->options; }
void Simulator::SetParameters(const Eigen::VectorXd& values) {
  RG_CHECK(values.size() == plant().parameters().size()) << values.size();
  impl_->SetValues(values);
}
const Eigen::VectorXd& Simulator::parameters() const { return impl_->values.values(); }

bool Simulator::Acceleration(const State& x, const Eigen::VectorXd& u, Eigen::VectorXd* a) {
  Impl& s = *impl_;
  const internal::PlantData& d = s.data();
  s.x.Load(d, x, 0);
  for (int i = 0; i < s.n(); ++i) s.x.command[d.kernel[i]] = u[i];
  const double instant = 0.0;
  const integrators::StepInput input{s.x.q, s.x.v, s.x.z, &x.time, &instant, s.x.command, nullptr};
  const auto result = s.kernels.acceleration(d.program, s.kernel_values, input, s.x.next_v, s.scratch.data());
  a->resize(s.n());
  for (int i = 0; i < s.n(); ++i) (*a)[i] = s.x.next_v[d.kernel[i]];
  return result.status == StepStatus::kOk;
}

}  // namespace rg::sim
