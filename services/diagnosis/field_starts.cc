#include "services/diagnosis/field_starts.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/effects/effect_list.h"
#include "common/model/robot_model.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr int kNodes = effects::UnknownFieldPair::kNodes;
constexpr int kWeights = kNodes * kNodes;

struct Sample {
  VectorXd q, force, weight;  // n: positions, missing force, 1/σ²
};

std::vector<Sample> SamplesOf(const FitData& data, const MissingForce& missing) {
  std::vector<Sample> out;
  for (size_t w = 0; w < missing.force.size(); ++w) {
    const FineMotion& fine = data.fine[data.windows[w].recording];
    const double dt = fine.t[1] - fine.t[0];
    for (size_t s = 0; s < missing.t[w].size(); ++s) {
      const auto at = static_cast<long>(
          std::clamp((missing.t[w][s] - fine.t[0]) / dt, 0.0, static_cast<double>(fine.t.size() - 1)));
      const auto col = static_cast<long>(s);
      Sample sample{fine.q.col(at), missing.force[w].col(col),
                    missing.stddev[w].col(col).cwiseMax(1e-12).cwiseAbs2().cwiseInverse()};
      if (sample.force.allFinite() && sample.weight.allFinite()) out.push_back(std::move(sample));
    }
  }
  return out;
}

VectorXd Basis(double q, double low, double high) {
  VectorXd out(kNodes);
  const double x = (q - low) * (kNodes - 1) / (high - low);
  for (int i = 0; i < kNodes; ++i) out[i] = effects::UnknownField::Spline(x - i);
  return out;
}

}  // namespace

std::optional<EffectSpec> FieldPairStart(const FitData& data, const sim::Plant& nominal,
                                         const MotionScales& scales, const MissingForce& missing) {
  const std::vector<Sample> samples = SamplesOf(data, missing);
  const int n = data.n, S = static_cast<int>(samples.size());
  std::optional<EffectSpec> best;
  double best_gain = -std::numeric_limits<double>::infinity();
  std::vector<MatrixXd> basis(n, MatrixXd(kNodes, S));
  for (int j = 0; j < n; ++j) {
    for (int s = 0; s < S; ++s)
      basis[j].col(s) = Basis(samples[s].q[j], scales.low[j], std::max(scales.high[j], scales.low[j] + 1e-3));
  }
  for (int on = 0; on < n; ++on) {
    // The force's own size: where nothing was recorded the surface stays near zero.
    double squares = 0;
    for (const Sample& s : samples) squares += s.force[on] * s.force[on];
    const double prior = std::max(1e-9, 3 * std::sqrt(squares / std::max(1, S)));
    for (int other = 0; other < n; ++other) {
      if (other == on) continue;
      MatrixXd H = MatrixXd::Zero(kWeights, kWeights);
      VectorXd g = VectorXd::Zero(kWeights), phi(kWeights);
      for (int s = 0; s < S; ++s) {
        for (int i = 0; i < kNodes; ++i)
          phi.segment(i * kNodes, kNodes) = prior * basis[on](i, s) * basis[other].col(s);
        H.selfadjointView<Eigen::Lower>().rankUpdate(phi, samples[s].weight[on]);
        g += samples[s].weight[on] * samples[s].force[on] * phi;
      }
      H.diagonal().array() += 1.0;
      const Eigen::LLT<MatrixXd> llt(H.selfadjointView<Eigen::Lower>());
      const VectorXd c = llt.solve(g);
      double log_det = 0;
      for (int i = 0; i < kWeights; ++i) log_det += 2 * std::log(llt.matrixLLT()(i, i));
      const double gain = 0.5 * g.dot(c) - 0.5 * log_det;
      if (!(gain > best_gain)) continue;
      best_gain = gain;
      std::map<std::string, double> values = {
          {"low", scales.low[on]},
          {"high", std::max(scales.high[on], scales.low[on] + 1e-3)},
          {"other_low", scales.low[other]},
          {"other_high", std::max(scales.high[other], scales.low[other] + 1e-3)}};
      for (int i = 0; i < kWeights; ++i)
        values["w" + std::to_string(i / kNodes) + std::to_string(i % kNodes)] = prior * c[i];
      best = effects::MakeSpec("unknown_field_pair",
                               {nominal.joint_names()[other], nominal.joint_names()[on]}, values);
    }
  }
  return best;
}

}  // namespace rg::diagnosis
