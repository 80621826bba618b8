#include "services/sysid/window_choice.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/parallel.h"
#include "common/base/rng.h"
#include "services/sysid/recording_shooting.h"
#include "services/sysid/shooting_fit.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr uint64_t kPriorSeed = 1;  // fixed: the same recordings give the same windows

bool Overlap(const FitWindow& a, const FitWindow& b) {
  return a.recording == b.recording && a.first < b.last && b.first < a.last;
}

bool OverlapsAny(const FitWindow& window, const std::vector<FitWindow>& taken) {
  return std::any_of(taken.begin(), taken.end(), [&](const FitWindow& t) { return Overlap(window, t); });
}

double LogDetOfSum(const MatrixXd& scaled) {
  const Eigen::LLT<MatrixXd> llt(scaled + MatrixXd::Identity(scaled.rows(), scaled.cols()));
  return 2.0 * llt.matrixL().toDenseMatrix().diagonal().array().log().sum();
}

// Rows that the prior may move far say less than their sensor could tell: see kCurvature.
void Discount(const VectorXd& prior_stddev, const VectorXd& scale, RowMatrix* J_t, RowMatrix* J_x) {
  for (Eigen::Index i = 0; i < J_t->rows(); ++i) {
    const double spread = J_t->row(i).cwiseProduct(prior_stddev.transpose()).norm();  // in units of scale
    const double weight = 1.0 / std::hypot(1.0, kCurvature * scale[i] * spread * spread);
    J_t->row(i) *= weight;
    J_x->row(i) *= weight;
  }
}

// J_tᵀ J_t, or its Schur complement with the initial state's Jacobian and unit prior eliminated.
MatrixXd WindowInformation(const RowMatrix& J_t, const RowMatrix& J_x, bool eliminate) {
  MatrixXd H = J_t.transpose() * J_t;
  if (!eliminate) return H;
  const MatrixXd cross = J_x.transpose() * J_t;
  const MatrixXd own = J_x.transpose() * J_x + MatrixXd::Identity(J_x.cols(), J_x.cols());
  return H - cross.transpose() * own.llt().solve(cross);
}

// Of a window's residuals: positions first, then velocities, joint by joint.
VectorXd ResidualScales(const recordings::SensorNoise& noise, Eigen::Index residuals, bool with_velocity) {
  const Eigen::Index positions = with_velocity ? residuals / 2 : residuals;
  const Eigen::Index n = noise.position_stddev.size();
  VectorXd scale(residuals);
  for (Eigen::Index i = 0; i < residuals; ++i) {
    scale[i] = (i < positions ? noise.position_stddev : noise.velocity_stddev)[i % n];
  }
  return scale;
}

}  // namespace

std::string_view WindowChoiceName(WindowChoice choice) {
  switch (choice) {
    case WindowChoice::kFirst:
      return "first";
    case WindowChoice::kRandom:
      return "random";
    case WindowChoice::kInformation:
      return "information";
  }
  return "first";
}

Result<WindowChoice> ParseWindowChoice(std::string_view name) {
  for (const auto choice : {WindowChoice::kFirst, WindowChoice::kRandom, WindowChoice::kInformation}) {
    if (name == WindowChoiceName(choice)) return choice;
  }
  return InvalidError("window choice '" + std::string(name) + "' is none of first, random, information");
}

std::vector<FitWindow> CandidateWindows(const std::vector<FitRecording>& recordings, double window_s) {
  std::vector<FitWindow> out;
  for (size_t r = 0; r < recordings.size(); ++r) {
    const recordings::Recording& rec = *recordings[r].recording;
    const double tolerance = 0.5 * rec.SamplePeriod();
    const int rows = rec.rows();
    double next = -std::numeric_limits<double>::infinity();
    for (int first = 0; first + 1 < rows; ++first) {
      if (rec.t[first] < next - tolerance) continue;
      int last = first;
      while (last + 1 < rows && rec.t[last + 1] <= rec.t[first] + window_s + tolerance) ++last;
      const double length = rec.t[last] - rec.t[first];
      // The rest of a recording, or what a gap leaves, is no window of this length.
      if (last > first && length > window_s - 2.0 * tolerance) {
        out.push_back({static_cast<int>(r), first, last, rec.t[first], length, 0.0});
      }
      next = rec.t[first] + 0.5 * window_s;
    }
  }
  return out;
}

std::vector<VectorXd> PriorPoints(const FitSpace& space, int count, uint64_t seed) {
  const double mean = std::sqrt(2.0 / M_PI);  // of |x|, x standard normal
  Rng rng(seed);
  std::vector<VectorXd> points;
  for (int k = 0; k < count; ++k) {
    VectorXd theta = space.nominal();
    for (int i = 0; i < theta.size(); ++i) {
      const bool at_bound = theta[i] <= space.lower()[i];
      const double draw = k == 0 ? (at_bound ? mean : 0.0) : rng.Normal();
      theta[i] += space.prior_stddev()[i] * (at_bound ? std::abs(draw) : draw);
    }
    points.push_back(theta.cwiseMax(space.lower()).cwiseMin(space.upper()));
  }
  return points;
}

std::vector<MatrixXd> InformationOfWindows(const sim::Plant& plant, const VectorXd& values,
                                           const FitSpace& space, const VectorXd& theta,
                                           const std::vector<FitRecording>& recordings,
                                           const std::vector<FitWindow>& windows,
                                           const recordings::SensorNoise& noise,
                                           const WindowInformationOptions& options) {
  std::vector<recordings::Recording> slices;
  for (const FitWindow& w : windows) {
    slices.push_back(recordings::Slice(*recordings[w.recording].recording, w.first, w.last - w.first + 1));
  }
  std::vector<FitRecording> fit;
  for (size_t i = 0; i < windows.size(); ++i) {
    fit.push_back({&slices[i], recordings[windows[i].recording].command});
  }
  RecordingShootingOptions shooting;
  shooting.window_s = std::numeric_limits<double>::infinity();
  shooting.residual_rate_hz = 1e6;  // every row
  shooting.use_velocity = options.use_velocity;
  shooting.simulator = options.simulator;
  const recordings::SensorNoise sensors = FlooredNoise(noise);
  RecordingShooting model(plant, values, space, fit, ScalesOf(sensors), shooting, options.threads);
  std::vector<MatrixXd> out(windows.size());
  ParallelFor(options.threads, static_cast<int>(windows.size()), [&](int worker, int w) {
    VectorXd r(model.window_residuals(w));
    RowMatrix J_t(r.size(), space.size()), J_x(r.size(), model.window_unknowns(w));
    const VectorXd xi = VectorXd::Zero(J_x.cols());
    const auto rows = static_cast<Eigen::Index>(windows[w].last - windows[w].first);
    const bool with_velocity = r.size() == 2 * rows * plant.num_joints();
    if (!model.Evaluate(worker, w, theta, xi, &r, &J_t, &J_x) || !J_t.allFinite()) {
      out[w] = MatrixXd::Zero(space.size(), space.size());
      return;
    }
    Discount(space.prior_stddev(), ResidualScales(sensors, r.size(), with_velocity), &J_t, &J_x);
    out[w] = WindowInformation(J_t, J_x, options.initial_states_unknown);
  });
  return out;
}

std::vector<FitWindow> TakeMostInformative(const std::vector<FitWindow>& windows,
                                           const std::vector<std::vector<MatrixXd>>& information,
                                           const VectorXd& prior_stddev, int count) {
  const auto D = prior_stddev.asDiagonal();
  const auto P = prior_stddev.size();
  std::vector<MatrixXd> sums(information.size(), MatrixXd::Zero(P, P));
  std::vector<FitWindow> taken;
  double so_far = 0.0;
  while (static_cast<int>(taken.size()) < count) {
    int best = -1;
    double most = -std::numeric_limits<double>::infinity();
    for (size_t w = 0; w < windows.size(); ++w) {
      if (OverlapsAny(windows[w], taken)) continue;
      double value = 0.0;
      for (size_t k = 0; k < sums.size(); ++k) value += LogDetOfSum(sums[k] + D * information[k][w] * D);
      if (value > most) {
        most = value;
        best = static_cast<int>(w);
      }
    }
    if (best < 0) break;
    taken.push_back(windows[best]);
    taken.back().gain_nats = 0.5 * (most - so_far) / static_cast<double>(sums.size());
    so_far = most;
    for (size_t k = 0; k < sums.size(); ++k) sums[k] += D * information[k][best] * D;
  }
  return taken;
}

std::vector<FitWindow> ChooseByInformation(const sim::Plant& plant, const VectorXd& values,
                                           const FitSpace& space, const std::vector<FitRecording>& recordings,
                                           const std::vector<FitWindow>& windows,
                                           const recordings::SensorNoise& noise, int count,
                                           const WindowInformationOptions& options) {
  std::vector<std::vector<MatrixXd>> information;
  for (const VectorXd& theta : PriorPoints(space, kPriorPoints, kPriorSeed)) {
    information.push_back(
        InformationOfWindows(plant, values, space, theta, recordings, windows, noise, options));
  }
  return TakeMostInformative(windows, information, space.prior_stddev(), count);
}

std::vector<FitWindow> TakeAtRandom(std::vector<FitWindow> windows, uint64_t seed, int count) {
  Rng rng(seed);
  std::vector<FitWindow> taken;
  while (!windows.empty() && static_cast<int>(taken.size()) < count) {
    const auto pick = static_cast<std::ptrdiff_t>(rng.Index(windows.size()));
    const FitWindow window = windows[static_cast<size_t>(pick)];
    windows.erase(windows.begin() + pick);
    if (!OverlapsAny(window, taken)) taken.push_back(window);
  }
  return taken;
}

std::vector<FitWindow> TakeFirst(const std::vector<FitWindow>& windows, int count) {
  std::vector<FitWindow> taken;
  for (const FitWindow& window : windows) {
    if (static_cast<int>(taken.size()) >= count) break;
    if (!OverlapsAny(window, taken)) taken.push_back(window);
  }
  return taken;
}

}  // namespace rg::sysid
