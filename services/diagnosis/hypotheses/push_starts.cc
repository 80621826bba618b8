#include "services/diagnosis/hypotheses/push_starts.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/effects/inference.h"
#include "services/diagnosis/data/touching_points.h"
#include "services/diagnosis/hypotheses/force_samples.h"

namespace rg::diagnosis {

using effects::MakeSpec;
using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

// Normal equations A f = b of a Cartesian force f at one point, from the missing force F of one stair:
// minimise Σ((F − Jᵀf)/σ)².
struct Stair {
  double t = 0;  // s, since the start of the recording
  Vector3d position, b;
  Matrix3d A;
  VectorXd force, weight;  // n: F, 1/σ²
};

std::vector<Stair> StairsAt(const FitData& data, const sim::Plant& nominal, const MissingForce& missing,
                            const TouchingPoint& point) {
  const std::vector<ForceSample> samples = ForceSamples(data, missing);
  MatrixXd q(data.n, std::ssize(samples)), Jp(3, data.n);
  for (Eigen::Index k = 0; k < q.cols(); ++k) q.col(k) = samples[static_cast<size_t>(k)].q;
  const PointMotion motion = MotionOf(point, nominal.model(), q);
  std::vector<Stair> out;
  for (Eigen::Index k = 0; k < q.cols(); ++k) {
    const ForceSample& sample = samples[static_cast<size_t>(k)];
    Stair stair;
    stair.t = sample.t, stair.position = motion.position.col(k);
    stair.force = sample.force, stair.weight = sample.weight;
    for (int axis = 0; axis < 3; ++axis)
      Jp.row(axis) = motion.jacobian[static_cast<size_t>(axis)].col(k).transpose();
    stair.A = Jp * stair.weight.asDiagonal() * Jp.transpose();
    stair.b = Jp * stair.weight.asDiagonal() * stair.force;
    if (stair.A.allFinite() && stair.b.allFinite()) out.push_back(std::move(stair));
  }
  return out;
}

}  // namespace

std::vector<TrialSpecs> PushStarts(const FitData& data, const sim::Plant& nominal,
                                   const MissingForce& missing) {
  double duration = 0;
  for (const FineMotion& m : data.fine) duration = std::max(duration, m.t.back() - m.t.front());
  constexpr double kBin = 0.25;
  constexpr int kLongest = 12;
  const int bins = std::max(1, static_cast<int>(std::ceil(duration / kBin)));
  double best = 0, best_single = 0;
  EffectSpec spec;
  for (const TouchingPoint& point : TouchingPoints(nominal.model())) {
    std::vector<Matrix3d> A(bins, Matrix3d::Zero());
    std::vector<Vector3d> b(bins, Vector3d::Zero());
    MatrixXd single_b = MatrixXd::Zero(data.n, bins), single_a = MatrixXd::Zero(data.n, bins);
    for (const Stair& s : StairsAt(data, nominal, missing, point)) {
      const int k = std::clamp(static_cast<int>(s.t / kBin), 0, bins - 1);
      A[k] += s.A, b[k] += s.b;
      single_b.col(k) += s.weight.cwiseProduct(s.force), single_a.col(k) += s.weight;
    }
    for (int from = 0; from < bins; ++from) {
      Matrix3d sum_A = Matrix3d::Zero();
      Vector3d sum_b = Vector3d::Zero();
      VectorXd sum_sb = VectorXd::Zero(data.n), sum_sa = VectorXd::Zero(data.n);
      for (int to = from; to < std::min(bins, from + kLongest); ++to) {
        sum_A += A[to], sum_b += b[to];
        sum_sb += single_b.col(to), sum_sa += single_a.col(to);
        const Matrix3d regular = sum_A + 1e-9 * sum_A.trace() * Matrix3d::Identity();
        const Vector3d f = regular.ldlt().solve(sum_b);
        const double gain = f.dot(sum_b);
        best_single =
            std::max(best_single, sum_sb.cwiseAbs2().cwiseQuotient(sum_sa.cwiseMax(1e-300)).maxCoeff());
        if (gain <= best || !f.allFinite()) continue;
        best = gain;
        spec = MakeSpec(effects::LawOf(effects::Regressor::kPulse).id, {},
                        {{"start", kBin * from},
                         {"end", kBin * (to + 1)},
                         {"force_x", f[0]},
                         {"force_y", f[1]},
                         {"force_z", f[2]}});
        if (!point.option.empty()) spec.options["point"] = point.option;
      }
    }
  }
  if (data.n < 3 || best <= best_single) return {};
  return {{spec}};
}

}  // namespace rg::diagnosis
