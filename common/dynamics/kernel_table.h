// The double kernels behind function pointers, one table per instruction set.
#pragma once

#include <cstddef>

#include "common/dynamics/tree.h"
#include "common/math/isa.h"

namespace rg::dynamics {

// Inertial rows as the kernels read them: mass, first moment xyz, second moment xx xy xz yy yz zz.
struct InertiaRows {
  alignas(64) double rows[10][kMaxBodies] = {};
};

// q, v, a, tau: n doubles; gravity: 3. Matrices are written column-major with leading dimension ld.
struct KernelTable {
  size_t workspace_bytes;  // aligned to 64, to be passed to init once
  void (*init)(void* workspace);
  void (*set_body)(InertiaRows& inertias, int body, const double* phi);
  void (*rnea)(const Tree&, const InertiaRows&, const double* gravity, const double* q, const double* v,
               const double* a, void* workspace, double* tau);
  void (*crba)(const Tree&, const InertiaRows&, const double* q, void* workspace, double* M, ptrdiff_t ld);
  void (*terms)(const Tree&, const InertiaRows&, const double* gravity, const double* q, const double* v,
                void* workspace, double* M, ptrdiff_t ld, double* c);
  // After terms, in the same workspace. tau may be null.
  void (*derivatives)(const Tree&, const double* a, void* workspace, double* dtau_dq, ptrdiff_t ld_q,
                      double* dtau_dv, ptrdiff_t ld_v, double* tau);
  // After terms: n × 3.
  void (*gravity_derivative)(const Tree&, void* workspace, double* dtau_dg, ptrdiff_t ld);
  void (*regressor)(const Tree&, const double* gravity, const double* q, const double* v, const double* a,
                    void* workspace, double* Y, ptrdiff_t ld);
  void (*aba)(const Tree&, const InertiaRows&, const double* gravity, const double* q, const double* v,
              const double* tau, void* workspace, double* a);
  void (*aba_derivatives)(const Tree&, const InertiaRows&, const double* gravity, const double* q,
                          const double* v, const double* tau, void* workspace, double* a, double* da_dq,
                          ptrdiff_t ld_q, double* da_dv, ptrdiff_t ld_v, double* da_dtau, ptrdiff_t ld_tau);
  // R_WB (columns) and p_WB of each body: 12 doubles per body.
  void (*poses)(const Tree&, const double* q, void* workspace, double* out);
  // terms, derivatives and regressor at acceleration a without copying results out: what a simulation
  // step costs in dynamics (benchmarks).
  void (*step_terms)(const Tree&, const InertiaRows&, const double* gravity, const double* q, const double* v,
                     const double* a, void* workspace);
};

// The table for an instruction set that this processor has (RG_CHECK).
const KernelTable& GetKernels(math::Isa isa);

}  // namespace rg::dynamics
