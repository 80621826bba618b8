#include "services/diagnosis/motion.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/recordings/windows.h"

namespace rg::diagnosis {

using Eigen::MatrixXd;
using Eigen::VectorXd;

SmoothMotion::SmoothMotion(const recordings::Recording& recording, const recordings::SensorNoise& noise)
    : recording_(&recording),
      weight_q_(noise.position_stddev.cwiseInverse()),
      weight_v_(noise.velocity_stddev.cwiseInverse()) {
  half_span_ = std::max(0.05, 2.2 * recording.SamplePeriod());
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

// Mean over rows [row − half, row + half] with the slope taken out: the value at the row's time.
struct Averaged {
  VectorXd q, v;
  int rows = 1;
};
Averaged AverageAround(const recordings::Recording& rec, int row, int half) {
  half = std::min({half, row, rec.rows() - 1 - row});
  const int count = 2 * half + 1;
  Averaged out;
  out.rows = count;
  out.q = rec.q.middleCols(row - half, count).rowwise().mean();
  if (!rec.has_velocity()) return out;
  out.v = rec.v.middleCols(row - half, count).rowwise().mean();
  const double offset = rec.t.segment(row - half, count).mean() - rec.t[row];
  out.q -= offset * out.v;
  return out;
}

}  // namespace

std::vector<NodeWindow> CutIntoNodes(const recordings::Recording& rec, int index, const SmoothMotion& motion,
                                     const NodeOptions& options) {
  const double period = std::max(1e-6, rec.SamplePeriod());
  int stride = std::max(1, static_cast<int>(std::floor(options.interval_s / period + 0.2)));
  if (stride % 2 == 0) --stride;  // symmetric averages
  const int n = rec.n();
  std::vector<NodeWindow> out;
  VectorXd q, v, a;
  for (const recordings::Window& w : recordings::SplitIntoWindows(rec.t, options.window_s)) {
    NodeWindow window;
    window.recording = index;
    std::vector<int> row_of;
    for (int row = w.first; row <= w.last; row += stride) {
      if (!window.t.empty()) {
        const double begin = window.t.back(), gap = rec.t[row] - begin;
        const int pieces = std::max(1, static_cast<int>(std::ceil(gap / (1.3 * options.interval_s))));
        for (int k = 1; k < pieces; ++k) {
          window.t.push_back(begin + gap * k / pieces);
          row_of.push_back(-1);
        }
      }
      window.t.push_back(rec.t[row]);
      row_of.push_back(row);
    }
    const int nodes = static_cast<int>(window.t.size());
    if (nodes < 3) continue;
    window.q.setZero(n, nodes), window.v.setZero(n, nodes);
    window.q0.resize(n, nodes), window.v0.resize(n, nodes);
    window.measured.assign(nodes, 0), window.rows.assign(nodes, 0);
    for (int k = 0; k < nodes; ++k) {
      motion.At(window.t[k], &q, &v, &a);
      window.q0.col(k) = q, window.v0.col(k) = v;
      if (row_of[k] < 0) continue;
      const Averaged mean = AverageAround(rec, row_of[k], (stride - 1) / 2);
      window.measured[k] = 1;
      window.rows[k] = mean.rows;
      window.q.col(k) = mean.q;
      if (rec.has_velocity()) window.v.col(k) = mean.v;
    }
    out.push_back(std::move(window));
  }
  return out;
}

std::vector<NodeWindow> InPieces(const std::vector<NodeWindow>& windows, double piece_s) {
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
      piece.rows.assign(w.rows.begin() + first, w.rows.begin() + last);
      piece.q = w.q.middleCols(first, count), piece.v = w.v.middleCols(first, count);
      piece.q0 = w.q0.middleCols(first, count), piece.v0 = w.v0.middleCols(first, count);
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
  }
  return out;
}

}  // namespace rg::diagnosis
