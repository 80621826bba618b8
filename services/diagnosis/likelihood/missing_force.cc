#include "services/diagnosis/likelihood/missing_force.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "common/base/parallel.h"
#include "services/diagnosis/likelihood/free_force.h"
#include "services/diagnosis/likelihood/lineariser.h"

namespace rg::diagnosis {

namespace {

// Log evidence of the unknowns `chosen` alone, in units of their prior stddev. H: information of all
// unknowns, prior included; g = Jᵀr.
double EvidenceOf(const MatrixXd& H, const VectorXd& g, const std::vector<int>& chosen) {
  const Eigen::LLT<MatrixXd> llt(H(chosen, chosen));
  const VectorXd y = llt.matrixL().solve(g(chosen));
  return 0.5 * y.squaredNorm() - HalfLogDet(llt);
}

}  // namespace

MissingForce EstimateMissingForce(const FitData& data, const FitModel& model, const NodeStates& states,
                                  const VectorXd& prior, double segment_s, const LiftedOptions& options) {
  FitModel fixed{model.plant, model.values, {}};
  Lineariser lin(data, fixed, true, options);
  const int W = static_cast<int>(data.windows.size()), n = data.n;
  FreeForce any{std::vector<int>(n), prior, segment_s};
  std::iota(any.joints.begin(), any.joints.end(), 0);
  MissingForce out;
  out.force.resize(W), out.stddev.resize(W), out.t.resize(W);
  std::vector<double> chi2(W, 0), unknowns(W, 0);
  std::vector<char> lost(W, 0);
  std::vector<MatrixXd> evidence(W, MatrixXd::Zero(n, n));
  ParallelFor(options.threads, W, [&](int worker, int w) {
    const NodeWindow& window = data.windows[w];
    const ForceSegments segments = SegmentsOf(any, window);
    const int S = static_cast<int>(segments.t.size());
    out.t[w] = segments.t;
    Linear l;
    lin.Run(worker, w, states[w], &segments.joint, &segments.phi, false, &l);
    out.force[w] = MatrixXd::Zero(n, S), out.stddev[w] = MatrixXd::Zero(n, S);
    lost[w] = !l.ok;
    if (!l.ok) return;
    RowMatrixXd rest = l.rows.rightCols(S * n + 1) / std::sqrt(options.noise_scale);
    const int rank = ProjectOut(l.J_e(), &rest);
    const int C = S * n;
    MatrixXd H = rest.leftCols(C).transpose() * rest.leftCols(C);
    const MatrixXd data_H = H;
    H.diagonal().array() += 1.0;
    const Eigen::LLT<MatrixXd> llt(H);
    const VectorXd g = rest.leftCols(C).transpose() * rest.col(C);
    const VectorXd c = llt.solve(g);
    const MatrixXd cov = llt.solve(MatrixXd::Identity(C, C));
    for (int s = 0; s < S; ++s) {
      for (int j = 0; j < n; ++j) {
        out.force[w](j, s) = prior[j] * c[s * n + j];
        out.stddev[w](j, s) = prior[j] * std::sqrt(std::max(0.0, cov(s * n + j, s * n + j)));
      }
    }
    for (int j = 0; j < n; ++j) {
      for (int k = 0; k <= j; ++k) {
        std::vector<int> chosen;
        for (int s = 0; s < S; ++s) {
          chosen.push_back(s * n + j);
          if (k != j) chosen.push_back(s * n + k);
        }
        evidence[w](j, k) = evidence[w](k, j) = EvidenceOf(H, g, chosen);
      }
    }
    chi2[w] = (rest.col(C) - rest.leftCols(C) * c).squaredNorm();
    unknowns[w] = rank + (data_H * cov).trace();
  });
  out.evidence = MatrixXd::Zero(n, n);
  for (int w = 0; w < W; ++w) out.chi2 += chi2[w], out.unknowns += unknowns[w], out.evidence += evidence[w];
  out.rows = data.Rows();
  out.lost = static_cast<int>(std::ranges::count(lost, 1));
  return out;
}

}  // namespace rg::diagnosis
