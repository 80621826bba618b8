// Drives that turn with two joints (effects/joint_coupling.h, form kinematic): their laws over
//
//   w = v_joint + κ·v_other = Rᵀ v,   acting on the joints with R·f(w)
//
// stand behind those of the joints, and the velocity step solves for all at once: f falls with w, so R·f(Rᵀ
// v) is the slope of a concave function of v as the joints' own forces are. Arrays over laws hold w behind
// the joints' velocities. All functions do nothing where there is no such drive.
#pragma once

#include "common/integrators/step_program.h"
#include "common/math/rows.h"

namespace rg::integrators {
inline namespace RG_ISA {

// A drive with its κ: R is 1 at `joint`, κ at `other`, else 0.
template <class T>
struct DriveRow {
  int law, joint, other;
  T ratio;

  RG_INLINE T Of(const T* x) const { return x[joint] + ratio * x[other]; }  // Rᵀ x
};

// Calls f(DriveRow<T>) for each.
template <class T, class F>
RG_INLINE void ForEachDrive(const StepProgram& program, const StepValues& values, F f) {
  for (int d = 0; d < program.num_drives; ++d) {
    const CoupledDrive& drive = program.drives[d];
    const int law = program.tree.n + d;
    f(DriveRow<T>{law, drive.joint, drive.other,
                  T(values.joint_parameters[program.joints[law].first_parameter + drive.ratio])});
  }
}

// w behind the joints' velocities (or positions, accelerations).
template <class T>
RG_INLINE void SetDrives(const StepProgram& program, const StepValues& values, T* v) {
  ForEachDrive<T>(program, values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE { v[r.law] = r.Of(v); });
}

// force += R f of each, f behind the joints' forces.
template <class T>
RG_INLINE void AddDriveForces(const StepProgram& program, const StepValues& values, T* force) {
  ForEachDrive<T>(program, values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
    force[r.joint] += force[r.law];
    force[r.other] += r.ratio * force[r.law];
  });
}

// A += R s Rᵀ in the lower triangle of A, row-major with leading dimension C.
template <class T, int C>
RG_INLINE void AddDriveSquare(const DriveRow<T>& r, T s, T* A) {
  const int low = r.joint < r.other ? r.joint : r.other, high = r.joint < r.other ? r.other : r.joint;
  A[r.joint * C + r.joint] += s;
  A[high * C + low] += r.ratio * s;
  A[r.other * C + r.other] += r.ratio * r.ratio * s;
}

// The same of a whole matrix by columns.
template <class T, int C>
RG_INLINE void AddDriveSquare(const DriveRow<T>& r, T s, math::Row<T, C>* A) {
  A[r.joint][r.joint] += s;
  A[r.joint][r.other] += r.ratio * s;
  A[r.other][r.joint] += r.ratio * s;
  A[r.other][r.other] += r.ratio * r.ratio * s;
}

}  // namespace RG_ISA
}  // namespace rg::integrators
