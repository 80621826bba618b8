#include "services/diagnosis/likelihood/free_force.h"

#include <algorithm>
#include <cmath>

namespace rg::diagnosis {

ForceSegments SegmentsOf(const FreeForce& force, const NodeWindow& window) {
  const int N = static_cast<int>(window.t.size()) - 1, n = static_cast<int>(force.joints.size());
  const double span = window.t[N] - window.t[0];
  const int S = std::clamp(static_cast<int>(std::lround(span / force.segment_s)), 1, N);
  ForceSegments out;
  out.phi = MatrixXd::Zero(S * n, N);
  for (int s = 0; s < S; ++s) {
    out.t.push_back(window.t[0] + span * (s + 0.5) / S);
    out.joint.insert(out.joint.end(), force.joints.begin(), force.joints.end());
  }
  for (int k = 0; k < N; ++k) {
    const double middle = 0.5 * (window.t[k] + window.t[k + 1]);
    const int s = std::min(S - 1, static_cast<int>((middle - window.t[0]) / span * S));
    for (int j = 0; j < n; ++j) out.phi(s * n + j, k) = force.prior[force.joints[j]];
  }
  return out;
}

}  // namespace rg::diagnosis
