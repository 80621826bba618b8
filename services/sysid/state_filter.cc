#include "services/sysid/state_filter.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/base/check.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kMaxPiece = 0.01;          // s: a measured effort is averaged over at most this
constexpr double kUnknownSpeed = 1.0;       // rad/s or m/s: prior where velocity is not measured
constexpr double kInternalVariance = 1e-6;  // of internal states at the start
constexpr double kStartAcceleration = 1.0;  // rad/s² per sqrt(Hz)
constexpr double kLowAcceleration = 1e-3, kHighAcceleration = 1e3;
constexpr double kAdaptation = 0.05;  // of the log strength per innovation
constexpr double kMaxExcess = 4.0;

}  // namespace

void PlacePrescribed(const sim::CommandSignal& command, double time, sim::State* x) {
  if (command.motion() == nullptr) return;
  const std::vector<int>& joints = command.motion()->joints();
  for (size_t i = 0; i < joints.size(); ++i) {
    const sim::GivenMotion::Point told = command.motion()->At(static_cast<int>(i), time);
    x->q[joints[i]] = told.q, x->v[joints[i]] = told.v;
  }
}

StateFilter::StateFilter(sim::Simulator* simulator, const recordings::Recording& recording,
                         const sim::CommandSignal& command, const recordings::SensorNoise& noise,
                         DriveTorque drive_torque)
    : simulator_(*simulator),
      recording_(recording),
      command_(command),
      drive_torque_(std::move(drive_torque)),
      position_variance_(noise.position_stddev.cwiseAbs2()),
      velocity_variance_(noise.velocity_stddev.cwiseAbs2()),
      n_(recording.n()),
      nx_(simulator->plant().num_states()) {
  RG_CHECK(position_variance_.size() == n_ && velocity_variance_.size() == n_);
  log_acceleration_ = VectorXd::Constant(n_, std::log(kStartAcceleration));
  PlaceSensors();
  FindLatePositions();
}

const sim::State& StateFilter::StateAt(int row) {
  RG_CHECK(row >= row_ && row < recording_.rows());
  if (row_ < 0) Start(0);
  while (row_ < row) Step(row_ + 1);
  return x_;
}

void StateFilter::Start(int row) {
  row_ = row;
  VectorXd v = VectorXd::Zero(n_);
  if (recording_.has_velocity()) {
    v = recording_.v.col(row);
  } else if (row > 0) {
    v = recordings::EstimateStateCausal(recording_, row).v;
  }
  x_ = simulator_.MakeState(recording_.q.col(row), v, recording_.t[row], command_);
  // Link and motor together, until the encoder would have said what it said.
  VectorXd seen(n_), rate(n_);
  simulator_.Measure(x_, &seen, &rate);
  for (int j = 0; j < n_; ++j) {
    const double shift = recording_.q(j, row) - seen[j];
    x_.q[j] += shift;
    if (position_index_[j] != j) x_.z[position_index_[j] - 2 * n_] += shift;
  }
  PlacePrescribed(command_, recording_.t[row], &x_);
  P_ = kInternalVariance * MatrixXd::Identity(nx_, nx_);
  P_.diagonal().head(n_) = position_variance_;
  P_.diagonal().segment(n_, n_).setConstant(kUnknownSpeed * kUnknownSpeed);
  if (recording_.has_velocity()) P_.diagonal().segment(n_, n_) = velocity_variance_;
  for (int j = 0; j < n_; ++j) {
    if (position_index_[j] == j) continue;
    P_(position_index_[j], position_index_[j]) = position_variance_[j];
    P_(j, j) = kInternalVariance;
  }
  for (const int j : recording_.prescribed) P_(j, j) = P_(n_ + j, n_ + j) = 0.0;
}

void StateFilter::PlaceSensors() {
  const sim::Plant& plant = simulator_.plant();
  const auto& names = plant.internal_state_names();
  for (int j = 0; j < n_; ++j) {
    position_index_.push_back(j);
    velocity_index_.push_back(n_ + j);
  }
  for (const effects::EffectSpec& e : plant.effects()) {
    const auto sensor = e.options.find("sensor");
    if (sensor == e.options.end() || sensor->second != "motor") continue;
    for (const std::string& joint : e.joints) {
      const auto at = std::find(names.begin(), names.end(), "motor_position." + joint);
      const int j = plant.model().FindJoint(joint);
      if (at == names.end() || j < 0) continue;
      position_index_[j] = 2 * n_ + static_cast<int>(at - names.begin());
      velocity_index_[j] = position_index_[j] + 1;
    }
  }
}

void StateFilter::FindLatePositions() {
  const sim::ParameterTable& table = simulator_.plant().parameters();
  late_.setZero(n_);
  for (const effects::EffectSpec& e : simulator_.plant().effects()) {
    const auto signal = e.options.find("signal");
    if (e.id != effects::EffectOf(effects::Role::kSensorDelay).id ||
        (signal != e.options.end() && signal->second == "velocity"))
      continue;
    for (const std::string& joint : e.joints) {
      const int j = simulator_.plant().model().FindJoint(joint);
      const int delay = table.Find(e.id + "." + joint + "." + "delay");
      if (j >= 0 && delay >= 0) late_[j] = std::max(0.0, simulator_.parameters()[delay]);
    }
  }
}

void StateFilter::Step(int row) {
  if (!Propagate(recording_.t[row - 1], recording_.t[row])) {
    Start(row);
    return;
  }
  row_ = row;
  Correct(row);
  if (!x_.q.allFinite() || !x_.v.allFinite() || !P_.allFinite()) Start(row);
}

bool StateFilter::Propagate(double begin, double end) {
  const int pieces = std::max(1, static_cast<int>(std::ceil((end - begin) / kMaxPiece - 1e-9)));
  const double dt = (end - begin) / pieces;
  VectorXd u(n_), torque(n_);
  for (int k = 0; k < pieces; ++k) {
    const double t = begin + k * dt;
    for (int j = 0; j < n_; ++j) u[j] = command_.Average(j, t, t + dt);
    if (drive_torque_) {
      drive_torque_(x_.q + 0.5 * dt * x_.v, &torque);
      u += torque;
    }
    if (command_.motion() != nullptr) {
      for (size_t i = 0; i < recording_.prescribed.size(); ++i)
        u[recording_.prescribed[i]] = command_.motion()->At(static_cast<int>(i), t + dt).v;
    }
    if (!simulator_.Advance(x_, u, dt, &lin_).ok()) return false;
    PlacePrescribed(command_, t + dt, &x_);
    P_ = lin_.A * P_ * lin_.A.transpose();
    for (int j = 0; j < n_; ++j) {
      if (recording_.IsPrescribed(j)) continue;
      const double s = std::exp(2.0 * log_acceleration_[j]) * dt;
      P_(n_ + j, n_ + j) += s;
      P_(j, j) += s * dt * dt / 3.0;
      P_(j, n_ + j) += 0.5 * s * dt;
      P_(n_ + j, j) += 0.5 * s * dt;
    }
  }
  return true;
}

void StateFilter::Correct(int row) {
  VectorXd q(n_), v(n_);
  simulator_.Measure(x_, &q, &v);
  VectorXd excess = VectorXd::Zero(n_);
  for (int j = 0; j < n_; ++j) {  // innovations before anything is corrected
    if (recording_.IsPrescribed(j)) continue;
    const double dq = recording_.q(j, row) - q[j];
    excess[j] = dq * dq / (PositionVariance(j) + position_variance_[j]) - 1.0;
    if (!recording_.has_velocity()) continue;
    const double dv = recording_.v(j, row) - v[j];
    excess[j] = 0.5 * (excess[j] +
                       dv * dv / (P_(velocity_index_[j], velocity_index_[j]) + velocity_variance_[j]) - 1.0);
  }
  for (int j = 0; j < n_; ++j) {
    if (recording_.IsPrescribed(j)) continue;
    simulator_.Measure(x_, &q, &v);
    Update(position_index_[j], velocity_index_[j], -late_[j], recording_.q(j, row) - q[j],
           position_variance_[j]);
    if (!recording_.has_velocity()) continue;
    simulator_.Measure(x_, &q, &v);
    Update(velocity_index_[j], position_index_[j], 0.0, recording_.v(j, row) - v[j], velocity_variance_[j]);
  }
  for (int j = 0; j < n_; ++j) {
    log_acceleration_[j] = std::clamp(log_acceleration_[j] + kAdaptation * std::min(excess[j], kMaxExcess),
                                      std::log(kLowAcceleration), std::log(kHighAcceleration));
  }
}

// Of what joint j's encoder sees, by the state's own: an old position is q − T·q̇ to first order.
double StateFilter::PositionVariance(int j) const {
  const int q = position_index_[j], v = velocity_index_[j];
  return P_(q, q) - 2 * late_[j] * P_(q, v) + late_[j] * late_[j] * P_(v, v);
}

// One scalar measurement of x[index] + slope·x[other].
void StateFilter::Update(int index, int other, double slope, double innovation, double variance) {
  const Eigen::RowVectorXd row = P_.row(index) + slope * P_.row(other);
  const double S = row[index] + slope * row[other] + variance;
  const VectorXd gain = row.transpose() / S;
  simulator_.Correct(x_, gain * innovation);
  P_ -= gain * row;
  P_ = 0.5 * (P_ + P_.transpose()).eval();
}

}  // namespace rg::sysid
