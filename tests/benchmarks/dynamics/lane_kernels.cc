#include "tests/benchmarks/dynamics/lane_kernels.h"

#include <new>

#include "common/dynamics/kernels.h"

namespace rg::dynamics {
inline namespace RG_ISA {
namespace {

constexpr int kCapacity = 8;
using T = math::Lanes<math::kNativeLanes>;

struct State {
  KernelWorkspace<T, kCapacity> workspace;
  Inertias<T, kCapacity> inertias;
  T q[kCapacity], v[kCapacity], a[kCapacity], gravity[3];
};

void* Make(const Tree& tree, const double* phi) {
  State* state = new (std::align_val_t{64}) State();
  for (int k = 0; k < tree.n; ++k) {
    T body[10];
    for (int i = 0; i < 10; ++i) body[i] = T(phi[10 * k + i]);
    state->inertias.Set(k, body);
    for (int lane = 0; lane < math::kNativeLanes; ++lane) {
      state->q[k].Set(lane, 0.3 * k + 0.1 * lane);
      state->v[k].Set(lane, 0.5 - 0.2 * k + 0.1 * lane);
      state->a[k].Set(lane, 1.0 - 0.1 * lane);
    }
  }
  state->gravity[0] = state->gravity[1] = T(0.0);
  state->gravity[2] = T(-9.81);
  return state;
}

void Run(const Tree& tree, void* buffer) {
  State& s = *static_cast<State*>(buffer);
  Terms(tree, s.inertias, s.gravity, s.q, s.v, s.workspace);
  SetAcceleration(tree, s.a, s.workspace);
  Derivatives(tree, s.workspace);
  Regressor(tree, s.workspace);
}

void Destroy(void* buffer) {
  static_cast<State*>(buffer)->~State();
  ::operator delete (buffer, std::align_val_t{64});
}

}  // namespace

extern const LaneBenchmark kLaneBenchmark;
const LaneBenchmark kLaneBenchmark = {math::kNativeLanes, Make, Run, Destroy};

}  // namespace RG_ISA
}  // namespace rg::dynamics
