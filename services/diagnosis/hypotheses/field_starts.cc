#include "services/diagnosis/hypotheses/field_starts.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/effects/effect_list.h"
#include "common/effects/inference.h"
#include "services/diagnosis/hypotheses/force_samples.h"

namespace rg::diagnosis {

namespace {

constexpr int kNodes = effects::UnknownFieldPair::kNodes;
constexpr int kWeights = kNodes * kNodes;

// Those that are finite.
std::vector<ForceSample> SamplesOf(const FitData& data, const MissingForce& missing) {
  std::vector<ForceSample> out = ForceSamples(data, missing);
  std::erase_if(out, [](const ForceSample& s) { return !s.force.allFinite() || !s.weight.allFinite(); });
  return out;
}

VectorXd Basis(int nodes, double x, double low, double high) {
  VectorXd out(nodes);
  const double at = (x - low) * (nodes - 1) / (high - low);
  for (int i = 0; i < nodes; ++i) out[i] = effects::UnknownField::Spline(at - i);
  return out;
}

// Prior stddev of a field's weights: three times the RMS of the missing force.
double SizeOn(const std::vector<ForceSample>& samples, int joint) {
  double squares = 0;
  for (const ForceSample& s : samples) squares += s.force[joint] * s.force[joint];
  return std::max(1e-9, 3 * std::sqrt(squares / std::max<double>(1.0, static_cast<double>(samples.size()))));
}

// Weighted regression of one joint's missing force on the rows of phi (W × S, in units of the prior): the
// gain of log evidence, and the weights.
double Regressed(const std::vector<ForceSample>& samples, int on, const MatrixXd& phi, VectorXd* weights) {
  const auto W = phi.rows();
  MatrixXd H = MatrixXd::Zero(W, W);
  VectorXd g = VectorXd::Zero(W);
  for (size_t s = 0; s < samples.size(); ++s) {
    const auto column = phi.col(s);
    H.selfadjointView<Eigen::Lower>().rankUpdate(column, samples[s].weight[on]);
    g += samples[s].weight[on] * samples[s].force[on] * column;
  }
  H.diagonal().array() += 1.0;
  const Eigen::LLT<MatrixXd> llt(H.selfadjointView<Eigen::Lower>());
  *weights = llt.solve(g);
  return 0.5 * g.dot(*weights) - HalfLogDet(llt);
}

}  // namespace

std::optional<EffectSpec> FieldStart(const FitSetting& setting, const MissingForce& missing,
                                     const std::string& variable, int only) {
  const auto& [data, nominal, scales] = setting;
  const std::string& field = effects::LawOf(effects::Regressor::kPositionPiece).id;
  const std::vector<ForceSample> samples = SamplesOf(data, missing);
  std::optional<EffectSpec> best;
  double best_gain = -std::numeric_limits<double>::infinity();
  for (int on = 0; on < data.n; ++on) {
    if (!nominal.Takes(field, on) || (only >= 0 && on != only)) continue;
    const bool speed = variable == "velocity", drag = variable == "drag";
    const double low = speed ? -scales.top_speed[on] : scales.low[on];
    const double high = std::max(speed ? scales.top_speed[on] : scales.high[on], low + 1e-3);
    const double size = SizeOn(samples, on) / (drag ? std::max(1e-9, scales.top_speed[on]) : 1.0);
    MatrixXd phi(effects::UnknownField::kNodes, static_cast<long>(samples.size()));
    for (size_t s = 0; s < samples.size(); ++s) {
      const double x = speed ? samples[s].v[on] : samples[s].q[on];
      phi.col(s) =
          (drag ? -samples[s].v[on] : 1.0) * size * Basis(effects::UnknownField::kNodes, x, low, high);
    }
    VectorXd weights;
    const double gain = Regressed(samples, on, phi, &weights);
    if (!(gain > best_gain)) continue;
    best_gain = gain;
    std::map<std::string, double> values = {{"low", low}, {"high", high}};
    for (int i = 0; i < weights.size(); ++i)
      values["w" + std::to_string(i)] = size * (drag ? std::max(0.0, weights[i]) : weights[i]);
    best = effects::MakeSpec(field, {nominal.joint_names()[on]}, values);
    best->options["variable"] = variable;
  }
  return best;
}

std::optional<EffectSpec> FieldPairStart(const FitSetting& setting, const MissingForce& missing, int only) {
  const auto& [data, nominal, scales] = setting;
  const std::string surface = effects::UnknownFieldPair::Info().id;
  const std::vector<ForceSample> samples = SamplesOf(data, missing);
  const int n = data.n;
  const auto S = static_cast<long>(samples.size());
  std::optional<EffectSpec> best;
  double best_gain = -std::numeric_limits<double>::infinity();
  std::vector<MatrixXd> basis(n, MatrixXd(kNodes, S));
  for (int j = 0; j < n; ++j) {
    for (long s = 0; s < S; ++s)
      basis[j].col(s) =
          Basis(kNodes, samples[s].q[j], scales.low[j], std::max(scales.high[j], scales.low[j] + 1e-3));
  }
  for (int on = 0; on < n; ++on) {
    if (!nominal.Takes(surface, on) || (only >= 0 && on != only)) continue;
    const double size = SizeOn(samples, on);
    for (int other = 0; other < n; ++other) {
      if (other == on) continue;
      MatrixXd phi(kWeights, S);
      for (long s = 0; s < S; ++s) {
        for (int i = 0; i < kNodes; ++i)
          phi.col(s).segment(i * kNodes, kNodes) = size * basis[on](i, s) * basis[other].col(s);
      }
      VectorXd weights;
      const double gain = Regressed(samples, on, phi, &weights);
      if (!(gain > best_gain)) continue;
      best_gain = gain;
      std::map<std::string, double> values = {
          {"low", scales.low[on]},
          {"high", std::max(scales.high[on], scales.low[on] + 1e-3)},
          {"other_low", scales.low[other]},
          {"other_high", std::max(scales.high[other], scales.low[other] + 1e-3)}};
      for (int i = 0; i < kWeights; ++i)
        values["w" + std::to_string(i / kNodes) + std::to_string(i % kNodes)] = size * weights[i];
      best = effects::MakeSpec(surface, {nominal.joint_names()[other], nominal.joint_names()[on]}, values);
    }
  }
  return best;
}

std::optional<EffectSpec> UnnamedStart(const FitSetting& setting, const MissingForce& missing,
                                       const std::string& variable, int only) {
  return variable == "position" && setting.data.n > 1 ? FieldPairStart(setting, missing, only)
                                                      : FieldStart(setting, missing, variable, only);
}

}  // namespace rg::diagnosis
