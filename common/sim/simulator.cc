#include "common/sim/simulator.h"

#include <algorithm>
#include <cmath>
#include <cstring>

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

void SensitivityBuffers::Resize(const internal::PlantData& plant, int stride) {
  const size_t joints = static_cast<size_t>(plant.num_kernel_joints()) * stride;
  const size_t states = static_cast<size_t>(plant.program.num_states) * stride;
  memory.Resize((2 * (2 * joints + states) + 4 * joints) * sizeof(double));
  double* next = memory.doubles();
  auto take = [&](size_t count) {
    double* at = next;
    next += count;
    return at;
  };
  for (auto& s : at) s = {take(joints), take(joints), take(states)};
  direct = take(4 * joints);
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
      kernels(integrators::GetStepKernels(p.data().num_kernel_joints())),
      values(plant.data()) {
  const internal::PlantData& d = data();
  const int joints = d.num_kernel_joints();
  step = options.integrator == Integrator::kLeapfrog            ? kernels.leapfrog
         : options.integrator == Integrator::kSemiImplicitEuler ? kernels.semi_implicit_euler
                                                                : kernels.rk4;
  for (auto* x : {&q, &v, &begin_q, &begin_v, &next_q, &next_v, &command}) x->assign(joints, 0.0);
  for (auto* x : {&z, &begin_z, &next_z}) x->assign(d.program.num_states, 0.0);
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
    for (int i = 0; i < 10; ++i) kernel_values.phi[k][i] = values.phi()(i, k);
  }
  for (int i = 0; i < 3; ++i) kernel_values.gravity[i] = values.gravity()[i];
  kernel_values.joint_parameters = values.joint_parameters().data();
  kernel_values.point_parameters = values.point_parameters().data();
  kernels.prepare(data().program, kernel_values, scratch.data());
}

void Simulator::Impl::Load(const State& x) {
  const internal::PlantData& d = data();
  RG_CHECK(x.q.size() == n() && x.v.size() == n() && x.z.size() == d.num_internal_states())
      << x.q.size() << " " << x.v.size() << " " << x.z.size();
  std::copy(x.q.data(), x.q.data() + n(), q.begin() + d.first_joint);
  std::copy(x.v.data(), x.v.data() + n(), v.begin() + d.first_joint);
  std::copy(x.z.data(), x.z.data() + d.program.num_states, z.begin());
  int next = d.program.num_states;
  for (const int k : d.extra_joints) {
    q[k] = x.z[next++];
    v[k] = x.z[next++];
  }
}

void Simulator::Impl::StoreStacked(double* x) const {
  const internal::PlantData& d = data();
  x = std::copy_n(q.begin() + d.first_joint, n(), x);
  x = std::copy_n(v.begin() + d.first_joint, n(), x);
  x = std::copy(z.begin(), z.end(), x);
  for (const int k : d.extra_joints) {
    *x++ = q[k];
    *x++ = v[k];
  }
}

void Simulator::Impl::Store(State* x) const {
  const internal::PlantData& d = data();
  std::copy_n(q.begin() + d.first_joint, n(), x->q.data());
  std::copy_n(v.begin() + d.first_joint, n(), x->v.data());
  double* out = std::copy(z.begin(), z.end(), x->z.data());
  for (const int k : d.extra_joints) {
    *out++ = q[k];
    *out++ = v[k];
  }
}

Outcome Simulator::Impl::Step(double t, double h, internal::DirectionPlan* p, SensitivityBuffers* b) {
  const Outcome outcome = StepInParts(t, h, 0, p, b);
  if (outcome.ok()) ++step_count;
  return outcome;
}

Outcome Simulator::Impl::StepInParts(double t, double h, int halvings, internal::DirectionPlan* p,
                                     SensitivityBuffers* b) {
  const internal::PlantData& d = data();
  const integrators::StepInput input{q.data(), v.data(), z.data(), t, h, command.data()};
  const integrators::StepOutput output{next_q.data(), next_v.data(), next_z.data()};
  static const integrators::Sensitivity kNone{};
  const integrators::StepResult result =
      step(d.program, kernel_values, input, p == nullptr ? nullptr : &p->directions(),
           b == nullptr ? nullptr : b->direct, b == nullptr ? kNone : b->at[b->current],
           b == nullptr ? kNone : b->at[1 - b->current], output, scratch.data());
  if (result.status == StepStatus::kNotConverged && halvings < kMaxHalvings) {
    const Outcome first = StepInParts(t, 0.5 * h, halvings + 1, p, b);
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
    outcome.joint = d.tree_model->joint(std::max(result.joint, 0)).name;
    // A state that is already not finite makes the mass matrix so.
    for (size_t i = 0; i < q.size(); ++i) {
      if (std::isfinite(q[i]) && std::isfinite(v[i]) && std::isfinite(command[i])) continue;
      outcome.kind = Outcome::Kind::kNonFinite;
      outcome.joint = d.tree_model->joint(static_cast<int>(i)).name;
      break;
    }
    return outcome;
  }
  begin_q.swap(q);
  begin_v.swap(v);
  begin_z.swap(z);
  q.swap(next_q);
  v.swap(next_v);
  z.swap(next_z);
  if (b != nullptr) b->current = 1 - b->current;
  return {};
}

internal::DirectionPlan& Simulator::Impl::PlanFor(const SensitivityRequest& request) {
  if (!plan || plan_request.initial_state != request.initial_state ||
      plan_request.parameters != request.parameters) {
    plan.emplace(data(), internal::DirectionPlan::Leading{request.initial_state, false}, request.parameters);
    plan_request = request;
    plan_version = -1;
    buffers.Resize(data(), plan->directions().stride);
    row.resize(plan->num_columns());
    begin_row.resize(plan->directions().stride);
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
    control_buffers.Resize(data(), control_plan->directions().stride);
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
  s.Load(x);
  for (int i = 0; i < s.n(); ++i) s.command[d.first_joint + i] = u[i];
  const integrators::StepInput input{s.q.data(), s.v.data(), s.z.data(), x.time, 0.0, s.command.data()};
  const auto result =
      s.kernels.acceleration(d.program, s.kernel_values, input, s.next_v.data(), s.scratch.data());
  *a = Eigen::Map<const Eigen::VectorXd>(s.next_v.data() + d.first_joint, s.n());
  return result.status == StepStatus::kOk;
}

}  // namespace rg::sim
