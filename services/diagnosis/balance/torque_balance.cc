#include "services/diagnosis/balance/torque_balance.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/regressors.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using effects::Regressor;
using Eigen::ArrayXd;

namespace {

constexpr double kHalfWindow = 0.03;  // s
constexpr double kRowStep = 0.02;     // s
constexpr double kPiece = 1.0;        // s: recordings are dealt to the folds in pieces of this length
constexpr int kMostBlocks = 12;       // folds
constexpr double kStillShare = 0.05;  // of a joint's RMS speed, below which it may stick
constexpr int kHats = 8;              // pieces of an unnamed force

// Hann weights over the fine grid.
struct Window {
  int half = 0;
  std::vector<double> weight;
};

Window MakeWindow(double dt, double period) {
  Window w;
  w.half = std::max(1, static_cast<int>(std::lround(std::max(kHalfWindow, period) / dt)));
  double sum = 0;
  for (int i = -w.half; i <= w.half; ++i) {
    w.weight.push_back(1.0 + std::cos(M_PI * i / (w.half + 1.0)));
    sum += w.weight.back();
  }
  for (double& x : w.weight) x /= sum;
  return w;
}

// Over the rows in which a joint moves; 0 where there are none.
double MovingRms(const VectorXd& x, const std::vector<char>& still) {
  double squares = 0, count = 1e-300;
  for (long k = 0; k < x.size(); ++k) {
    if (!still[k]) squares += x[k] * x[k], ++count;
  }
  return std::sqrt(squares / count);
}

class BalanceMaker {
 public:
  explicit BalanceMaker(const FitSetting& setting)
      : data_(setting.data), plant_(setting.nominal), s_(setting.scales) {
    out_.n = data_.n;
    out_.base = FreeParameters(plant_, s_, true);
    out_.tilt = static_cast<int>(out_.base.size());
    const model::RobotModel& robot = plant_.model();
    const std::string& last = robot.link(robot.joint(robot.num_joints() - 1).child_link).name;
    for (const auto field : model::kLinkParameterNames) {
      for (size_t i = 0; i < out_.base.size(); ++i) {
        const sim::Parameter& p = plant_.parameters()[out_.base[i].index];
        if (p.owner == last && p.field == field) out_.last_link.push_back(static_cast<int>(i));
      }
    }
    out_.half_window_s = std::max(kHalfWindow, data_.recordings[0].recording->SamplePeriod());
    out_.joints.resize(data_.n);
    still_ = (kStillShare * s_.speed).cwiseMax(3.0 * s_.speed_noise);
    MakeColumns();
  }

  TorqueBalance Take() {
    // Each fold has pieces of every recording: recordings differ in their motion, and a fold with all of one
    // motion would measure extrapolation.
    std::vector<int> pieces;
    for (const FineMotion& m : data_.fine)
      pieces.push_back(std::max(1, static_cast<int>(std::lround((m.t.back() - m.t.front()) / kPiece))));
    out_.blocks = std::min(kMostBlocks, std::accumulate(pieces.begin(), pieces.end(), 0));
    MakeRows();
    int first_piece = 0;
    for (size_t r = 0; r < data_.fine.size(); ++r) {
      AddRecording(static_cast<int>(r), first_piece, pieces[r]);
      first_piece += pieces[r];
    }
    Standardise();
    return std::move(out_);
  }

 private:
  void MakeColumns() {
    using enum Regressor;
    out_.columns.resize(data_.n);
    for (int j = 0; j < data_.n; ++j) {
      auto& c = out_.columns[j];
      for (const Regressor r : {kVelocity, kDirection, kConstant, kAcceleration, kSquaredVelocity, kEffort})
        c.push_back({r});
      c.push_back({kPosition, 0.5 * (s_.low[j] + s_.high[j])});
      c.push_back({kUnderLoad});
      for (const double share : {0.1, 0.25, 0.5}) c.push_back({kSlowly, share * s_.speed[j]});
      for (const double share : {0.15, 0.4, 1.0}) c.push_back({kWarmingUp, share * s_.duration});
      for (int k = 0; k < kHats; ++k) {
        for (const Regressor r : {kPositionPiece, kVelocityPiece}) c.push_back({r, static_cast<double>(k)});
      }
      std::erase_if(c, [&](const BalanceColumn& column) {
        return !plant_.Takes(effects::LawOf(column.regressor).id, j);
      });
    }
  }

  // φ of joint j over the fine grid.
  ArrayXd Feature(const BalanceColumn& c, const JointMotion& m, int j) const {
    const bool position = c.regressor == Regressor::kPositionPiece;
    if (!position && c.regressor != Regressor::kVelocityPiece) return ForceOf(c.regressor, m, {c.shape, 0});
    const double low = position ? s_.low[j] : -s_.top_speed[j],
                 high = position ? s_.high[j] : s_.top_speed[j];
    const double spacing = std::max(1e-12, (high - low) / (kHats - 1.0));
    return (1.0 - (((position ? m.q : m.v) - low) / spacing - c.shape).abs()).max(0.0);
  }

  static int StrideOf(double dt) { return std::max(1, static_cast<int>(std::lround(kRowStep / dt))); }

  // Space for the rows of all recordings.
  void MakeRows() {
    long rows = 0;
    for (size_t r = 0; r < data_.fine.size(); ++r) {
      const FineMotion& m = data_.fine[r];
      const double dt = m.t[1] - m.t[0];
      const int half = MakeWindow(dt, data_.recordings[r].recording->SamplePeriod()).half;
      for (int k = half; k + half < std::ssize(m.t); k += StrideOf(dt)) ++rows;
    }
    for (int j = 0; j < data_.n; ++j) {
      BalanceRows& o = out_.joints[j];
      o.base.resize(rows, std::ssize(out_.base) + 2);
      o.features.resize(rows, std::ssize(out_.columns[j]));
      for (VectorXd* x : {&o.rigid, &o.effort, &o.q, &o.v}) x->resize(rows);
    }
  }

  void AddRecording(int r, int first_piece, int pieces) {
    const FineMotion& m = data_.fine[r];
    const int F = static_cast<int>(m.t.size()), n = data_.n;
    const double dt = m.t[1] - m.t[0];
    const Window window = MakeWindow(dt, data_.recordings[r].recording->SamplePeriod());
    const int stride = StrideOf(dt);
    MatrixXd rigid(n, F);
    std::vector<MatrixXd> base(n, MatrixXd(out_.base.size() + 2, F));
    FillRigid(m, &rigid, &base);
    std::vector<MatrixXd> features(n);
    for (int j = 0; j < n; ++j) {
      // Computed from the rigid torque: the effort itself is the response.
      const JointMotion motion = MotionOf(m, rigid, j);
      features[j].resize(static_cast<long>(out_.columns[j].size()), F);
      for (size_t c = 0; c < out_.columns[j].size(); ++c)
        features[j].row(c) = Feature(out_.columns[j][c], motion, j).transpose().matrix();
    }
    const Eigen::Map<const VectorXd> w(window.weight.data(), static_cast<long>(window.weight.size()));
    for (int k = window.half; k + window.half < F; k += stride) {
      const int first = k - window.half, count = 2 * window.half + 1;
      const int block = (first_piece + std::min(pieces - 1, k * pieces / F)) % out_.blocks;
      for (int j = 0; j < n; ++j) {
        const auto v = m.v.row(j).segment(first, count);
        const bool still =
            plant_.IsPrescribed(j) || v.cwiseAbs().minCoeff() < still_[j] || v.maxCoeff() * v.minCoeff() < 0;
        BalanceRows& o = out_.joints[j];
        const auto row = static_cast<long>(o.t.size());
        o.base.row(row) = (base[j].middleCols(first, count) * w).transpose();
        o.features.row(row) = (features[j].middleCols(first, count) * w).transpose();
        o.q[row] = m.q.row(j).segment(first, count).dot(w), o.v[row] = v.dot(w);
        o.rigid[row] = rigid.row(j).segment(first, count).dot(w);
        o.effort[row] = m.u.row(j).segment(first, count).dot(w);
        o.t.push_back(m.t[k]), o.recording.push_back(r), o.block.push_back(block), o.still.push_back(still);
      }
    }
  }

  void FillRigid(const FineMotion& m, MatrixXd* rigid, std::vector<MatrixXd>* base) {
    const VectorXd values = plant_.parameters().Nominal();
    const dynamics::Mechanism mechanism(sysid::MechanismOf(plant_, values));
    const auto links = sysid::LinkParametersOf(plant_, values);
    std::vector<Eigen::Matrix<double, 10, 10>> lump(plant_.model().num_links());
    for (int i = 0; i < plant_.model().num_links(); ++i) {
      if (plant_.model().link(i).body >= 0)
        lump[i] = dynamics::LumpingJacobian(plant_.model(), i, links.col(i));
    }
    dynamics::Workspace workspace;
    const int n = data_.n, B = static_cast<int>(out_.base.size());
    VectorXd tau(n);
    MatrixXd Y(n, 10 * mechanism.num_bodies()), G(n, 3);
    for (int k = 0; k < rigid->cols(); ++k) {
      dynamics::Rnea(mechanism, workspace, m.q.col(k), m.v.col(k), m.a.col(k), tau);
      dynamics::TorqueRegressor(mechanism, workspace, m.q.col(k), m.v.col(k), m.a.col(k), Y);
      dynamics::RneaGravityDerivative(mechanism, workspace, m.q.col(k), G);
      for (int i = 0; i < B; ++i) {
        const sim::Parameter& p = plant_.parameters()[out_.base[i].index];
        const int link = plant_.model().FindLink(p.owner), joint = plant_.model().FindJoint(p.owner);
        VectorXd column = VectorXd::Zero(n);
        if (joint >= 0) {
          const double v = m.v(joint, k);
          column[joint] = p.kind == sim::ParameterKind::kDamping    ? v
                          : p.kind == sim::ParameterKind::kArmature ? m.a(joint, k)
                          : v > 0                                   ? 1.0
                                                                    : -1.0;
        } else if (link >= 0 && plant_.model().link(link).body >= 0) {
          for (int f = 0; f < model::kLinkParameters; ++f) {
            if (p.field == model::kLinkParameterNames[f])
              column = Y.middleCols(10 * plant_.model().link(link).body, 10) * lump[link].col(f);
          }
        }
        for (int j = 0; j < n; ++j) (*base)[j](i, k) = -out_.base[i].prior_stddev * column[j];
      }
      // Damping, rotors and friction that the URDF declares.
      for (int i = 0; i < plant_.parameters().size(); ++i) {
        const sim::Parameter& p = plant_.parameters()[i];
        const int j = plant_.model().FindJoint(p.owner);
        if (p.kind == sim::ParameterKind::kDamping) tau[j] += values[i] * m.v(j, k);
        if (p.kind == sim::ParameterKind::kArmature) tau[j] += values[i] * m.a(j, k);
        if (p.kind == sim::ParameterKind::kFriction) tau[j] += values[i] * (m.v(j, k) > 0 ? 1.0 : -1.0);
      }
      rigid->col(k) = tau;
      for (int j = 0; j < n; ++j) {
        (*base)[j](B, k) = -kTiltPrior * G(j, 0);
        (*base)[j](B + 1, k) = -kTiltPrior * G(j, 1);
      }
    }
  }

  // A coefficient of 1 makes half the joint's usual torque.
  void Standardise() {
    for (int j = 0; j < data_.n; ++j) {
      BalanceRows& o = out_.joints[j];
      for (long c = 0; c < o.features.cols() && o.features.rows() > 0; ++c) {
        const double rms = MovingRms(o.features.col(c), o.still);
        double& scale = out_.columns[j][c].scale;
        scale = rms > 0 ? 0.5 * s_.torque[j] / rms : 0.0;
        if (out_.columns[j][c].regressor == Regressor::kEffort) scale = std::min(scale, 0.3);
        o.features.col(c) *= scale;
      }
    }
  }

  const FitData& data_;
  const sim::Plant& plant_;
  const MotionScales& s_;
  VectorXd still_;
  TorqueBalance out_;
};

}  // namespace

void TorqueBalance::AddRipple(int joint, double cycles, double unit) {
  BalanceRows& rows = joints[joint];
  const Eigen::Matrix2Xd wave = RippleWave(rows, cycles, half_window_s);
  rows.features.conservativeResize(Eigen::NoChange, rows.features.cols() + 2);
  for (int i = 0; i < 2; ++i) {
    const double rms = MovingRms(wave.row(i).transpose(), rows.still), scale = rms > 0 ? unit / rms : 0.0;
    rows.features.col(rows.features.cols() - 2 + i) = scale * wave.row(i).transpose();
    columns[joint].push_back({i == 0 ? Regressor::kSine : Regressor::kCosine, cycles, scale});
  }
}

Eigen::Matrix2Xd RippleWave(const BalanceRows& rows, double cycles, double half_window_s) {
  Eigen::Matrix2Xd out(2, rows.q.size());
  for (long k = 0; k < rows.q.size(); ++k) {
    // Gain of the Hann window at the frequency of the wave at this speed.
    const double x = cycles * rows.v[k] * half_window_s, sinc = std::abs(x) > 1e-6 ? std::sin(x) / x : 1.0;
    const double pole = 1 - std::pow(x / M_PI, 2);
    const double left = std::abs(pole) > 1e-6 ? sinc / pole : 0.5;
    out(0, k) = left * std::sin(cycles * rows.q[k]);
    out(1, k) = left * std::cos(cycles * rows.q[k]);
  }
  return out;
}

TorqueBalance MakeTorqueBalance(const FitSetting& setting) { return BalanceMaker(setting).Take(); }

BalanceDrive MakeBalanceDrive(const FitSetting& setting, const TorqueBalance& balance, int other, int joint,
                              double ratio) {
  const auto& [data, nominal, scales] = setting;
  const BalanceRows& rows = balance.joints[joint];
  BalanceDrive out;
  out.other = other, out.joint = joint, out.ratio = ratio;
  out.columns.resize(static_cast<long>(rows.t.size()), BalanceDrive::kColumns);
  double squares = 0, count = 1e-300;
  for (const FineMotion& m : data.fine) {
    squares += (m.v.row(joint) + ratio * m.v.row(other)).squaredNorm();
    count += static_cast<double>(m.t.size());
  }
  const double noise = std::hypot(scales.speed_noise[joint], ratio * scales.speed_noise[other]);
  const double still = std::max(kStillShare * std::sqrt(squares / count), 3.0 * noise);
  for (size_t k = 0; k < rows.t.size(); ++k) {
    const FineMotion& m = data.fine[rows.recording[k]];
    const double dt = m.t[1] - m.t[0];
    const Window window = MakeWindow(dt, data.recordings[rows.recording[k]].recording->SamplePeriod());
    const long first = std::lround((rows.t[k] - m.t[0]) / dt) - window.half, length = 2 * window.half + 1;
    const auto sum = [&](const MatrixXd& x) {
      return (x.row(joint).segment(first, length) + ratio * x.row(other).segment(first, length))
          .array()
          .eval();
    };
    const Eigen::Map<const ArrayXd> weight(window.weight.data(), length);
    const ArrayXd w = sum(m.v).transpose(), dw = sum(m.a).transpose();
    out.columns.row(k) << -(w * weight).sum(), -(w.sign() * weight).sum(), -(dw * weight).sum();
    out.still.push_back(w.abs().minCoeff() < still || w.maxCoeff() * w.minCoeff() < 0);
  }
  for (int c = 0; c < BalanceDrive::kColumns; ++c) {
    const double rms = std::sqrt(out.columns.col(c).squaredNorm() / std::max<double>(1.0, rows.t.size()));
    out.scale[c] = rms > 0 ? 0.5 * scales.torque[joint] / rms : 0.0;
    out.columns.col(c) *= out.scale[c];
  }
  return out;
}

VectorXd TimedEffort(const FitData& data, const BalanceRows& rows, int joint, EffortTiming timing,
                     double seconds) {
  VectorXd out(rows.effort.size());
  if (rows.t.empty()) return out;
  int recording = -1;
  ArrayXd passed;
  for (size_t k = 0; k < rows.t.size(); ++k) {
    const FineMotion& m = data.fine[rows.recording[k]];
    const double dt = m.t[1] - m.t[0];
    if (rows.recording[k] != recording) {
      recording = rows.recording[k];
      passed.resize(static_cast<long>(m.t.size()));
      double state = m.u(joint, 0);
      for (long i = 0; i < passed.size(); ++i) {
        if (timing == EffortTiming::kDelay) {
          const double at = std::clamp(static_cast<double>(i) - seconds / dt, 0.0, passed.size() - 1.001);
          const auto k0 = static_cast<long>(at);
          const double w = at - static_cast<double>(k0);
          passed[i] = (1 - w) * m.u(joint, k0) + w * m.u(joint, k0 + 1);
        } else {
          state = m.u(joint, i) + (state - m.u(joint, i)) * std::exp(-dt / std::max(1e-6, seconds));
          passed[i] = state;
        }
      }
    }
    const Window window = MakeWindow(dt, data.recordings[recording].recording->SamplePeriod());
    const int at = static_cast<int>(std::lround((rows.t[k] - m.t[0]) / dt));
    double sum = 0;
    for (int i = -window.half; i <= window.half; ++i)
      sum += window.weight[static_cast<size_t>(i + window.half)] * passed[at + i];
    out[k] = sum;
  }
  return out;
}

}  // namespace rg::diagnosis
