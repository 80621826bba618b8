#include "common/recordings/noise.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "common/base/check.h"
#include "common/recordings/local_polynomial.h"

namespace rg::recordings {
namespace {

constexpr double kMedianToStddev = 1.4826;
constexpr int kLowestOrder = 3;
constexpr int kSpans[] = {4, 5, 7, 9, 13, 17, 25, 35, 51, 71, 101};  // rows of a local polynomial
constexpr int kRowsToChooseSpan = 200;

double Median(std::vector<double>* values) {
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

// Coefficients of the divided difference over t[first … first + order], of norm 1.
Eigen::VectorXd DividedDifference(const Eigen::VectorXd& t, int first, int order) {
  const double scale = t[first + order] - t[first];
  Eigen::VectorXd c(order + 1);
  for (int i = 0; i <= order; ++i) {
    double product = 1.0;
    for (int j = 0; j <= order; ++j) {
      if (j != i) product *= (t[first + i] - t[first + j]) / scale;
    }
    c[i] = 1.0 / product;
  }
  return c.normalized();
}

double SpreadOfDifferences(const Eigen::VectorXd& t, const Eigen::VectorXd& x, int order) {
  std::vector<double> differences;
  for (int k = 0; k + order < t.size(); ++k) {
    differences.push_back(std::abs(DividedDifference(t, k, order).dot(x.segment(k, order + 1))));
  }
  return kMedianToStddev * Median(&differences);
}

// Whether the steps lie on multiples of g: at least 20 of them within 30 multiples, 95 % on the grid.
bool LieOnGrid(const std::vector<double>& steps, double g) {
  int on = 0, off = 0, small = 0;
  for (const double step : steps) {
    const double multiple = step / g;
    if (multiple > 30.0) continue;
    if (multiple < 0.5) ++small;
    (std::abs(multiple - std::round(multiple)) < 0.1 ? on : off)++;
  }
  return on + off >= 20 && on >= 19 * off && 2 * small < on;
}

double RefineGrid(const std::vector<double>& steps, double g) {
  double num = 0.0, den = 0.0;
  for (const double step : steps) {
    const double multiple = std::round(step / g);
    if (multiple > 30.0) continue;
    num += step * multiple;
    den += multiple * multiple;
  }
  return den > 0.0 ? num / den : g;
}

// The coarsest grid that the values lie on, 0 if none shows. A grid shows as steps between
// neighbouring values that are multiples of one of the smallest steps.
double EstimateResolution(const Eigen::VectorXd& x) {
  std::vector<double> steps;
  for (Eigen::Index k = 1; k < x.size(); ++k) {
    const double step = std::abs(x[k] - x[k - 1]);
    if (step > 1e-12 * std::max(1.0, std::abs(x[k]))) steps.push_back(step);
  }
  std::sort(steps.begin(), steps.end());
  double found = 0.0, last_tried = 0.0;
  int tried = 0;
  for (const double g : steps) {
    if (g < 1.2 * last_tried) continue;
    if (++tried > 64) break;
    last_tried = g;
    if (LieOnGrid(steps, g)) found = g;
  }
  return found > 0.0 ? RefineGrid(steps, found) : 0.0;
}

// How a local polynomial is laid round a row.
enum class Side { kCentred, kCausal };

struct Span {
  int first, last;
};

Span RowsAround(Side side, int row, int count, int rows) {
  if (side == Side::kCausal) return {std::max(0, row - count + 1), row};
  const int first = std::clamp(row - count / 2, 0, std::max(0, rows - count));
  return {first, std::min(rows - 1, first + count - 1)};
}

// Mean square errors to expect of slope and value at some rows: noise from the weights, bias from how
// far a polynomial of two degrees more goes beyond the noise of the difference.
struct ExpectedError {
  double slope = 0.0, value = 0.0;
};

ExpectedError ExpectError(const Eigen::VectorXd& t, const Eigen::VectorXd& x, Side side, int count,
                          int degree, double stddev, int rows) {
  const int first_row = side == Side::kCausal ? std::min(count, rows) - 1 : 0;
  const int stride = std::max(1, (rows - first_row) / kRowsToChooseSpan);
  const double variance = stddev * stddev;
  ExpectedError noise, excess;
  int used = 0;
  for (int row = rows - 1; row >= first_row; row -= stride, ++used) {
    const Span span = RowsAround(side, row, count, rows);
    const auto samples = x.segment(span.first, span.last - span.first + 1);
    const LocalPolynomial low = FitLocalPolynomial(t, span.first, span.last, t[row], degree);
    noise.slope += variance * low.slope.squaredNorm();
    noise.value += variance * low.value.squaredNorm();
    const LocalPolynomial high = FitLocalPolynomial(t, span.first, span.last, t[row], degree + 2);
    const auto beyond = [&](const Eigen::VectorXd& a, const Eigen::VectorXd& b) {
      const Eigen::VectorXd d = a - b;
      const double difference = d.dot(samples);
      return difference * difference - variance * d.squaredNorm();
    };
    excess.slope += beyond(low.slope, high.slope);
    excess.value += beyond(low.value, high.value);
  }
  const double scale = used > 0 ? 1.0 / used : 0.0;
  return {scale * (noise.slope + std::max(0.0, excess.slope)),
          scale * (noise.value + std::max(0.0, excess.value))};
}

struct ChosenSpan {
  int count = 0;
  ExpectedError error;
};

int RowsOfSpan(const Eigen::VectorXd& t, double span_s, int rows) {
  Recording times;
  times.t = t.head(rows);
  const double period = times.SamplePeriod();
  return period > 0.0 ? std::max(2, static_cast<int>(std::lround(span_s / period)) + 1) : 2;
}

// Rows per polynomial for the first `rows` rows of x.
ChosenSpan ChooseSpan(const Eigen::VectorXd& t, const Eigen::VectorXd& x, Side side, int rows, double stddev,
                      const VelocityOptions& options) {
  if (options.span_s > 0.0) {
    const int count = std::min(RowsOfSpan(t, options.span_s, rows), rows);
    return {count, ExpectError(t, x, side, count, options.degree, stddev, rows)};
  }
  ChosenSpan best;
  for (const int count : kSpans) {
    if (count < options.degree + 2 || count > rows) continue;
    const ExpectedError error = ExpectError(t, x, side, count, options.degree, stddev, rows);
    if (best.count == 0 || error.slope < best.error.slope) best = {count, error};
  }
  if (best.count == 0) best.count = rows;
  return best;
}

double StddevFor(const Eigen::VectorXd& t, const Eigen::VectorXd& x, const VelocityOptions& options) {
  return options.position_stddev > 0.0 ? options.position_stddev : EstimateNoise(t, x).stddev;
}

// Root mean square over recordings, weighted by rows, of something that each of them gives per joint.
template <class PerRecording>
Eigen::VectorXd Pool(const RecordingSet& set, const PerRecording& per_recording) {
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(set.joints.size()));
  double rows = 0.0;
  for (const Recording& r : set.recordings) {
    const Eigen::VectorXd x = per_recording(r);
    sum += static_cast<double>(r.rows()) * x.cwiseAbs2();
    rows += static_cast<double>(r.rows());
  }
  return rows > 0.0 ? Eigen::VectorXd((sum / rows).cwiseSqrt()) : sum;
}

Eigen::VectorXd VelocityStddev(const Recording& r, const Eigen::VectorXd& position_stddev) {
  Eigen::VectorXd out(r.n());
  for (int i = 0; i < r.n(); ++i) {
    if (r.has_velocity()) {
      out[i] = EstimateNoise(r.t, r.v.row(i).transpose()).stddev;
    } else {
      const Eigen::VectorXd q = r.q.row(i).transpose();
      out[i] = std::sqrt(ChooseSpan(r.t, q, Side::kCentred, r.rows(), position_stddev[i], {}).error.slope);
    }
  }
  return out;
}

}  // namespace

SignalNoise EstimateNoise(const Eigen::VectorXd& t, const Eigen::VectorXd& x, int order) {
  RG_CHECK(t.size() == x.size()) << t.size() << " times for " << x.size() << " values";
  SignalNoise noise;
  if (t.size() < order + 4) return noise;
  noise.resolution = EstimateResolution(x);
  noise.stddev = SpreadOfDifferences(t, x, order);
  for (int lower = kLowestOrder; lower < order; ++lower) {
    noise.stddev = std::min(noise.stddev, SpreadOfDifferences(t, x, lower));
  }
  // Where a joint rests inside one step of its encoder, differences show nothing.
  noise.stddev = std::max(noise.stddev, noise.resolution / std::sqrt(12.0));
  return noise;
}

SensorNoise EstimateSensorNoise(const RecordingSet& set) {
  const auto n = static_cast<Eigen::Index>(set.joints.size());
  std::vector<std::vector<SignalNoise>> noises;
  for (const Recording& r : set.recordings) {
    auto& of_joints = noises.emplace_back();
    for (int i = 0; i < r.n(); ++i) of_joints.push_back(EstimateNoise(r.t, r.q.row(i).transpose()));
  }
  const auto index = [&](const Recording& r) { return static_cast<size_t>(&r - set.recordings.data()); };
  SensorNoise sensor;
  sensor.position_resolution = Eigen::VectorXd::Zero(n);
  for (const auto& of_joints : noises) {
    for (Eigen::Index i = 0; i < n; ++i) {
      sensor.position_resolution[i] =
          std::max(sensor.position_resolution[i], of_joints[static_cast<size_t>(i)].resolution);
    }
  }
  if (set.noise.position_resolution) sensor.position_resolution.setConstant(*set.noise.position_resolution);
  sensor.position_stddev = Pool(set, [&](const Recording& r) {
    Eigen::VectorXd x(n);
    for (Eigen::Index i = 0; i < n; ++i) x[i] = noises[index(r)][static_cast<size_t>(i)].stddev;
    return x;
  });
  if (set.noise.position_stddev) sensor.position_stddev.setConstant(*set.noise.position_stddev);
  sensor.velocity_stddev =
      Pool(set, [&](const Recording& r) { return VelocityStddev(r, sensor.position_stddev); });
  if (set.noise.velocity_stddev) sensor.velocity_stddev.setConstant(*set.noise.velocity_stddev);
  return sensor;
}

StateEstimate EstimateStateCausal(const Recording& r, int row, const VelocityOptions& options) {
  RG_CHECK(row >= 0 && row < r.rows()) << "row " << row << " of " << r.rows();
  // Enough of the past to choose a span by; the longest span fits in it.
  const int known = std::min(row + 1, 4 * kRowsToChooseSpan);
  const Eigen::VectorXd t = r.t.segment(row + 1 - known, known);
  StateEstimate state;
  state.q = r.q.col(row);
  state.v = state.v_stddev = Eigen::VectorXd::Zero(r.n());
  if (known < 2) return state;
  for (int i = 0; i < r.n(); ++i) {
    const Eigen::VectorXd x = r.q.row(i).segment(row + 1 - known, known).transpose();
    const double stddev = StddevFor(t, x, options);
    const ChosenSpan chosen = ChooseSpan(t, x, Side::kCausal, known, stddev, options);
    const int first = known - std::min(chosen.count, known);
    const LocalPolynomial fit = FitLocalPolynomial(t, first, known - 1, t[known - 1], options.degree);
    const auto samples = x.segment(first, known - first);
    state.v[i] = fit.slope.dot(samples);
    state.v_stddev[i] = stddev * fit.slope.norm();
    if (chosen.error.value < stddev * stddev) state.q[i] = fit.value.dot(samples);
  }
  return state;
}

Eigen::MatrixXd SmoothVelocity(const Recording& r, const VelocityOptions& options) {
  Eigen::MatrixXd v = Eigen::MatrixXd::Zero(r.n(), r.rows());
  if (r.rows() < 2) return v;
  for (int i = 0; i < r.n(); ++i) {
    const Eigen::VectorXd q = r.q.row(i).transpose();
    const double stddev = StddevFor(r.t, q, options);
    const int count = ChooseSpan(r.t, q, Side::kCentred, r.rows(), stddev, options).count;
    for (int k = 0; k < r.rows(); ++k) {
      const Span span = RowsAround(Side::kCentred, k, count, r.rows());
      const LocalPolynomial fit = FitLocalPolynomial(r.t, span.first, span.last, r.t[k], options.degree);
      v(i, k) = fit.slope.dot(q.segment(span.first, span.last - span.first + 1));
    }
  }
  return v;
}

Eigen::MatrixXd VelocityOrEstimate(const Recording& recording, const VelocityOptions& options) {
  return recording.has_velocity() ? recording.v : SmoothVelocity(recording, options);
}

}  // namespace rg::recordings
