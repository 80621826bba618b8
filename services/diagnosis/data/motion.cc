#include "services/diagnosis/data/motion.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>

#include "common/recordings/windows.h"

namespace rg::diagnosis {

SmoothMotion::SmoothMotion(const recordings::Recording& recording, const recordings::SensorNoise& noise,
                           double least_span)
    : recording_(&recording),
      weight_q_(noise.position_stddev.cwiseInverse()),
      weight_v_(noise.velocity_stddev.cwiseInverse()) {
  half_span_ = std::max(least_span, 2.2 * recording.SamplePeriod());
}

void SmoothMotion::At(double t, VectorXd* q, VectorXd* v, VectorXd* a) const {
  const VectorXd& times = recording_->t;
  const int K = recording_->rows(), n = recording_->n();
  int first =
      static_cast<int>(std::lower_bound(times.data(), times.data() + K, t - half_span_) - times.data());
  int last =
      static_cast<int>(std::upper_bound(times.data(), times.data() + K, t + half_span_) - times.data()) - 1;
  while (last - first < 4 && (first > 0 || last + 1 < K)) {
    if (first > 0) --first;
    if (last + 1 < K) ++last;
  }
  q->resize(n), v->resize(n), a->resize(n);
  // Hann-like weights, so that the estimate moves smoothly with t.
  const int degree = last - first >= 4 ? 4 : 3;
  const int m = degree + 1;
  const double reach = 1.3 * half_span_;
  for (int j = 0; j < n; ++j) {
    Eigen::Matrix<double, 5, 5> H = Eigen::Matrix<double, 5, 5>::Zero();
    Eigen::Matrix<double, 5, 1> g = Eigen::Matrix<double, 5, 1>::Zero();
    for (int k = first; k <= last; ++k) {
      const double s = (times[k] - t) / half_span_;
      const double x = std::min(1.0, std::abs(times[k] - t) / reach);
      const double window = (1.0 - x * x) * (1.0 - x * x) + 1e-3;
      double power = 1.0;
      Eigen::Matrix<double, 5, 1> value, slope;
      value.setZero(), slope.setZero();
      for (int i = 0; i < m; ++i) {
        value[i] = power;
        if (i + 1 < m) slope[i + 1] = (i + 1) * power / half_span_;
        power *= s;
      }
      const double wq = window * weight_q_[j] * weight_q_[j];
      H.noalias() += wq * value * value.transpose();
      g += wq * recording_->q(j, k) * value;
      if (!recording_->has_velocity()) continue;
      const double wv = window * weight_v_[j] * weight_v_[j];
      H.noalias() += wv * slope * slope.transpose();
      g += wv * recording_->v(j, k) * slope;
    }
    H.diagonal().array() += 1e-9 * H.trace();
    for (int i = m; i < 5; ++i) H(i, i) = 1.0;
    const Eigen::Matrix<double, 5, 1> c = H.ldlt().solve(g);
    (*q)[j] = c[0];
    (*v)[j] = c[1] / half_span_;
    (*a)[j] = 2.0 * c[2] / (half_span_ * half_span_);
  }
}

namespace {

constexpr double kGap = 1.6;         // sample periods between two rows, of which one is missing
constexpr int kFewestNodes = 3;      // of a window that have a row
constexpr double kLeastKnown = 0.6;  // of the rows; where less is left, those soon after gaps are kept
constexpr int kHarmonics = 12;       // of the quantisation error, a sawtooth over position

// Whether commands are missing between two rows for longer than a node's interval.
bool IsGap(double seconds, double period, const NodeOptions& options) {
  return seconds > kGap * period && seconds > options.interval_s;
}

// Node k, whose own row is `row`, becomes the mean of rows [first, last].
void Average(const recordings::Recording& rec, int first, int row, int last,
             const recordings::SensorNoise& noise, int k, NodeWindow* window) {
  const int count = last - first + 1;
  const auto at = static_cast<size_t>(k);
  for (int i = first; i < row; ++i) window->before[at].push_back(rec.t[i]);
  for (int i = row + 1; i <= last; ++i) window->after[at].push_back(rec.t[i]);
  window->measured[at] = 1;
  window->q.col(k) = rec.q.middleCols(first, count).rowwise().mean();
  window->q_row.col(k) = rec.q.col(row);
  const std::vector<double> times(rec.t.data() + first, rec.t.data() + last + 1);
  for (int j = 0; j < rec.n(); ++j)
    window->q_stddev(j, k) =
        StddevOfMean(times, window->v0(j, k), noise.position_stddev[j], noise.position_resolution[j]);
  if (!rec.has_velocity()) return;
  window->v.col(k) = rec.v.middleCols(first, count).rowwise().mean();
  window->v_row.col(k) = rec.v.col(row);
  window->v_stddev.col(k) = noise.velocity_stddev / std::sqrt(static_cast<double>(count));
}

// Node k becomes its own row alone.
void KeepOwnRow(const recordings::SensorNoise& noise, int k, NodeWindow* window) {
  const auto at = static_cast<size_t>(k);
  if (window->before[at].empty() && window->after[at].empty()) return;
  window->before[at].clear(), window->after[at].clear();
  window->q.col(k) = window->q_row.col(k), window->v.col(k) = window->v_row.col(k);
  window->q_stddev.col(k) = noise.position_stddev, window->v_stddev.col(k) = noise.velocity_stddev;
}

// What holds of each row: whether the commands that the drives follow then are in the recording. They are not
// at its beginning, nor during a gap and for a late drive's time after it.
std::vector<char> CommandsKnown(const recordings::Recording& rec, double late_s, const NodeOptions& options) {
  std::vector<char> known(static_cast<size_t>(rec.rows()), 1);
  const double period = rec.SamplePeriod();
  double from = rec.t[0] + options.unknown_s;
  for (int row = 0; row < rec.rows(); ++row) {
    if (row > 0 && IsGap(rec.t[row] - rec.t[row - 1], period, options))
      from = std::max(from, rec.t[row] + late_s);
    known[row] = rec.t[row] >= from;
  }
  return known;
}

// A window whose rows [first, last] have no gap.
std::optional<NodeWindow> WindowOf(const recordings::Recording& rec, int index, const SmoothMotion& motion,
                                   const recordings::SensorNoise& noise, int first_row, int last_row,
                                   double period, const NodeOptions& options) {
  int stride = std::max(1, static_cast<int>(std::floor(options.interval_s / period + 0.2)));
  if (stride % 2 == 0) --stride;  // symmetric averages
  const int n = rec.n();
  NodeWindow window;
  window.recording = index;
  std::vector<int> row_of;
  for (int row = first_row; row <= last_row; row += stride) {
    if (!window.t.empty()) {
      const double begin = window.t.back(), step = rec.t[row] - begin;
      const int pieces = std::max(1, static_cast<int>(std::ceil(step / (1.3 * options.interval_s))));
      for (int k = 1; k < pieces; ++k) {
        window.t.push_back(begin + step * k / pieces);
        row_of.push_back(-1);
      }
    }
    window.t.push_back(rec.t[row]);
    row_of.push_back(row);
  }
  const int nodes = static_cast<int>(window.t.size());
  if (nodes - std::ranges::count(row_of, -1) < kFewestNodes) return std::nullopt;
  for (const auto m : kNodeMatrices) (window.*m).setZero(n, nodes);
  window.q_stddev.setOnes(n, nodes), window.v_stddev.setOnes(n, nodes);
  window.measured.assign(nodes, 0), window.before.resize(nodes), window.after.resize(nodes);
  const int half = (stride - 1) / 2;
  VectorXd q, v, a;
  for (int k = 0; k < nodes; ++k) {
    motion.At(window.t[k], &q, &v, &a);
    window.q0.col(k) = q, window.v0.col(k) = v;
    const int row = row_of[k];
    if (row < 0) continue;
    // Only rows between the neighbouring nodes: outputs there are simulated from these.
    int first = row, last = row;
    while (k > 0 && first > row - half && rec.t[first - 1] > window.t[k - 1]) --first;
    while (k + 1 < nodes && last < row + half && rec.t[last + 1] < window.t[k + 1]) ++last;
    Average(rec, first, row, last, noise, k, &window);
  }
  return window;
}

}  // namespace

double StddevOfMean(const std::vector<double>& t, double speed, double stddev, double resolution) {
  const auto count = static_cast<double>(t.size());
  const double variance = stddev * stddev;
  if (t.size() == 1 || !(resolution > 0)) return stddev / std::sqrt(count);
  const double blur = std::max(0.0, variance - resolution * resolution / 12) / (resolution * resolution);
  double together = 0;
  for (int m = 1; m <= kHarmonics; ++m) {
    const double turn = 2 * M_PI * m;
    double real = 0, imaginary = 0;
    for (const double at : t) {
      const double phase = turn * speed * (at - t[0]) / resolution;
      real += std::cos(phase) / count, imaginary += std::sin(phase) / count;
    }
    const double share = real * real + imaginary * imaginary - 1 / count;
    together += 2 * std::exp(-turn * turn * blur) * share / (turn * turn);
  }
  return std::sqrt(std::max(0.0, variance / count + resolution * resolution * together));
}

bool FollowsOn(const NodeWindow& before, const NodeWindow& window) {
  constexpr double kLongestGap = 0.05;  // s
  const double gap = window.t.front() - before.t.back();
  return window.recording == before.recording && gap >= 0 && gap <= kLongestGap;
}

std::vector<NodeWindow> CutIntoNodes(const recordings::Recording& rec, int index, const SmoothMotion& motion,
                                     const recordings::SensorNoise& noise, const NodeOptions& options) {
  const double period = std::max(1e-6, rec.SamplePeriod());
  std::vector<char> known = CommandsKnown(rec, options.late_s, options);
  if (std::ranges::count(known, char{1}) < kLeastKnown * static_cast<double>(known.size()))
    known = CommandsKnown(rec, 0.0, options);
  std::vector<NodeWindow> out;
  for (const recordings::Window& w : recordings::SplitIntoWindows(rec, options.window_s)) {
    int first = w.first;
    for (int row = w.first; row <= w.last; ++row) {
      const bool ends =
          row == w.last || !known[row + 1] || IsGap(rec.t[row + 1] - rec.t[row], period, options);
      if (!known[row]) {
        first = row + 1;
      } else if (ends) {
        if (auto window = WindowOf(rec, index, motion, noise, first, row, period, options))
          out.push_back(std::move(*window));
        first = row + 1;
      }
    }
  }
  return out;
}

void SetFactor(NodeWindow* window) {
  const Eigen::Index n = window->q.rows(), kinds = window->v_doubt.size() > 0 ? 2 : 1;
  const auto nodes = std::ranges::count(window->measured, char{1});
  MatrixXd S(nodes * n * kinds, window->q_doubt.cols());
  Eigen::Index row = 0;
  for (Eigen::Index k = 0; k < std::ssize(window->t); ++k) {
    if (!window->measured[k]) continue;
    for (Eigen::Index kind = 0; kind < kinds; ++kind, row += n) {
      const MatrixXd& doubt = kind == 0 ? window->q_doubt : window->v_doubt;
      const MatrixXd& stddev = kind == 0 ? window->q_stddev : window->v_stddev;
      S.middleRows(row, n) = stddev.col(k).cwiseInverse().asDiagonal() * doubt.middleRows(n * k, n);
    }
  }
  MatrixXd covariance = S * S.transpose();
  covariance.diagonal().array() += 1.0;
  window->factor = covariance.llt().matrixL();
}

std::vector<NodeWindow> InPieces(const std::vector<NodeWindow>& windows, double piece_s,
                                 const recordings::SensorNoise& noise) {
  std::vector<NodeWindow> out;
  for (const NodeWindow& w : windows) {
    const int nodes = static_cast<int>(w.t.size());
    for (int first = 0; first + 1 < nodes;) {
      int last = first, measured = 0;
      while (last < nodes && (w.t[last] - w.t[first] < piece_s || measured < 3))
        measured += w.measured[last++];
      if (measured < 3) break;
      const int count = last - first;
      NodeWindow piece;
      piece.recording = w.recording;
      piece.t.assign(w.t.begin() + first, w.t.begin() + last);
      piece.measured.assign(w.measured.begin() + first, w.measured.begin() + last);
      piece.before.assign(w.before.begin() + first, w.before.begin() + last);
      piece.after.assign(w.after.begin() + first, w.after.begin() + last);
      for (const auto m : kNodeMatrices) piece.*m = (w.*m).middleCols(first, count);
      KeepOwnRow(noise, 0, &piece), KeepOwnRow(noise, count - 1, &piece);
      if (w.factor.size() > 0) {
        const Eigen::Index n = w.q.rows();
        piece.q_doubt = w.q_doubt.middleRows(n * first, n * count);
        piece.v_doubt = w.v_doubt.middleRows(n * first, n * count);
        SetFactor(&piece);
      }
      out.push_back(std::move(piece));
      first = last;
    }
  }
  return out;
}

FineMotion FineMotionOf(const recordings::Recording& rec, const sim::CommandSignal& command,
                        const SmoothMotion& motion, const NodeOptions& options) {
  FineMotion out;
  const double dt = options.interval_s / options.fine_per_interval;
  const double begin = rec.t[0], end = rec.t[rec.rows() - 1];
  const int F = std::max(2, static_cast<int>(std::floor((end - begin) / dt)));
  const int n = rec.n();
  for (auto* m : {&out.q, &out.v, &out.a, &out.u}) m->resize(n, F);
  VectorXd q, v, a;
  for (int k = 0; k < F; ++k) {
    const double t = begin + (k + 0.5) * dt;
    out.t.push_back(t);
    motion.At(t, &q, &v, &a);
    out.q.col(k) = q, out.v.col(k) = v, out.a.col(k) = a;
    for (int j = 0; j < n; ++j) out.u(j, k) = command.Average(j, t - 0.5 * dt, t + 0.5 * dt);
    for (size_t i = 0; i < rec.prescribed.size(); ++i) {
      const auto prescribed = [&](double at) { return command.motion()->At(static_cast<int>(i), at); };
      const int j = rec.prescribed[i];
      out.q(j, k) = prescribed(t).q, out.v(j, k) = prescribed(t).v;
      out.a(j, k) = (prescribed(t + 0.5 * dt).v - prescribed(t - 0.5 * dt).v) / dt;
    }
  }
  const double period = rec.SamplePeriod();
  for (int row = 1; row < rec.rows(); ++row) {
    if (IsGap(rec.t[row] - rec.t[row - 1], period, options))
      out.gaps.emplace_back(rec.t[row - 1], rec.t[row]);
  }
  return out;
}

}  // namespace rg::diagnosis
