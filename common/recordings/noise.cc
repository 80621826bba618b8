#include "common/recordings/noise.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "common/base/check.h"
#include "common/recordings/local_polynomial.h"
#include "common/recordings/velocity_lag.h"

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

std::vector<double> AbsoluteDifferences(const Eigen::VectorXd& t, const Eigen::VectorXd& x, int order) {
  std::vector<double> differences;
  for (int k = 0; k + order < t.size(); ++k) {
    differences.push_back(std::abs(DividedDifference(t, k, order).dot(x.segment(k, order + 1))));
  }
  return differences;
}

double SpreadOfDifferences(const Eigen::VectorXd& t, const Eigen::VectorXd& x, int order) {
  std::vector<double> differences = AbsoluteDifferences(t, x, order);
  return kMedianToStddev * Median(&differences);
}

constexpr double kMultiples[] = {2.5, 5.0, 10.0, 20.0, 30.0};  // of a grid's step, that are looked at

// Whether the steps (sorted) lie on multiples of g: at least 20 of them within `most` multiples, 95 % on the
// grid.
bool LieOnGrid(const std::vector<double>& steps, double g, double most) {
  int on = 0, off = 0, small = 0;
  for (const double step : steps) {
    const double multiple = step / g;
    if (multiple > most) break;
    if (multiple < 0.5) ++small;
    (std::abs(multiple - std::round(multiple)) < 0.1 ? on : off)++;
  }
  return on + off >= 20 && on >= 19 * off && 2 * small < on;
}

// The step that fits those up to `most` multiples of g best.
double RefineGrid(const std::vector<double>& steps, double g, double most) {
  double num = 0.0, den = 0.0;
  for (const double step : steps) {
    const double multiple = std::round(step / g);
    if (multiple > most) break;
    num += step * multiple;
    den += multiple * multiple;
  }
  return den > 0.0 ? num / den : g;
}

// The grid near g that the steps lie on, 0 if there is none. A file prints so few digits that one step alone
// is hundredths off; further multiples count as the step is known better.
double GridNear(const std::vector<double>& steps, double g) {
  double most = 0.0;
  for (const double multiples : kMultiples) {
    g = RefineGrid(steps, g, multiples);
    if (LieOnGrid(steps, g, multiples)) most = multiples;
  }
  return most == kMultiples[std::size(kMultiples) - 1] ? g : 0.0;
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
    if (const double grid = GridNear(steps, g); grid > 0.0) found = grid;
  }
  return found;
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

// Mean square errors to expect of slope and value.
struct ExpectedError {
  double slope = 0.0, value = 0.0;
};

// A local polynomial of each span at one row, with weights laid over the same samples.
struct Candidates {
  Eigen::MatrixXd slope, value;  // samples × spans
  Eigen::VectorXd samples;
};

Candidates FitCandidates(const Eigen::VectorXd& t, const Eigen::VectorXd& x, Side side, int row,
                         const std::vector<int>& counts, int degree, int rows) {
  const Span widest = RowsAround(side, row, counts.back(), rows);
  const int length = widest.last - widest.first + 1;
  Candidates c;
  c.samples = x.segment(widest.first, length);
  c.slope = c.value = Eigen::MatrixXd::Zero(length, static_cast<Eigen::Index>(counts.size()));
  for (size_t j = 0; j < counts.size(); ++j) {
    const Span span = RowsAround(side, row, counts[j], rows);
    const LocalPolynomial fit = FitLocalPolynomial(t, span.first, span.last, t[row], degree);
    const auto col = static_cast<Eigen::Index>(j);
    c.slope.col(col).segment(span.first - widest.first, fit.slope.size()) = fit.slope;
    c.value.col(col).segment(span.first - widest.first, fit.value.size()) = fit.value;
  }
  return c;
}

// Noise of each span, and how far it strays from each shorter one, over some rows.
class SpanComparison {
 public:
  explicit SpanComparison(Eigen::Index spans)
      : noise_(Eigen::VectorXd::Zero(spans)),
        expected_(Eigen::MatrixXd::Zero(spans, spans)),
        moved_(static_cast<size_t>(spans * spans)) {}

  void Add(const Eigen::MatrixXd& weights, const Eigen::VectorXd& samples, double variance) {
    ++rows_;
    for (Eigen::Index j = 0; j < weights.cols(); ++j) {
      noise_[j] += variance * weights.col(j).squaredNorm();
      for (Eigen::Index i = 0; i < j; ++i) {
        const Eigen::VectorXd d = weights.col(j) - weights.col(i);
        moved_[At(i, j)].push_back(std::pow(d.dot(samples), 2));
        expected_(i, j) += variance * d.squaredNorm();
      }
    }
  }

  // The bias of a span is what it strays from a shorter one beyond what noise would do: the median
  // over rows, so that outliers and time stamps that jump are not taken for motion. The margin covers
  // the error of the noise's own estimate; what it hides is smaller than the shorter span's noise.
  double MeanSquareError(Eigen::Index j) {
    if (rows_ == 0) return 0.0;
    double bias = 0.0;
    for (Eigen::Index i = 0; i < j; ++i) {
      const double moved = Median(&moved_[At(i, j)]) / kMedianOfChiSquare;
      bias = std::max(bias, moved - kNoiseMargin * expected_(i, j) / rows_);
    }
    return noise_[j] / rows_ + bias;
  }

 private:
  static constexpr double kNoiseMargin = 1.5;
  static constexpr double kMedianOfChiSquare = 0.455;  // one degree of freedom

  size_t At(Eigen::Index i, Eigen::Index j) const { return static_cast<size_t>(i * noise_.size() + j); }

  Eigen::VectorXd noise_;
  Eigen::MatrixXd expected_;                // [shorter span][span]
  std::vector<std::vector<double>> moved_;  // the same, one entry per row
  int rows_ = 0;
};

std::vector<ExpectedError> ExpectErrors(const Eigen::VectorXd& t, const Eigen::VectorXd& x, Side side,
                                        const std::vector<int>& counts, int degree, double stddev, int rows) {
  const int first_row = side == Side::kCausal ? std::min(counts.back(), rows) - 1 : 0;
  const int stride = std::max(1, (rows - first_row) / kRowsToChooseSpan);
  const auto spans = static_cast<Eigen::Index>(counts.size());
  SpanComparison slope(spans), value(spans);
  for (int row = rows - 1; row >= first_row; row -= stride) {
    const Candidates c = FitCandidates(t, x, side, row, counts, degree, rows);
    slope.Add(c.slope, c.samples, stddev * stddev);
    value.Add(c.value, c.samples, stddev * stddev);
  }
  std::vector<ExpectedError> errors;
  for (Eigen::Index j = 0; j < spans; ++j)
    errors.push_back({slope.MeanSquareError(j), value.MeanSquareError(j)});
  return errors;
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
  std::vector<int> counts;
  if (options.span_s > 0.0) {
    counts.push_back(std::min(RowsOfSpan(t, options.span_s, rows), rows));
  } else {
    for (const int count : kSpans) {
      if (count >= options.degree + 2 && count <= rows) counts.push_back(count);
    }
  }
  if (counts.empty()) counts.push_back(rows);
  const auto errors = ExpectErrors(t, x, side, counts, options.degree, stddev, rows);
  size_t best = 0;
  for (size_t j = 1; j < counts.size(); ++j) {
    if (errors[j].slope < errors[best].slope) best = j;
  }
  return {counts[best], errors[best]};
}

// Noise as a local polynomial meets it: rows that repeat and time stamps that jump count in full here,
// which the median of EstimateNoise leaves out.
double StddevFor(const Eigen::VectorXd& t, const Eigen::VectorXd& x, const VelocityOptions& options) {
  if (options.position_stddev > 0.0) return options.position_stddev;
  constexpr int kOrder = 5;
  const double robust = EstimateNoise(t, x).stddev;
  if (t.size() < kOrder + 4) return robust;
  double sum = 0.0;
  const std::vector<double> differences = AbsoluteDifferences(t, x, kOrder);
  for (const double d : differences) sum += d * d;
  return std::max(robust, std::sqrt(sum / static_cast<double>(differences.size())));
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

Eigen::VectorXd VelocityStddev(const Recording& r, const VelocityOptions& options) {
  Eigen::VectorXd out(r.n());
  // A filter takes the white noise away and adds an error of its own.
  const VelocityLag late = EstimateVelocityLag(r);
  for (int i = 0; i < r.n(); ++i) {
    if (r.has_velocity()) {
      out[i] = std::hypot(EstimateNoise(r.t, r.v.row(i).transpose()).stddev, late.error[i]);
    } else {
      const Eigen::VectorXd q = r.q.row(i).transpose();
      const double stddev = StddevFor(r.t, q, options);
      out[i] = std::sqrt(ChooseSpan(r.t, q, Side::kCentred, r.rows(), stddev, options).error.slope);
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
  VelocityOptions velocity;
  velocity.position_stddev = set.noise.position_stddev.value_or(0.0);
  sensor.velocity_stddev = Pool(set, [&](const Recording& r) { return VelocityStddev(r, velocity); });
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
