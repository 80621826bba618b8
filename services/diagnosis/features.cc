#include "services/diagnosis/features.h"

#include <algorithm>
#include <cmath>
#include <functional>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using Eigen::ArrayXd;
using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr double kNextToNone = 0.1;  // of a band that few efforts lie in

double Quantile(std::vector<double> x, double p) {
  if (x.empty()) return 0;
  std::sort(x.begin(), x.end());
  return x[std::min(x.size() - 1, static_cast<size_t>(p * static_cast<double>(x.size())))];
}

// Everything about one joint over all recordings, one array per recording.
class Builder {
 public:
  Builder(const FitData& data, const sim::Plant& plant, const MotionScales& scales)
      : data_(data), plant_(plant), s_(scales) {}

  FeatureSet Take() {
    for (int j = 0; j < data_.n; ++j) AddJoint(j);
    Standardise();
    return std::move(out_);
  }

 private:
  using Law = std::function<ArrayXd(const FineMotion&, int joint)>;

  ArrayXd Sign(const FineMotion& m, int j) const {
    const double width = std::max(1e-9, 1.5 * s_.speed_noise[j]);
    return (m.v.row(j).transpose().array() / width).tanh();
  }

  // coefficient_scale 0: the force's RMS is brought to half the joint's torque.
  void Add(const std::string& effect, const std::string& role, int j, double shape, const Law& law,
           double coefficient_scale = 0, int other = -1) {
    if (!plant_.Takes(effect, j) || (other >= 0 && !plant_.Takes(effect, other))) return;
    Feature f{effect, role, j, other, shape, 1};
    std::vector<ArrayXd> values;
    double squares = 0, count = 0;
    for (const FineMotion& m : data_.fine) {
      values.push_back(law(m, j));
      squares += values.back().square().sum();
      count += static_cast<double>(values.back().size());
    }
    const double rms = std::sqrt(squares / std::max(1.0, count));
    if (!(rms > 1e-12) || !std::isfinite(rms)) return;
    f.scale = coefficient_scale > 0 ? coefficient_scale : 0.5 * s_.torque[j] / rms;
    for (ArrayXd& v : values) v *= f.scale;
    out_.features.push_back(f);
    fine_.push_back(std::move(values));
  }

  static ArrayXd Row(const MatrixXd& m, int j) { return m.row(j).transpose().array(); }

  void AddJoint(int j) {
    AddFriction(j);
    AddActuator(j);
    AddPosition(j);
    Add("rotor_inertia", "armature", j, 0,
        [](const FineMotion& m, int i) -> ArrayXd { return -Row(m.a, i); });
    AddTime(j);
  }

  void AddFriction(int j) {
    Add("viscous_friction", "viscous", j, 0,
        [](const FineMotion& m, int i) -> ArrayXd { return -Row(m.v, i); });
    Add("quadratic_drag", "quadratic", j, 0,
        [](const FineMotion& m, int i) -> ArrayXd { return -Row(m.v, i) * Row(m.v, i).abs(); });
    Add("coulomb_friction", "coulomb", j, 0,
        [this](const FineMotion& m, int i) -> ArrayXd { return -Sign(m, i); });
    Add("asymmetric_friction", "coulomb_positive", j, 0,
        [this](const FineMotion& m, int i) -> ArrayXd { return -Sign(m, i).max(0.0); });
    Add("asymmetric_friction", "coulomb_negative", j, 0,
        [this](const FineMotion& m, int i) -> ArrayXd { return -Sign(m, i).min(0.0); });
    for (const double share : {0.1, 0.25, 0.5}) {
      const double vs = share * s_.speed[j];
      Add("stribeck_friction", "drop", j, vs, [this, vs](const FineMotion& m, int i) -> ArrayXd {
        return -Sign(m, i) * (-(Row(m.v, i) / vs).square()).exp();
      });
    }
    Add("load_dependent_friction", "load", j, 0,
        [this](const FineMotion& m, int i) -> ArrayXd { return -Sign(m, i) * Row(m.u, i).abs(); });
    for (const double T : {0.15, 0.4, 1.0}) {
      const double seconds = T * s_.duration;
      Add("thermal_drift", "drop", j, seconds, [this, seconds](const FineMotion& m, int i) -> ArrayXd {
        const ArrayXd t = Eigen::Map<const ArrayXd>(m.t.data(), static_cast<Eigen::Index>(m.t.size()));
        return -Sign(m, i) * (-t / seconds).exp();
      });
    }
    for (const double z : {0.01, 0.03, 0.08}) {
      Add("presliding_hysteresis", "coulomb", j, z, [z](const FineMotion& m, int i) -> ArrayXd {
        ArrayXd f(m.q.cols());
        double x = 0;
        for (int k = 0; k < f.size(); ++k) {
          if (k > 0) {
            const double d = m.q(i, k) - m.q(i, k - 1);
            x = (x + d) / (1.0 + std::abs(d) / z);
            x = std::clamp(x, -z, z);
          }
          f[k] = -x / z;
        }
        return f;
      });
    }
  }

  void AddActuator(int j) {
    Add(
        "torque_gain", "gain", j, 0, [](const FineMotion& m, int i) -> ArrayXd { return Row(m.u, i); }, 0.3);
    Add("torque_offset", "offset", j, 0,
        [](const FineMotion& m, int) -> ArrayXd { return ArrayXd::Ones(m.q.cols()); });
    std::vector<double> size;
    for (const FineMotion& m : data_.fine) {
      for (int k = 0; k < m.u.cols(); ++k) size.push_back(std::abs(m.u(j, k)));
    }
    // The first is a band that next to no effort lies in, however small: a force against the command's sign.
    const double least = Quantile(size, 0.03);
    for (const double band :
         {kNextToNone * least, least, Quantile(size, 0.1), Quantile(size, 0.2), Quantile(size, 0.35)}) {
      Add(
          "torque_deadband", "deadband", j, band,
          [band](const FineMotion& m, int i) -> ArrayXd { return -Row(m.u, i).max(-band).min(band); }, 1.0);
    }
    for (const double p : {0.6, 0.75, 0.88, 0.96}) {
      const double limit = Quantile(size, p);
      Add(
          "torque_saturation", "limit", j, limit,
          [limit](const FineMotion& m, int i) -> ArrayXd {
            return Row(m.u, i).max(-limit).min(limit) - Row(m.u, i);
          },
          1.0);
    }
    for (const double T : {0.005, 0.012, 0.025, 0.045}) {
      Add(
          "actuator_delay", "delay", j, T,
          [T](const FineMotion& m, int i) -> ArrayXd {
            ArrayXd f(m.u.cols());
            const double dt = m.t[1] - m.t[0];
            for (int k = 0; k < f.size(); ++k) {
              const double at = std::max(0.0, k - T / dt);
              const int a = static_cast<int>(at);
              const double w = at - a;
              f[k] = (1 - w) * m.u(i, a) + w * m.u(i, std::min<int>(a + 1, static_cast<int>(f.size()) - 1)) -
                     m.u(i, k);
            }
            return f;
          },
          1.0);
      Add(
          "actuator_lag", "time_constant", j, T,
          [T](const FineMotion& m, int i) -> ArrayXd {
            ArrayXd f(m.u.cols());
            const double dt = m.t[1] - m.t[0], decay = std::exp(-dt / T);
            double x = m.u(i, 0);
            for (int k = 0; k < f.size(); ++k) {
              x = m.u(i, k) + (x - m.u(i, k)) * decay;
              f[k] = x - m.u(i, k);
            }
            return f;
          },
          1.0);
    }
    for (int other = 0; other < data_.n; ++other) {
      if (other == j) continue;
      Add(
          "joint_coupling", "coefficient", j, 0,
          [other](const FineMotion& m, int) -> ArrayXd { return Row(m.u, other); },
          0.5 * s_.torque[j] / std::max(1e-9, s_.torque[other]), other);
    }
  }

  void AddPosition(int j) {
    const double middle = 0.5 * (s_.low[j] + s_.high[j]),
                 half = std::max(1e-3, 0.5 * (s_.high[j] - s_.low[j]));
    Add("position_spring", "stiffness", j, middle,
        [middle](const FineMotion& m, int i) -> ArrayXd { return -(Row(m.q, i) - middle); });
    Add("position_spring", "cubic", j, middle,
        [middle](const FineMotion& m, int i) -> ArrayXd { return -(Row(m.q, i) - middle).cube(); });
    const double lowest = std::max(2.0, kLeastRipple * M_PI / half);
    const double step = std::min(1.0, 0.9 / half);
    const double highest = std::min(40.0, 200.0 / std::max(0.1, s_.top_speed[j]));
    const int count = static_cast<int>(std::min(48.0, (highest - lowest) / std::max(step, 0.5)));
    for (int k = 0; k < count; ++k) {
      const double cycles = lowest + std::max(step, 0.5) * k;
      Add("torque_ripple", "sin", j, cycles,
          [cycles](const FineMotion& m, int i) -> ArrayXd { return (cycles * Row(m.q, i)).sin(); });
      Add("torque_ripple", "cos", j, cycles,
          [cycles](const FineMotion& m, int i) -> ArrayXd { return (cycles * Row(m.q, i)).cos(); });
    }
    for (int k = 0; k < 8; ++k) {
      const double spacing = 2 * half / 7, at = s_.low[j] + spacing * k;
      Add("unknown_field", "position", j, at, [at, spacing](const FineMotion& m, int i) -> ArrayXd {
        const ArrayXd x = ((Row(m.q, i) - at) / spacing).abs();
        return ((2.0 - x).max(0.0).cube() - 4.0 * (1.0 - x).max(0.0).cube()) / 6.0;
      });
    }
  }

  void AddTime(int j) {
    const int bins = std::clamp(static_cast<int>(s_.duration / 0.4), 4, 24);
    for (int k = 0; k < bins; ++k) {
      const double begin = s_.duration * k / bins, end = s_.duration * (k + 1) / bins;
      Add(
          "external_disturbance", "torque", j, begin,
          [begin, end](const FineMotion& m, int) -> ArrayXd {
            ArrayXd f(m.q.cols());
            for (int i = 0; i < f.size(); ++i) {
              const double t = m.t[i] - m.t[0];
              f[i] = t >= begin && t < end ? 1.0 : 0.0;
            }
            return f;
          },
          s_.torque[j]);
    }
  }

  // Means over the intervals between nodes.
  void Standardise() {
    const int C = static_cast<int>(out_.features.size());
    for (const Feature& f : out_.features) out_.block.joint.push_back(f.joint);
    for (const NodeWindow& w : data_.windows) {
      const FineMotion& m = data_.fine[w.recording];
      const int N = static_cast<int>(w.t.size()) - 1, F = static_cast<int>(m.t.size());
      const double t0 = m.t[0], dt = m.t[1] - m.t[0];
      MatrixXd phi(C, N);
      for (int k = 0; k < N; ++k) {
        int a = std::clamp(static_cast<int>(std::ceil((w.t[k] - t0) / dt - 1e-6)), 0, F - 1);
        int b = std::clamp(static_cast<int>(std::ceil((w.t[k + 1] - t0) / dt - 1e-6)), a + 1, F);
        for (int c = 0; c < C; ++c) phi(c, k) = fine_[c][w.recording].segment(a, b - a).mean();
      }
      out_.block.phi.push_back(std::move(phi));
    }
  }

  const FitData& data_;
  const sim::Plant& plant_;
  const MotionScales& s_;
  FeatureSet out_;
  std::vector<std::vector<ArrayXd>> fine_;  // [feature][recording]
};

}  // namespace

MotionScales ScalesOf(const FitData& data, const sim::Plant& plant) {
  MotionScales s;
  const int n = data.n;
  for (VectorXd* x : {&s.torque, &s.speed, &s.top_speed, &s.inertia, &s.speed_noise}) x->setZero(n);
  s.low.setConstant(n, 1e9), s.high.setConstant(n, -1e9);
  VectorXd sum = VectorXd::Zero(n), squares = VectorXd::Zero(n), speed2 = VectorXd::Zero(n);
  double count = 0;
  for (const FineMotion& m : data.fine) {
    sum += m.u.rowwise().sum();
    squares += m.u.cwiseAbs2().rowwise().sum();
    speed2 += m.v.cwiseAbs2().rowwise().sum();
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
  VectorXd accelerations = VectorXd::Zero(n);
  for (const FineMotion& m : data.fine) accelerations += m.a.cwiseAbs2().rowwise().sum();
  s.acceleration = (accelerations / count).cwiseSqrt().cwiseMax(1e-3);
  for (int j = 0; j < n; ++j) {
    if (plant.IsPassive(j)) s.torque[j] = std::max(1e-6, s.inertia[j] * s.acceleration[j]);
  }
  return s;
}

FeatureSet MakeFeatures(const FitData& data, const sim::Plant& plant, const MotionScales& scales) {
  return Builder(data, plant, scales).Take();
}

}  // namespace rg::diagnosis
