#include "services/sysid/prediction.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <optional>

#include "common/base/check.h"
#include "common/base/printf.h"
#include "common/dynamics/dynamics.h"
#include "common/recordings/angles.h"
#include "common/recordings/command_time.h"
#include "common/recordings/time_stamps.h"
#include "common/recordings/velocity_lag.h"
#include "common/recordings/windows.h"
#include "common/sim/holding_command.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/state_filter.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kMinStddev = 1e-7;      // rad or m: no sensor is better
constexpr double kGravityPiece = 0.005;  // s: the drive's gravity torque is renewed this often

// Noise of this recording alone where the caller knows none.
recordings::SensorNoise NoiseOf(const recordings::Recording& recording, const PredictionOptions& options) {
  recordings::SensorNoise noise = options.noise;
  const int n = recording.n();
  if (noise.position_stddev.size() != n) {
    noise.position_stddev.resize(n);
    for (int j = 0; j < n; ++j) {
      noise.position_stddev[j] =
          recordings::EstimateNoise(recording.t, recording.q.row(j).transpose()).stddev;
    }
  }
  if (noise.velocity_stddev.size() != n) {
    noise.velocity_stddev = VectorXd::Constant(n, 1.0);
    const recordings::VelocityLag late = recordings::EstimateVelocityLag(recording);
    for (int j = 0; j < n && recording.has_velocity(); ++j) {
      noise.velocity_stddev[j] = std::hypot(
          recordings::EstimateNoise(recording.t, recording.v.row(j).transpose()).stddev, late.error[j]);
    }
  }
  noise.position_stddev = noise.position_stddev.cwiseMax(kMinStddev);
  noise.velocity_stddev = noise.velocity_stddev.cwiseMax(10.0 * kMinStddev);
  return noise;
}

class Predictor {
 public:
  Predictor(const sim::Plant& plant, const VectorXd& values, const recordings::Recording& recording,
            const PredictionOptions& options)
      : recording_(recording),
        options_(options),
        command_(DriveSignal(recording)),
        simulator_(plant, options.simulator),
        filter_simulator_(plant, options.simulator) {
    simulator_.SetParameters(values);
    filter_simulator_.SetParameters(values);
    if (options.effort_excludes_gravity) {
      const VectorXd drive =
          options.drive_values.size() > 0 ? options.drive_values : plant.parameters().Nominal();
      mechanism_.emplace(MechanismOf(plant, drive));
    }
    if (options.held_before && recordings::StartsAtRest(recording))
      command_ = sim::HeldBefore(command_, Holding());
    if (options.restart == RestartState::kFiltered) {
      filter_.emplace(&filter_simulator_, recording, command_, NoiseOf(recording, options), DriveTorque());
    }
  }

  Prediction Run() {
    Prediction out;
    out.t = recording_.t;
    out.q = recording_.q;  // the first row, and a recording of one row
    out.restarts.push_back(0);
    for (const recordings::Window& w : recordings::SplitIntoWindows(recording_, options_.window_s)) {
      if (w.first > 0) out.restarts.push_back(w.first);
      PredictWindow(w, &out);
    }
    for (const int j : recording_.prescribed) out.q.row(j) = recording_.q.row(j);
    return out;
  }

 private:
  std::function<void(const VectorXd&, VectorXd*)> DriveTorque() {
    if (!mechanism_) return {};
    return [this](const VectorXd& q, VectorXd* torque) {
      dynamics::GravityTorque(*mechanism_, workspace_, q, *torque);
    };
  }

  // The command that held the robot in the first row, what the drive adds by itself taken off.
  VectorXd Holding() {
    VectorXd own = VectorXd::Zero(recording_.n()), u = command_.values().col(0);
    const VectorXd q = recording_.q.col(0);
    if (mechanism_) dynamics::GravityTorque(*mechanism_, workspace_, q, own);
    return sim::HoldingCommand(simulator_, q, u + own) - own;
  }

  // Prescribed joints in a command that is held up to `end`: their velocities there.
  void TellPrescribed(double end, VectorXd* u) const {
    for (size_t i = 0; i < recording_.prescribed.size(); ++i)
      (*u)[recording_.prescribed[i]] = command_.motion()->At(static_cast<int>(i), end).v;
  }

  sim::State Restart(int row) {
    if (filter_) return filter_->StateAt(row);
    const VectorXd v = recording_.has_velocity() ? VectorXd(recording_.v.col(row))
                                                 : recordings::EstimateStateCausal(recording_, row).v;
    return simulator_.MakeState(recording_.q.col(row), v, recording_.t[row], command_);
  }

  void PredictWindow(const recordings::Window& w, Prediction* out) {
    const sim::State x0 = Restart(w.first);
    if (mechanism_) {
      AdvanceWindow(w, x0, out);
      return;
    }
    const std::vector<double> times(recording_.t.data() + w.first + 1, recording_.t.data() + w.last + 1);
    simulator_.SimulateInto(x0, command_, times, {}, &trajectory_);
    const int reached = trajectory_.outcome.ok() ? w.rows() : trajectory_.reached;
    out->q.middleCols(w.first + 1, reached) = trajectory_.position.leftCols(reached);
    if (reached < w.rows()) Break(w, w.first + 1 + reached, trajectory_.outcome.ToString(), x0.q, out);
  }

  // Row by row, with the drive's gravity torque at the simulated position.
  void AdvanceWindow(const recordings::Window& w, sim::State x, Prediction* out) {
    const VectorXd q0 = x.q;
    const int n = recording_.n();
    VectorXd u(n), torque(n), q(n), v(n);
    for (int row = w.first + 1; row <= w.last; ++row) {
      const double begin = recording_.t[row - 1], span = recording_.t[row] - begin;
      const int pieces = std::max(1, static_cast<int>(std::ceil(span / kGravityPiece - 1e-9)));
      const double dt = span / pieces;
      for (int k = 0; k < pieces; ++k) {
        for (int j = 0; j < n; ++j) u[j] = command_.Average(j, begin + k * dt, begin + (k + 1) * dt);
        dynamics::GravityTorque(*mechanism_, workspace_, x.q + 0.5 * dt * x.v, torque);
        u += torque;
        TellPrescribed(begin + (k + 1) * dt, &u);
        const sim::Outcome outcome = simulator_.Advance(x, u, dt);
        if (!outcome.ok()) {
          Break(w, row, outcome.ToString(), q0, out);
          return;
        }
      }
      PlacePrescribed(command_, recording_.t[row], &x);
      simulator_.Measure(x, &q, &v);
      out->q.col(row) = q;
    }
  }

  // From `row` on the window's simulation said nothing: its last word is repeated, and the reason kept.
  void Break(const recordings::Window& w, int row, const std::string& why, const VectorXd& q0,
             Prediction* out) {
    const VectorXd last = row > w.first + 1 ? VectorXd(out->q.col(row - 1)) : q0;
    for (int k = row; k <= w.last; ++k) out->q.col(k) = last;
    out->failures.push_back(recording_.name + Printf(": window at %.3f s: ", recording_.t[w.first]) + why);
  }

  const recordings::Recording& recording_;
  const PredictionOptions& options_;
  sim::CommandSignal command_;
  sim::Simulator simulator_, filter_simulator_;
  std::optional<dynamics::Mechanism> mechanism_;
  dynamics::Workspace workspace_;
  std::optional<StateFilter> filter_;
  sim::Trajectory trajectory_;
};

// The shortest text that reads back exactly.
void AppendNumber(double x, std::string* out) {
  char text[32];
  out->append(text, std::to_chars(text, text + sizeof text, x).ptr);
}

double Median(std::vector<double> x) {
  if (x.empty()) return 0.0;
  std::nth_element(x.begin(), x.begin() + x.size() / 2, x.end());
  return x[x.size() / 2];
}

}  // namespace

Prediction PredictRecording(const sim::Plant& plant, const VectorXd& values,
                            const recordings::Recording& recording, const PredictionOptions& options) {
  RG_CHECK(recording.n() == plant.num_joints() && recording.rows() >= 1);
  RG_CHECK(recording.prescribed == plant.prescribed()) << recording.name;
  RG_CHECK(values.size() == plant.parameters().size());
  Prediction all;
  all.t = recording.t;
  all.q = recording.q;
  for (const recordings::Recording& piece : recordings::SplitAtGaps(recording)) {
    const auto first = static_cast<int>(
        std::lower_bound(recording.t.data(), recording.t.data() + recording.rows(), piece.t[0]) -
        recording.t.data());
    Prediction part = Predictor(plant, values, piece, options).Run();
    all.q.middleCols(first, piece.rows()) = part.q;
    all.measured.push_back(first);
    for (const int row : part.restarts) all.restarts.push_back(first + row);
    all.failures.insert(all.failures.end(), part.failures.begin(), part.failures.end());
  }
  return all;
}

PredictionError ErrorOf(const Prediction& prediction, const recordings::Recording& recording) {
  RG_CHECK(prediction.q.rows() == recording.n() && prediction.q.cols() == recording.rows());
  PredictionError error;
  const int K = recording.rows(), n = recording.n();
  error.joint_rms = VectorXd::Zero(n);
  const auto predicted = K - static_cast<int>(prediction.measured.size());
  if (predicted < 1) return error;
  MatrixXd squares = (prediction.q - recording.q).cwiseAbs().cwiseMin(kErrorCap).cwiseAbs2();
  for (const int row : prediction.measured) squares.col(row).setZero();
  // Prescribed joints are right by themselves: their zeros are no part of a mean.
  const double judged = std::sqrt(n / std::max(1.0, n - static_cast<double>(recording.prescribed.size())));
  const VectorXd of_joints = squares.rowwise().sum() / predicted;
  error.rms = judged * std::sqrt(of_joints.mean());
  error.joint_rms = of_joints.cwiseSqrt();
  for (size_t w = 0; w < prediction.restarts.size(); ++w) {
    const int first = prediction.restarts[w] + 1;
    int last = w + 1 < prediction.restarts.size() ? prediction.restarts[w + 1] : K - 1;
    if (std::binary_search(prediction.measured.begin(), prediction.measured.end(), last)) --last;
    if (last >= first)
      error.windows.push_back(judged * std::sqrt(squares.middleCols(first, last - first + 1).mean()));
  }
  error.median_window = Median(error.windows);
  return error;
}

std::string FormatPredictionCsv(const Prediction& prediction, const recordings::Recording& recording) {
  const MatrixXd q = recordings::InFilesWrapping(recording, prediction.q);
  std::string out = "time";
  for (const std::string& joint : recording.joints) out += ",position." + joint;
  out += '\n';
  for (int k = 0; k < prediction.t.size(); ++k) {
    AppendNumber(prediction.t[k] + recording.time_offset, &out);
    for (int j = 0; j < q.rows(); ++j) {
      out += ',';
      AppendNumber(q(j, k), &out);
    }
    out += '\n';
  }
  return out;
}

}  // namespace rg::sysid
