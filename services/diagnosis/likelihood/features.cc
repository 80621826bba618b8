#include "services/diagnosis/likelihood/features.h"

#include <algorithm>
#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/effects/contact.h"
#include "common/effects/torque_ripple.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/data/touching_points.h"
#include "services/diagnosis/likelihood/regressors.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using effects::Regressor;
using Eigen::ArrayXd;

namespace {

constexpr double kNarrowBand = 0.1;   // of the least quantile of |effort|
constexpr double kLeastReach = 1e-4;  // m, of a point that meets a surface
// Quantiles of what it reaches.
constexpr double kHeights[] = {0.01, 0.03, 0.08, 0.14, 0.2, 0.27, 0.35, 0.45, 0.6, 0.75};

double Quantile(std::vector<double> x, double p) {
  if (x.empty()) return 0;
  std::ranges::sort(x);
  return x[std::min(x.size() - 1, static_cast<size_t>(p * static_cast<double>(x.size())))];
}

// Builds the signatures of all regressors at all shapes, joint by joint.
class Builder {
 public:
  // `near`: also those of effects that show around a model that fits alone.
  Builder(const FitData& data, const sim::Plant& plant, const MotionScales& scales, bool near)
      : data_(data), plant_(plant), s_(scales), near_(near) {}

  FeatureSet Along(const std::vector<FineMotion>& motions) {
    for (int j = 0; j < data_.n; ++j) {
      motions_.emplace_back();
      for (const FineMotion& m : motions) motions_.back().push_back(Smooth(m, j));
    }
    for (int j = 0; j < data_.n; ++j) AddJoint(j);
    Standardise();
    AddSurfaces(motions);
    return std::move(out_);
  }

 private:
  using Shapes = std::vector<RegressorShape>;

  JointMotion Smooth(const FineMotion& m, int j) const {
    JointMotion out = MotionOf(m, m.u, j);
    const double width = std::max(1e-9, 1.5 * s_.speed_noise[j]);
    out.direction = (m.v.row(j).transpose().array() / width).tanh();
    return out;
  }

  void AddJoint(int j) {
    using enum Regressor;
    // Regressors in one bracket share their shapes.
    static const std::vector<std::vector<Regressor>> kOwn = {
        {kVelocity},      {kSquaredVelocity},   {kDirection},
        {kForwards},      {kBackwards},         {kSlowly},
        {kUnderLoad},     {kWarmingUp},         {kBristle},
        {kEffort},        {kConstant},          {kInBand},
        {kBeyond},        {kDelayed, kLagging}, {kThroughSpring, kSprungRotor},
        {kOtherEffort},   {kPosition},          {kSine, kCosine},
        {kPositionPiece}, {kAcceleration},      {kPulse}};
    for (const auto& alike : kOwn) {
      for (const RegressorShape& shape : ShapesOf(alike.front(), j)) {
        for (const Regressor r : alike) {
          for (int other = 0; r == kOtherEffort && other < data_.n; ++other) {
            if (other != j) Add(r, j, shape, other);
          }
          if (r != kOtherEffort) Add(r, j, shape, -1);
        }
      }
    }
  }

  Shapes ShapesOf(Regressor r, int j) const {
    using enum Regressor;
    const double middle = 0.5 * (s_.low[j] + s_.high[j]),
                 half = std::max(1e-3, 0.5 * (s_.high[j] - s_.low[j]));
    Shapes out;
    const auto at = [&](const std::vector<double>& xs, double unit) {
      for (const double x : xs) out.push_back({x * unit, 0});
    };
    switch (r) {
      case kSlowly:
        at({0.1, 0.25, 0.5}, s_.speed[j]);
        break;
      case kWarmingUp:
        at({0.15, 0.4, 1.0}, s_.duration);
        break;
      case kBristle:
        at({0.01, 0.03, 0.08}, 1);
        break;
      case kInBand: {
        // The first band is narrower than nearly all efforts: a force against the command's sign.
        const double least = EffortQuantile(j, 0.03);
        at({kNarrowBand * least, least, EffortQuantile(j, 0.1), EffortQuantile(j, 0.2),
            EffortQuantile(j, 0.35)},
           1);
        break;
      }
      case kBeyond:
        for (const double p : {0.6, 0.75, 0.88, 0.96}) out.push_back({EffortQuantile(j, p), 0});
        break;
      case kDelayed:
      case kLagging:
        at({0.005, 0.012, 0.025, 0.045}, 1);
        break;
      case kThroughSpring:
      case kSprungRotor:
        at({3, 4.2, 6, 8.4, 12, 17, 24, 34}, 2 * M_PI);
        break;
      case kPosition:
        at({middle}, 1);
        break;
      case kSine:
      case kCosine: {
        const double lowest = std::max(2.0, effects::TorqueRipple::kLeastPeriods * M_PI / half);
        const double step = std::max(std::min(1.0, 0.9 / half), 0.5);
        const double highest = std::min(40.0, 200.0 / std::max(0.1, s_.top_speed[j]));
        const int count = static_cast<int>(std::min(48.0, (highest - lowest) / step));
        for (int k = 0; k < count; ++k) out.push_back({lowest + step * k, 0});
        break;
      }
      case kPositionPiece: {
        const double spacing = 2 * half / 7;
        for (int k = 0; k < 8; ++k) out.push_back({s_.low[j] + spacing * k, spacing});
        break;
      }
      case kPulse: {
        const int bins = std::clamp(static_cast<int>(s_.duration / 0.4), 4, 24);
        for (int k = 0; k < bins; ++k) out.push_back({s_.duration * k / bins, s_.duration * (k + 1) / bins});
        break;
      }
      default:
        out.push_back({});
    }
    return out;
  }

  double EffortQuantile(int j, double p) const {
    std::vector<double> size;
    for (const JointMotion& m : motions_[j]) {
      for (const double u : m.effort) size.push_back(std::abs(u));
    }
    return Quantile(std::move(size), p);
  }

  // The coefficient of one prior stddev; 0: that which makes the force's RMS half the joint's torque.
  double UnitOf(Regressor r, int j, int other) const {
    using Near = effects::Inference::Near;
    if (r == Regressor::kEffort) return 0.3;
    if (r == Regressor::kPulse) return s_.torque[j];
    if (r == Regressor::kSprungRotor) return s_.inertia[j];
    if (r == Regressor::kOtherEffort) return 0.5 * s_.torque[j] / std::max(1e-9, s_.torque[other]);
    return effects::InferenceOf(effects::LawOf(r).id).coefficient == Near::kAny ? 0.0 : 1.0;
  }

  void Add(Regressor r, int j, const RegressorShape& shape, int other) {
    const std::string& law = effects::LawOf(r).id;
    if (!plant_.Takes(law, j) || (other >= 0 && !plant_.Takes(law, other))) return;
    if (!near_ && effects::InferenceOf(law).needs_fit) return;
    std::vector<ArrayXd> values;
    for (const JointMotion& m : motions_[static_cast<size_t>(other >= 0 ? other : j)])
      values.push_back(ForceOf(r, m, shape));
    Push({r, j, other, shape.x, 1}, UnitOf(r, j, other), std::move(values));
  }

  // `values`: per unit coefficient. `unit`: as UnitOf.
  void Push(Feature f, double unit, std::vector<ArrayXd> values) {
    double squares = 0, count = 0;
    for (const ArrayXd& v : values) {
      squares += v.square().sum();
      count += static_cast<double>(v.size());
    }
    const double rms = std::sqrt(squares / std::max(1.0, count));
    if (!(rms > 1e-12) || !std::isfinite(rms)) return;
    f.scale = unit > 0 ? unit : 0.5 * s_.torque[f.joint] / rms;
    for (ArrayXd& v : values) v *= f.scale;
    out_.features.push_back(f);
    fine_.push_back(std::move(values));
  }

  // Rows of the fine motion in each interval between a window's nodes: the first, and how many.
  std::vector<std::pair<int, int>> RowsOf(const NodeWindow& w) const {
    const FineMotion& m = data_.fine[w.recording];
    const int F = static_cast<int>(m.t.size());
    const double t0 = m.t[0], dt = m.t[1] - m.t[0];
    std::vector<std::pair<int, int>> out;
    for (size_t k = 0; k + 1 < w.t.size(); ++k) {
      const int a = std::clamp(static_cast<int>(std::ceil((w.t[k] - t0) / dt - 1e-6)), 0, F - 1);
      const int b = std::clamp(static_cast<int>(std::ceil((w.t[k + 1] - t0) / dt - 1e-6)), a + 1, F);
      out.push_back({a, b - a});
    }
    return out;
  }

  // Means over the intervals between nodes.
  void Standardise() {
    const int C = static_cast<int>(out_.features.size());
    for (const Feature& f : out_.features) out_.block.joint.push_back(f.joint);
    for (const NodeWindow& w : data_.windows) {
      const auto rows = RowsOf(w);
      MatrixXd phi(C, std::ssize(rows));
      for (int k = 0; k < phi.cols(); ++k) {
        for (int c = 0; c < C; ++c)
          phi(c, k) = fine_[c][w.recording].segment(rows[k].first, rows[k].second).mean();
      }
      out_.block.phi.push_back(std::move(phi));
    }
  }

  // Surfaces at quantiles of what each point that may touch them reaches, on all six sides of it.
  void AddSurfaces(const std::vector<FineMotion>& all) {
    for (const NodeWindow& w : data_.windows)
      out_.block.on_robot.emplace_back(data_.n * (std::ssize(w.t) - 1), 0);
    const std::vector<std::string> normals = effects::Surface().options.at("normal");
    for (const TouchingPoint& point : TouchingPoints(plant_.model())) {
      std::vector<PointMotion> motions;
      for (const FineMotion& m : all) motions.push_back(MotionOf(point, plant_.model(), m.q));
      for (int normal = 0; normal < static_cast<int>(normals.size()); ++normal) {
        std::map<std::string, std::string> options;
        if (normal > 0) options["normal"] = normals[static_cast<size_t>(normal)];
        if (!point.option.empty()) options["point"] = point.option;
        std::vector<double> along;
        for (const PointMotion& m : motions) {
          const ArrayXd x = effects::Contact::Sign(normal) * m.position.row(effects::Contact::Axis(normal));
          along.insert(along.end(), x.begin(), x.end());
        }
        std::ranges::sort(along);
        if (along.back() - along.front() < kLeastReach) continue;
        for (const double p : kHeights) {
          const double height = along[static_cast<size_t>(p * static_cast<double>(along.size()))];
          AddSurface({options, height}, normal, motions);
        }
      }
    }
  }

  // What it does to the joints, on average over intervals; its scale makes half of each joint's torque, in
  // the quadratic mean of all.
  void AddSurface(SurfaceFeature surface, int normal, const std::vector<PointMotion>& motions) {
    const double unit[] = {1, 0, surface.height};
    const int axis = effects::Contact::Axis(normal), sign = effects::Contact::Sign(normal);
    std::vector<VectorXd> columns;
    VectorXd squares = VectorXd::Zero(data_.n);
    double count = 0;
    for (const NodeWindow& w : data_.windows) {
      const PointMotion& m = motions[static_cast<size_t>(w.recording)];
      const auto rows = RowsOf(w);
      MatrixXd mean = MatrixXd::Zero(std::ssize(rows), data_.n);
      for (Eigen::Index k = 0; k < mean.rows(); ++k) {
        const auto [first, some] = rows[static_cast<size_t>(k)];
        for (int i = first; i < first + some; ++i) {
          const double force = sign * effects::Contact::Push<double>(unit, sign * m.position(axis, i), 0.0);
          if (force == 0) continue;
          mean.row(k) += force / some * m.jacobian[static_cast<size_t>(axis)].col(i).transpose();
        }
      }
      squares += mean.colwise().squaredNorm().transpose(), count += static_cast<double>(mean.rows());
      columns.push_back(mean.reshaped());
    }
    // Nothing acts on joints whose motion is prescribed.
    double shares = 0, joints = 0;
    for (int j = 0; j < data_.n; ++j) {
      if (plant_.IsPrescribed(j)) continue;
      shares += squares[j] / count / (s_.torque[j] * s_.torque[j]), ++joints;
    }
    const double share = std::sqrt(shares / std::max(1.0, joints));
    if (!(share > 1e-12) || !std::isfinite(share)) return;
    surface.scale = 0.5 / share;
    out_.surfaces.push_back(surface);
    for (size_t w = 0; w < columns.size(); ++w) {
      MatrixXd& block = out_.block.on_robot[w];
      block.conservativeResize(Eigen::NoChange, block.cols() + 1);
      block.rightCols<1>() = surface.scale * columns[w];
    }
  }

  const FitData& data_;
  const sim::Plant& plant_;
  const MotionScales& s_;
  const bool near_;
  FeatureSet out_;
  std::vector<std::vector<JointMotion>> motions_;  // [joint][recording]
  std::vector<std::vector<ArrayXd>> fine_;         // [feature][recording]
};

}  // namespace

MotionScales ScalesOf(const FitData& data, const sim::Plant& plant) {
  MotionScales s;
  const int n = data.n;
  for (VectorXd* x : {&s.torque, &s.speed, &s.top_speed, &s.inertia, &s.speed_noise}) x->setZero(n);
  s.low.setConstant(n, 1e9), s.high.setConstant(n, -1e9);
  VectorXd sum = VectorXd::Zero(n), squares = sum, speed2 = sum, acceleration2 = sum;
  double count = 0;
  for (const FineMotion& m : data.fine) {
    sum += m.u.rowwise().sum();
    squares += m.u.cwiseAbs2().rowwise().sum();
    speed2 += m.v.cwiseAbs2().rowwise().sum();
    acceleration2 += m.a.cwiseAbs2().rowwise().sum();
    count += static_cast<double>(m.u.cols());
    s.top_speed = s.top_speed.cwiseMax(m.v.cwiseAbs().rowwise().maxCoeff());
    s.low = s.low.cwiseMin(m.q.rowwise().minCoeff());
    s.high = s.high.cwiseMax(m.q.rowwise().maxCoeff());
    s.duration = std::max(s.duration, m.t.back() - m.t.front());
  }
  const VectorXd mean = sum / count;
  s.torque = (squares / count - mean.cwiseAbs2()).cwiseMax(0.0).cwiseSqrt() + mean.cwiseAbs() / 3;
  s.torque = s.torque.cwiseMax(1e-6 + 1e-3 * s.torque.maxCoeff());
  s.speed = (speed2 / count).cwiseSqrt().cwiseMax(1e-4);
  for (int j = 0; j < n; ++j) {
    // Rows within the smoothing window share the noise.
    const double period = data.recordings[0].recording->SamplePeriod();
    const double rows = std::max(1.0, data.motions[0].half_span() / period);
    const double from_positions =
        1.5 * data.noise.position_stddev[j] / data.motions[0].half_span() / std::sqrt(rows);
    s.speed_noise[j] = data.use_velocity
                           ? std::min(data.noise.velocity_stddev[j] / std::sqrt(rows), from_positions)
                           : from_positions;
    s.still.push_back(s.high[j] - s.low[j] < kMovesBy * data.noise.position_stddev[j]);
  }
  const dynamics::Mechanism mechanism(sysid::MechanismOf(plant, plant.parameters().Nominal()));
  dynamics::Workspace workspace;
  MatrixXd M(n, n);
  const FineMotion& first = data.fine.front();
  for (int k = 0; k < 5; ++k) {
    dynamics::Crba(mechanism, workspace, first.q.col(first.q.cols() * k / 5), M);
    s.inertia += M.diagonal() / 5;
  }
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kArmature))
    s.inertia[plant.model().FindJoint(plant.parameters()[i].owner)] += plant.parameters()[i].nominal;
  s.acceleration = (acceleration2 / count).cwiseSqrt().cwiseMax(1e-3);
  for (int j = 0; j < n; ++j) {
    if (plant.IsPassive(j)) s.torque[j] = std::max(1e-6, s.inertia[j] * s.acceleration[j]);
  }
  return s;
}

FeatureSet OfJoints(const FeatureSet& features) {
  return {features.features, {}, {features.block.joint, features.block.phi, {}}};
}

FeatureSet MakeFeatures(const FitData& data, const sim::Plant& plant, const MotionScales& scales) {
  return Builder(data, plant, scales, false).Along(data.fine);
}

FeatureSet MakeFeatures(const FitData& data, const sim::Plant& plant, const MotionScales& scales,
                        const std::vector<FineMotion>& motions) {
  return Builder(data, plant, scales, true).Along(motions);
}

}  // namespace rg::diagnosis
