#include "services/sysid/initial_regression.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "common/base/check.h"
#include "common/dynamics/dynamics.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/sysid/boxed_newton_step.h"
#include "services/sysid/drive_signal.h"

namespace rg::sysid {
namespace {

using effects::Regressor;
using Eigen::MatrixXd;
using Eigen::VectorXd;

using Sample = MotionSample;

// Local cubic at row `row`: weights of value, slope and second derivative on rows first … last.
struct Cubic {
  int first = 0, last = 0;
  Eigen::Matrix<double, 3, Eigen::Dynamic> weights;
};

Cubic FitCubic(const VectorXd& t, int row, double half_span) {
  Cubic c{row, row, {}};
  const int K = static_cast<int>(t.size());
  while (c.first > 0 && (t[row] - t[c.first - 1] <= half_span || row - c.first < 3)) --c.first;
  while (c.last + 1 < K && (t[c.last + 1] - t[row] <= half_span || c.last - row < 3)) ++c.last;
  const int m = c.last - c.first + 1;
  const double scale = std::max(t[row] - t[c.first], t[c.last] - t[row]);
  MatrixXd V(m, 4);
  for (int i = 0; i < m; ++i) {
    const double s = (t[c.first + i] - t[row]) / scale;
    V.row(i) << 1.0, s, s * s, s * s * s;
  }
  const MatrixXd solve = (V.transpose() * V).ldlt().solve(V.transpose());
  c.weights.resize(3, m);
  c.weights.row(0) = solve.row(0);
  c.weights.row(1) = solve.row(1) / scale;
  c.weights.row(2) = 2.0 * solve.row(2) / (scale * scale);
  return c;
}

// The mean effort around each row: a held command changes at its row, so it is averaged over the
// neighbouring halves.
MatrixXd EffortAroundRows(const FitRecording& fit) {
  const VectorXd& t = fit.recording->t;
  const int K = static_cast<int>(t.size()), n = fit.recording->n();
  MatrixXd effort(n, K);
  for (int k = 0; k < K; ++k) {
    const double begin = k > 0 ? 0.5 * (t[k - 1] + t[k]) : t[k];
    const double end = k + 1 < K ? 0.5 * (t[k] + t[k + 1]) : t[k];
    for (int j = 0; j < n; ++j) {
      effort(j, k) = end > begin ? fit.command.Average(j, begin, end) : fit.command.At(j, t[k]);
    }
  }
  return effort;
}

void AddSamples(const FitRecording& fit, const RegressionOptions& options, int stride,
                std::vector<Sample>* out) {
  const recordings::Recording& rec = *fit.recording;
  if (rec.rows() < 9) return;
  const MatrixXd effort = EffortAroundRows(fit);
  for (int row = 3; row + 3 < rec.rows(); row += stride) {
    const Cubic c = FitCubic(rec.t, row, options.half_span_s);
    // A gap in the rows: no derivative from across it.
    if (rec.t[c.last] - rec.t[c.first] > 4.0 * std::max(options.half_span_s, 3.0 * rec.SamplePeriod()))
      continue;
    const MatrixXd q = rec.q.middleCols(c.first, c.last - c.first + 1) * c.weights.transpose();  // n × 3
    Sample s{q.col(0), q.col(1), q.col(2), {}};
    s.effort = effort.middleCols(c.first, c.last - c.first + 1) * c.weights.row(0).transpose();
    out->push_back(std::move(s));
  }
}

// What a regressor's coefficient multiplies on the model's side of a joint's torque balance; q: less the
// regressor's shape. Nothing where the regression does not know it.
std::optional<double> ColumnOf(Regressor regressor, double q, double v, double a) {
  switch (regressor) {
    case Regressor::kPosition:
      return q;
    case Regressor::kVelocity:
      return v;
    case Regressor::kDirection:
      return v > 0.0 ? 1.0 : -1.0;
    case Regressor::kForwards:
      return v > 0.0 ? 1.0 : 0.0;
    case Regressor::kBackwards:
      return v > 0.0 ? 0.0 : -1.0;
    case Regressor::kSquaredVelocity:
      return v * std::abs(v);
    case Regressor::kAcceleration:
      return a;
    case Regressor::kConstant:
      return -1.0;
    default:
      return std::nullopt;
  }
}

// A parameter with a place in its joint's torque balance: the regressor that it multiplies, or the drive's
// effort.
struct JointColumn {
  std::optional<Regressor> regressor;  // of a force of the joint; none: its effort
  double At(double v, double a, double u) const { return regressor ? *ColumnOf(*regressor, 0, v, a) : -u; }
};

std::optional<JointColumn> ColumnOf(const sim::Parameter& p) {
  if (p.kind == sim::ParameterKind::kDamping) return JointColumn{Regressor::kVelocity};
  if (p.kind == sim::ParameterKind::kFriction) return JointColumn{Regressor::kDirection};
  if (p.kind == sim::ParameterKind::kForceGain) return JointColumn{};
  if (p.kind == sim::ParameterKind::kArmature) return JointColumn{Regressor::kAcceleration};
  if (!RegressionKnows(p.effect)) return std::nullopt;
  for (const effects::Term& t : effects::InferenceOf(p.effect).terms) {
    if (std::find(t.adds_to.begin(), t.adds_to.end(), p.field) != t.adds_to.end())
      return JointColumn{t.regressor};
  }
  return std::nullopt;
}

class Regression {
 public:
  Regression(const sim::Plant& plant, VectorXd values, const FitSpace& space, VectorXd theta,
             std::vector<Sample> samples, const RegressionOptions& options,
             const std::vector<RegressionColumn>& further)
      : plant_(plant),
        values_(std::move(values)),
        space_(space),
        parameters_(space.parameters()),
        theta_(std::move(theta)),
        samples_(std::move(samples)),
        options_(options),
        further_(further),
        n_(plant.num_joints()),
        P_(space.size()),
        C_(static_cast<int>(further.size())),
        coefficients_(VectorXd::Zero(C_)),
        mechanism_(plant.model()) {
    FindStillSpeeds();
    for (int i = 0; i < plant.parameters().size(); ++i) columns_.push_back(ColumnOf(plant.parameters()[i]));
    stddev_ = VectorXd::Ones(n_);
  }

  void Iterate() {
    values_ = space_.Values(theta_, std::move(values_));
    const int S = static_cast<int>(samples_.size());
    J_.setZero(S * n_, P_ + C_);
    r_.setZero(S * n_);
    used_.assign(S * n_, false);
    PrepareMechanism();
    for (int s = 0; s < S; ++s) FillRows(s);
    EstimateScale();
    Step();
  }

  RegressionResult Result() const {
    RegressionResult out;
    out.theta = theta_;
    out.coefficients = coefficients_;
    out.torque_stddev = stddev_;
    out.rows = static_cast<int>(samples_.size());
    return out;
  }

 private:
  void FindStillSpeeds() {
    still_ = VectorXd::Zero(n_);
    for (const Sample& s : samples_) still_ += s.v.cwiseAbs2();
    still_ = options_.still_share * (still_ / samples_.size()).cwiseSqrt();
  }

  void PrepareMechanism() {
    const auto links = LinkParametersOf(plant_, values_);
    mechanism_.SetLinkParameters(plant_.model(), links);
    mechanism_.SetGravity(GravityOf(plant_, values_));
    link_jacobian_.clear();
    for (int i = 0; i < plant_.model().num_links(); ++i) {
      link_jacobian_.push_back(plant_.model().link(i).body < 0
                                   ? Eigen::Matrix<double, 10, 10>::Zero()
                                   : dynamics::LumpingJacobian(plant_.model(), i, links.col(i)));
    }
  }

  // Rows of one sample: J = d(model torque)/dp, r = model torque − drive torque.
  void FillRows(int s) {
    const Sample& x = samples_[s];
    VectorXd tau(n_);
    MatrixXd Y(n_, 10 * mechanism_.num_bodies());
    dynamics::Rnea(mechanism_, workspace_, x.q, x.v, x.a, tau);
    dynamics::TorqueRegressor(mechanism_, workspace_, x.q, x.v, x.a, Y);
    auto J = J_.middleRows(s * n_, n_);
    for (int i = 0; i < P_; ++i) FillColumn(x, Y, i, J.col(i));
    AddJointTorques(x, &tau);
    for (int c = 0; c < C_; ++c) {
      const RegressionColumn& f = further_[static_cast<size_t>(c)];
      const double column = *ColumnOf(f.regressor, x.q[f.joint] - f.shape, x.v[f.joint], x.a[f.joint]);
      J(f.joint, P_ + c) = column;
      tau[f.joint] += coefficients_[c] * column;
    }
    for (int j = 0; j < n_; ++j) {
      r_[s * n_ + j] = tau[j];
      used_[s * n_ + j] = std::abs(x.v[j]) > still_[j] && !plant_.IsPrescribed(j);
    }
  }

  template <class Column>
  void FillColumn(const Sample& x, const MatrixXd& Y, int i, Column column) {
    const sim::Parameter& p = plant_.parameters()[parameters_[i].index];
    if (const auto& own = columns_[static_cast<size_t>(parameters_[i].index)]) {
      const int j = plant_.model().FindJoint(p.owner);
      column[j] = own->At(x.v[j], x.a[j], x.effort[j]);
      return;
    }
    const int link = plant_.model().FindLink(p.owner);
    if (p.kind == sim::ParameterKind::kGravity) {
      MatrixXd dtau_dg(n_, 3);
      dynamics::RneaGravityDerivative(mechanism_, workspace_, x.q, dtau_dg);
      column = dtau_dg.col(p.field == "x" ? 0 : p.field == "y" ? 1 : 2);
    } else if (link >= 0 && plant_.model().link(link).body >= 0 && p.effect.empty()) {
      for (int k = 0; k < model::kLinkParameters; ++k) {
        if (p.field != model::kLinkParameterNames[k]) continue;
        column = Y.middleCols(10 * plant_.model().link(link).body, 10) * link_jacobian_[link].col(k);
      }
    }
  }

  // Every parameter of the plant with a place in the joint's balance acts, fitted or not.
  void AddJointTorques(const Sample& x, VectorXd* tau) const {
    for (int i = 0; i < plant_.parameters().size(); ++i) {
      const auto& own = columns_[static_cast<size_t>(i)];
      if (!own) continue;
      const int j = plant_.model().FindJoint(plant_.parameters()[i].owner);
      if (j >= 0) (*tau)[j] += values_[i] * own->At(x.v[j], x.a[j], x.effort[j]);
    }
  }

  // Median absolute residual per joint.
  void EstimateScale() {
    for (int j = 0; j < n_; ++j) {
      std::vector<double> values;
      for (int k = j; k < r_.size(); k += n_) {
        if (used_[k]) values.push_back(std::abs(r_[k]));
      }
      stddev_[j] = 1.0;
      if (values.empty()) continue;
      std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
      stddev_[j] = std::max(1e-9, 1.4826 * values[values.size() / 2]);
    }
  }

  void Step() {
    const int all = P_ + C_;
    J_.leftCols(P_) *= space_.Jacobian(theta_);
    for (int k = 0; k < r_.size(); ++k) {
      const double z = r_[k] / stddev_[k % n_];
      const double weight = std::min(1.0, options_.huber / std::max(1e-12, std::abs(z)));
      const double root = used_[k] ? std::sqrt(weight) / stddev_[k % n_] : 0.0;
      J_.row(k) *= root;
      r_[k] *= root;
    }
    MatrixXd H = MatrixXd::Zero(all, all);
    H.selfadjointView<Eigen::Lower>().rankUpdate(J_.transpose());
    H = MatrixXd(H.selfadjointView<Eigen::Lower>());
    VectorXd g = J_.transpose() * r_;
    VectorXd low(all), high(all), information(all), from_prior(all);
    low << (space_.lower() - theta_).cwiseMin(0.0), VectorXd::Constant(C_, -effects::kInf);
    high << (space_.upper() - theta_).cwiseMax(0.0), VectorXd::Constant(C_, effects::kInf);
    information.head(P_) = space_.prior_stddev().cwiseAbs2().cwiseInverse();
    for (int c = 0; c < C_; ++c)
      information[P_ + c] = 1.0 / std::pow(further_[static_cast<size_t>(c)].prior_stddev, 2);
    from_prior << theta_ - space_.nominal(), coefficients_;
    H.diagonal() += information;
    g += information.cwiseProduct(from_prior);
    const VectorXd step = BoxedNewtonStep(H, g, low, high);
    theta_ += step.head(P_);
    coefficients_ += step.tail(C_);
  }

  const sim::Plant& plant_;
  VectorXd values_;
  const FitSpace& space_;
  const std::vector<FitParameter>& parameters_;
  VectorXd theta_;
  std::vector<Sample> samples_;
  const RegressionOptions& options_;
  const std::vector<RegressionColumn>& further_;
  int n_, P_, C_;
  VectorXd coefficients_;  // of the further columns
  dynamics::Mechanism mechanism_;
  dynamics::Workspace workspace_;
  std::vector<Eigen::Matrix<double, 10, 10>> link_jacobian_;
  std::vector<std::optional<JointColumn>> columns_;  // per parameter of the plant
  VectorXd still_, stddev_;
  MatrixXd J_;
  VectorXd r_;
  std::vector<bool> used_;
};

}  // namespace

std::optional<double> RegressionColumnOf(Regressor regressor, double q, double v, double a) {
  return ColumnOf(regressor, q, v, a);
}

bool RegressionKnows(const std::string& effect) {
  const auto& terms = effects::InferenceOf(effect).terms;
  return !terms.empty() && std::all_of(terms.begin(), terms.end(), [](const effects::Term& t) {
    return ColumnOf(t.regressor, 1.0, 1.0, 1.0).has_value() && t.regressor != Regressor::kPosition;
  });
}

std::vector<MotionSample> SampleMotion(const std::vector<FitRecording>& recordings,
                                       const RegressionOptions& options) {
  double total = 0.0;
  for (const FitRecording& fit : recordings) {
    const double rate = 1.0 / std::max(1e-9, fit.recording->SamplePeriod());
    total += fit.recording->rows() / std::max(1.0, rate / options.rate_hz);
  }
  const double thin = std::max(1.0, total / options.max_rows);
  std::vector<Sample> samples;
  for (const FitRecording& fit : recordings) {
    const double rate = 1.0 / std::max(1e-9, fit.recording->SamplePeriod());
    const int stride =
        std::max(1, static_cast<int>(std::lround(std::max(1.0, rate / options.rate_hz) * thin)));
    AddSamples(fit, options, stride, &samples);
  }
  return samples;
}

RegressionResult RegressInverseDynamics(const sim::Plant& plant, const VectorXd& values,
                                        const FitSpace& space, const VectorXd& theta,
                                        const std::vector<FitRecording>& recordings,
                                        const RegressionOptions& options,
                                        const std::vector<RegressionColumn>& further) {
  RG_CHECK(values.size() == plant.parameters().size() && theta.size() == space.size());
  std::vector<Sample> samples = SampleMotion(recordings, options);
  if (samples.size() < 10) {
    const VectorXd zero = VectorXd::Zero(plant.num_joints());
    return {theta, VectorXd::Zero(static_cast<long>(further.size())), zero, 0};
  }
  Regression regression(plant, values, space, theta, std::move(samples), options, further);
  for (int k = 0; k < options.iterations; ++k) regression.Iterate();
  return regression.Result();
}

}  // namespace rg::sysid
