#include "services/diagnosis/hypotheses/push_starts.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/force_samples.h"

namespace rg::diagnosis {

using effects::MakeSpec;
using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

constexpr const char* kPoints[] = {"end_effector", "last_link"};
constexpr const char* kNormals[] = {"x", "y", "z"};

// Normal equations A f = b of a Cartesian force f at one point, from the missing force F of one stair:
// minimise Σ((F − Jᵀf)/σ)².
struct Stair {
  double t = 0;  // s, since the start of the recording
  Vector3d position, b;
  Matrix3d A;
  VectorXd force, weight;  // n: F, 1/σ²
};

std::vector<Stair> StairsAt(const FitData& data, const sim::Plant& nominal, const MissingForce& missing,
                            int link) {
  const model::RobotModel& model = nominal.model();
  const dynamics::Mechanism mechanism(model);
  dynamics::Workspace workspace;
  const model::Frame frame = *model.FindFrame(model.link(link).name);
  MatrixXd J(6, data.n);
  std::vector<Stair> out;
  for (const ForceSample& sample : ForceSamples(data, missing)) {
    Stair stair;
    stair.t = sample.t;
    stair.position = dynamics::FrameKinematics(mechanism, workspace, sample.q, frame, J).translation;
    stair.force = sample.force, stair.weight = sample.weight;
    const MatrixXd Jp = J.bottomRows<3>();
    stair.A = Jp * stair.weight.asDiagonal() * Jp.transpose();
    stair.b = Jp * stair.weight.asDiagonal() * stair.force;
    if (stair.A.allFinite() && stair.b.allFinite()) out.push_back(std::move(stair));
  }
  return out;
}

std::vector<int> LinksOf(const model::RobotModel& model) {
  std::vector<int> links = {model.FindLink(model.end_effector().name)};
  const int last = model.joint(model.num_joints() - 1).child_link;
  const auto ends = *model.FindFrame(model.end_effector().name),
             lasts = *model.FindFrame(model.link(last).name);
  const bool same = ends.body == lasts.body && (ends.X_BF.translation - lasts.X_BF.translation).norm() < 1e-6;
  if (!same) links.push_back(last);
  return links;
}

struct Surface {
  double gain = 0, stiffness = 0, height = 0;
};

// Over heights at quantiles of the recorded positions.
Surface BestSurface(const std::vector<Stair>& stairs, int axis, double sign) {
  std::vector<double> heights;
  for (const Stair& s : stairs) heights.push_back(sign * s.position[axis]);
  std::ranges::sort(heights);
  Surface best;
  if (heights.empty() || heights.back() - heights.front() < 1e-4) return best;
  constexpr int kHeights = 32;
  for (int i = 1; i <= kHeights; ++i) {
    const double height = heights[(heights.size() - 1) * static_cast<size_t>(i) * 3 / (kHeights * 4)];
    double bd = 0, ad = 0;
    for (const Stair& s : stairs) {
      const double depth = height - sign * s.position[axis];
      if (depth <= 0) continue;
      bd += sign * s.b[axis] * depth;
      ad += s.A(axis, axis) * depth * depth;
    }
    const double gain = bd > 0 && ad > 0 ? bd * bd / ad : 0;
    if (gain > best.gain) best = {gain, bd / ad, height};
  }
  return best;
}

}  // namespace

std::vector<TrialSpecs> ContactStarts(const FitData& data, const sim::Plant& nominal,
                                      const MissingForce& missing, int most) {
  std::vector<std::pair<double, EffectSpec>> found;
  const std::vector<int> links = LinksOf(nominal.model());
  for (size_t p = 0; p < links.size(); ++p) {
    const std::vector<Stair> stairs = StairsAt(data, nominal, missing, links[p]);
    for (int axis = 0; axis < 3; ++axis) {
      for (const double sign : {1.0, -1.0}) {
        const Surface s = BestSurface(stairs, axis, sign);
        if (s.gain <= 0) continue;
        EffectSpec spec =
            MakeSpec(effects::Surface().id, {},
                     {{"stiffness", s.stiffness}, {"damping", 0.02 * s.stiffness}, {"height", s.height}});
        if (axis != 2 || sign < 0)
          spec.options["normal"] = (sign < 0 ? "-" : "") + std::string(kNormals[axis]);
        if (p > 0) spec.options["point"] = kPoints[p];
        found.push_back({s.gain, std::move(spec)});
      }
    }
  }
  std::ranges::sort(found, [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<TrialSpecs> out;
  for (const auto& [gain, spec] : found) {
    if (static_cast<int>(out.size()) >= most) break;
    out.push_back({spec});
  }
  return out;
}

std::vector<TrialSpecs> PushStarts(const FitData& data, const sim::Plant& nominal,
                                   const MissingForce& missing) {
  double duration = 0;
  for (const FineMotion& m : data.fine) duration = std::max(duration, m.t.back() - m.t.front());
  constexpr double kBin = 0.25;
  constexpr int kLongest = 12;
  const int bins = std::max(1, static_cast<int>(std::ceil(duration / kBin)));
  double best = 0, best_single = 0;
  EffectSpec spec;
  const std::vector<int> links = LinksOf(nominal.model());
  for (size_t p = 0; p < links.size(); ++p) {
    std::vector<Matrix3d> A(bins, Matrix3d::Zero());
    std::vector<Vector3d> b(bins, Vector3d::Zero());
    MatrixXd single_b = MatrixXd::Zero(data.n, bins), single_a = MatrixXd::Zero(data.n, bins);
    for (const Stair& s : StairsAt(data, nominal, missing, links[p])) {
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
        if (p > 0) spec.options["point"] = kPoints[p];
      }
    }
  }
  if (data.n < 3 || best <= best_single) return {};
  return {{spec}};
}

}  // namespace rg::diagnosis
