#include "services/diagnosis/reporting/holdout.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/parallel.h"
#include "common/recordings/prescribed.h"
#include "common/sim/simulator.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/prediction.h"

namespace rg::diagnosis {

namespace {

constexpr int kBootstraps = 400;
constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

struct JudgedRecordings {
  double rms = 0;
  std::vector<double> windows;  // of all recordings in order
  std::vector<double> weights;  // rows of each
  std::vector<sysid::Prediction> predictions;
  std::vector<sysid::PredictionError> errors;  // per recording
};

JudgedRecordings Judge(const std::vector<const recordings::Recording*>& recs, const sim::Plant& plant,
                       const VectorXd& values, const sysid::PredictionOptions& options, int threads) {
  JudgedRecordings out;
  out.predictions.resize(recs.size());
  out.errors.resize(recs.size());
  ParallelFor(threads, static_cast<int>(recs.size()), [&](int, int i) {
    out.predictions[i] = sysid::PredictRecording(plant, values, *recs[i], options);
    out.errors[i] = sysid::ErrorOf(out.predictions[i], *recs[i]);
  });
  for (size_t i = 0; i < recs.size(); ++i) {
    const auto& restarts = out.predictions[i].restarts;
    size_t window = 0;
    for (size_t w = 0; w < restarts.size(); ++w) {
      const int first = restarts[w] + 1,
                last = w + 1 < restarts.size() ? restarts[w + 1] : recs[i]->rows() - 1;
      if (last < first || window >= out.errors[i].windows.size()) continue;
      out.windows.push_back(out.errors[i].windows[window++]);
      out.weights.push_back(last - first + 1.0);
    }
  }
  double squares = 0, count = 0;
  for (size_t i = 0; i < out.windows.size(); ++i)
    squares += out.windows[i] * out.windows[i] * out.weights[i], count += out.weights[i];
  out.rms = std::sqrt(squares / std::max(1.0, count));
  return out;
}

void MakeUnknown(JudgedRecordings* judged) {
  judged->rms = kUnknown;
  for (double& x : judged->windows) x = kUnknown;
  for (sysid::PredictionError& e : judged->errors) e.rms = e.median_window = kUnknown;
}

// The command plus a realisation of the measured effort's noise: an Ornstein-Uhlenbeck process with the RMS
// and correlation of the residual on the fitted recordings.
sim::CommandSignal Disturbed(const sim::CommandSignal& command, const MeasuredEffort& effort, Rng* rng) {
  if (!effort.active) return command;
  MatrixXd u = command.values();
  for (Eigen::Index j = 0; j < u.rows(); ++j) {
    double state = effort.effort_noise[j] * rng->Normal();
    for (int k = 0; k < command.size(); ++k) {
      const double dt = k > 0 ? command.times()[k] - command.times()[k - 1] : 0;
      // Integrated autocorrelation of an exponential with time T is 2T.
      const double keep = std::exp(-dt / std::max(1e-3, 0.5 * effort.effort_correlation_s[j]));
      state = keep * state + std::sqrt(1 - keep * keep) * effort.effort_noise[j] * rng->Normal();
      u(j, k) += state;
    }
  }
  auto out = sim::CommandSignal::Create(command.times(), u, command.hold());
  return out.ok() ? out->WithMotion(command.motion()) : command;
}

// The command with a motion of prescribed joints drawn from its uncertainty.
sim::CommandSignal OtherwiseMoved(const sim::CommandSignal& command, const recordings::Recording& rec,
                                  Rng rng) {
  if (rec.prescribed.empty()) return command;
  recordings::SmoothMotionRows drawn = recordings::PrescribedDoubt(rec).Draw(rng);
  auto motion = sim::GivenMotion::Create(rec.prescribed, {rec.t.data(), rec.t.data() + rec.rows()},
                                         std::move(drawn.q), std::move(drawn.v), std::move(drawn.a));
  return motion.ok() ? command.WithMotion(std::make_shared<const sim::GivenMotion>(*std::move(motion)))
                     : command;
}

// Parametric bootstrap of the RMS error: windows simulated by the augmented model, and predicted by it from
// noisy starts with noisy efforts.
double NoiseFloor(const std::vector<const recordings::Recording*>& recs, const JudgedRecordings& after,
                  const sim::Plant& plant, const VectorXd& values, const sysid::PredictionOptions& options,
                  const recordings::SensorNoise& noise, const MeasuredEffort& effort, Rng rng) {
  sim::Simulator simulator(plant, options.simulator);
  simulator.SetParameters(values);
  double squares = 0, count = 0;
  const int n = plant.num_joints();
  for (size_t i = 0; i < recs.size(); ++i) {
    const recordings::Recording& rec = *recs[i];
    const sim::CommandSignal command = sysid::DriveSignal(rec);
    const sim::CommandSignal recorded = Disturbed(OtherwiseMoved(command, rec, rng.Split(i)), effort, &rng);
    const auto& restarts = after.predictions[i].restarts;
    // A filter over some rows knows the state better than one row does.
    const double rows = 3.0;
    for (size_t w = 0; w < restarts.size(); ++w) {
      const int first = restarts[w], last = w + 1 < restarts.size() ? restarts[w + 1] : rec.rows() - 1;
      if (last <= first) continue;
      const std::vector<double> times(rec.t.data() + first + 1, rec.t.data() + last + 1);
      VectorXd q = rec.q.col(first);
      VectorXd v =
          rec.has_velocity() ? VectorXd(rec.v.col(first)) : recordings::EstimateStateCausal(rec, first).v;
      const sim::Trajectory truth =
          simulator.Simulate(simulator.MakeState(q, v, rec.t[first], command), command, times);
      for (int j = 0; j < n; ++j) {
        q[j] += rng.Normal(0.0, noise.position_stddev[j] / std::sqrt(rows));
        v[j] += rng.Normal(0.0, noise.velocity_stddev[j] / std::sqrt(rows));
      }
      const sim::Trajectory guess =
          simulator.Simulate(simulator.MakeState(q, v, rec.t[first], recorded), recorded, times);
      if (!truth.outcome.ok() || !guess.outcome.ok()) continue;
      for (int j = 0; j < n; ++j) {
        if (rec.IsPrescribed(j)) continue;
        const double sensor = noise.position_stddev[j] * noise.position_stddev[j];
        squares += (truth.position.row(j) - guess.position.row(j)).squaredNorm() +
                   sensor * static_cast<double>(times.size());
      }
      count += (static_cast<double>(n) - static_cast<double>(rec.prescribed.size())) *
               static_cast<double>(times.size());
    }
  }
  return std::sqrt(squares / std::max(1.0, count));
}

HoldoutPlot PlotOf(const recordings::Recording& rec, const sysid::Prediction& before,
                   const sysid::Prediction& after) {
  HoldoutPlot plot;
  plot.recording = rec.name;
  const int stride = std::max(1, rec.rows() / 700);
  std::vector<int> rows;
  for (int k = 0; k < rec.rows(); k += stride) rows.push_back(k);
  for (MatrixXd* m : {&plot.measured, &plot.before, &plot.after}) m->resize(rec.n(), rows.size());
  for (size_t i = 0; i < rows.size(); ++i) {
    plot.t.push_back(rec.t[rows[i]]);
    plot.measured.col(i) = rec.q.col(rows[i]);
    plot.before.col(i) = before.q.col(rows[i]);
    plot.after.col(i) = after.q.col(rows[i]);
  }
  return plot;
}

// Whether the fitted recordings are predicted better if, before each begins, late drives follow the torque
// that held the robot, rather than the recording's first command.
bool HeldBefore(const std::vector<const recordings::Recording*>& fitted, const sim::Plant& plant,
                const VectorXd& values, sysid::PredictionOptions options, int threads) {
  options.held_before = true;
  const double held = Judge(fitted, plant, values, options, threads).rms;
  options.held_before = false;
  return !(Judge(fitted, plant, values, options, threads).rms < held);
}

constexpr double kWorse = 1.1;     // ratio of RMS errors, below which the difference does not matter
constexpr double kSurely = 0.975;  // one-sided, over windows

}  // namespace

bool WorseThanCalibrated(const HoldoutFit& h) {
  if (h.judged_on_fit) return false;
  const bool surely = h.worse_than_calibrated > kSurely && h.after_rms > kWorse * h.calibrated_rms;
  return surely || (h.after_rms > kWorse * h.before_rms && h.after_rms > h.calibrated_rms);
}

void JudgeHeldOut(const recordings::RecordingSet& set, const sim::Plant& nominal, const SearchResult& search,
                  const FitData& data, const DiagnosisOptions& options, int threads,
                  DiagnosisResult* result) {
  std::vector<const recordings::Recording*> recs = set.Holdout();
  result->holdout.judged_on_fit = recs.empty();
  if (recs.empty()) recs = set.Fit();
  sysid::PredictionOptions prediction;
  prediction.window_s = options.window_s;
  const double fitted = search.best.fit.step_s;
  prediction.simulator.step_s = fitted > 0 ? std::min(options.step_s, fitted) : options.step_s;
  prediction.noise = data.noise;
  prediction.effort_excludes_gravity = set.effort_excludes_gravity;
  if (!result->plant->effects().empty())
    result->held_before = HeldBefore(set.Fit(), *result->plant, result->values, prediction, threads);
  // A given model that cannot be simulated has no errors.
  const bool runs = GivenRuns(nominal, options.model);
  JudgedRecordings before = Judge(recs, nominal, nominal.parameters().Nominal(), prediction, threads);
  if (!runs) MakeUnknown(&before);
  const JudgedRecordings calibrated =
      Judge(recs, *search.calibrated.plant, search.calibrated.fit.values, prediction, threads);
  prediction.held_before = result->held_before;
  const JudgedRecordings after = Judge(recs, *result->plant, result->values, prediction, threads);
  HoldoutFit& h = result->holdout;
  h.before_rms = before.rms, h.calibrated_rms = calibrated.rms, h.after_rms = after.rms;
  h.before_windows = before.windows, h.after_windows = after.windows;
  for (size_t i = 0; i < recs.size(); ++i) {
    h.recordings.push_back({recs[i]->name, before.errors[i].rms, calibrated.errors[i].rms,
                            after.errors[i].rms, before.errors[i].median_window,
                            calibrated.errors[i].median_window, after.errors[i].median_window});
  }
  Rng rng(options.seed + 17);
  h.noise_floor_rms = NoiseFloor(recs, after, *result->plant, result->values, prediction, data.noise,
                                 search.measured, rng.Split(1));
  // Bootstrap over windows.
  std::vector<double> gains;
  int worse = 0;
  const size_t W = before.windows.size();
  for (int b = 0; b < kBootstraps && W > 0; ++b) {
    double before2 = 0, calibrated2 = 0, after2 = 0;
    for (size_t i = 0; i < W; ++i) {
      const size_t w = rng.Index(W);
      before2 += before.weights[w] * before.windows[w] * before.windows[w];
      calibrated2 += before.weights[w] * calibrated.windows[w] * calibrated.windows[w];
      after2 += before.weights[w] * after.windows[w] * after.windows[w];
    }
    gains.push_back(before2 > 0 ? 1.0 - std::sqrt(after2 / before2) : 0.0);
    worse += after2 > calibrated2;
  }
  h.worse_than_calibrated = worse / static_cast<double>(kBootstraps);
  std::ranges::sort(gains);
  if (!runs) {
    h.improvement_low = h.improvement_high = kUnknown;
  } else if (!gains.empty()) {
    h.improvement_low = gains[static_cast<size_t>(0.025 * gains.size())];
    h.improvement_high = gains[static_cast<size_t>(0.975 * gains.size())];
  }
  for (size_t i = 0; i < recs.size() && i < 2; ++i) {
    result->holdout_plots.push_back(PlotOf(*recs[i], before.predictions[i], after.predictions[i]));
    if (!runs) result->holdout_plots.back().before.resize(0, 0);
  }
}

std::string NoteOnFreeSwing(const HoldoutFit& h) {
  if (h.after_rms < std::fmin(h.before_rms, h.calibrated_rms)) return "";
  return "held-out errors do not become smaller by a mass that swings freely, for no sensor reads where it "
         "is when a window begins: it is believed because it swings on from each window to the next";
}

}  // namespace rg::diagnosis
