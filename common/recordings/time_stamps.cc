#include "common/recordings/time_stamps.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "common/base/printf.h"

namespace rg::recordings {
namespace {

struct TimeUnit {
  const char* flag;
  const char* name;
  double per_s;
};
constexpr std::array<TimeUnit, 4> kTimeUnits = {{{"s", "seconds", 1.0},
                                                 {"ms", "milliseconds", 1e3},
                                                 {"us", "microseconds", 1e6},
                                                 {"ns", "nanoseconds", 1e9}}};

constexpr double kUsualPeriod = 0.005;                     // s, 200 Hz
constexpr double kNearFactor = 30.0;                       // of a rate that is expected
constexpr double kSlowestPeriod = 0.5;                     // s: slower logs are judged by their motion
constexpr double kSmoothStep = 0.3;                        // RMS of steps over the positions' spread
constexpr double kEpochFirst = 9.4e8, kEpochLast = 4.1e9;  // s: 2000 to 2100
constexpr double kGoTogether = 0.9;
constexpr double kEpochLike = 1e6;  // s
constexpr double kGapPeriods = 5.0, kGapSeconds = 0.1;

// Measured velocity over the slope of positions, by the most telling joint; none where they do not go
// together.
std::optional<double> VelocityToSlope(const Recording& r) {
  if (!r.has_velocity()) return std::nullopt;
  std::optional<double> ratio;
  double best = kGoTogether;
  for (int i = 0; i < r.n(); ++i) {
    double xx = 0.0, yy = 0.0, xy = 0.0;
    for (Eigen::Index k = 1; k + 1 < r.t.size(); ++k) {
      const double slope = (r.q(i, k + 1) - r.q(i, k - 1)) / (r.t[k + 1] - r.t[k - 1]);
      xx += slope * slope, yy += r.v(i, k) * r.v(i, k), xy += slope * r.v(i, k);
    }
    const double correlation = xx > 0.0 && yy > 0.0 ? xy / std::sqrt(xx * yy) : 0.0;
    if (correlation <= best) continue;
    best = correlation;
    ratio = xy / xx;
  }
  return ratio;
}

bool Near(double a, double b, double factor) { return a < factor * b && b < factor * a; }

const TimeUnit* UnitOfRatio(double ratio, double factor) {
  for (const TimeUnit& unit : kTimeUnits) {
    if (Near(ratio, unit.per_s, factor)) return &unit;
  }
  return nullptr;
}

// The unit that makes the rate most usual.
const TimeUnit& UnitOfPeriod(double period) {
  return *std::min_element(kTimeUnits.begin(), kTimeUnits.end(), [&](const TimeUnit& a, const TimeUnit& b) {
    const auto off = [&](const TimeUnit& u) { return std::abs(std::log(period / u.per_s / kUsualPeriod)); };
    return off(a) < off(b);
  });
}

// Whether positions change little from row to row: recorded much faster than the robot moves.
bool IsSmooth(const Recording& r) {
  double steps = 0.0, spread = 0.0;
  for (int i = 0; i < r.n(); ++i) {
    const Eigen::ArrayXd q = r.q.row(i).transpose().array();
    const auto K = q.size();
    const double joint_spread = (q - q.mean()).square().mean();
    if (!(joint_spread > 0.0)) continue;
    steps += (q.tail(K - 1) - q.head(K - 1)).square().mean() / joint_spread;
    spread += 1.0;
  }
  return spread > 0.0 && std::sqrt(steps / spread) < kSmoothStep;
}

const TimeUnit& UnitOf(const Recording& r, double period, std::optional<double> rate) {
  const TimeUnit& seconds = kTimeUnits[0];
  if (rate) {
    const TimeUnit* unit = UnitOfRatio(period * *rate, kNearFactor);
    if (unit) return *unit;
  }
  if (const auto ratio = VelocityToSlope(r)) {
    const TimeUnit* unit = UnitOfRatio(*ratio, 3.0);
    if (unit) return *unit;
  }
  for (const TimeUnit& unit : kTimeUnits) {
    const double epoch = r.t[0] / unit.per_s;
    if (unit.per_s > 1.0 && epoch > kEpochFirst && epoch < kEpochLast && period > kSlowestPeriod) return unit;
  }
  return period > kSlowestPeriod && IsSmooth(r) ? UnitOfPeriod(period) : seconds;
}

}  // namespace

Result<double> TimeUnitsPerSecond(const std::string& name) {
  for (const TimeUnit& unit : kTimeUnits) {
    if (name == unit.flag) return unit.per_s;
  }
  return InvalidError("--time-unit: '" + name + "', must be s, ms, us or ns");
}

Status CheckTimeUnit(const Recording& r, std::optional<double> rate) {
  const double period = r.SamplePeriod();
  if (!(period > 0.0)) return Status::Ok();
  const TimeUnit& unit = UnitOf(r, period, rate);
  if (unit.per_s == 1.0) return Status::Ok();
  return InvalidError(r.name + ": row 1, column time: " + Printf("%.10g", r.t[0]) + ", rows " +
                      Printf("%.10g", period) + " apart: time looks like " + unit.name + " (" +
                      Printf("%.4g", unit.per_s / period) + " Hz), s is expected: read it with --time-unit " +
                      unit.flag + ", or with --time-unit s if these are seconds");
}

void TakeEpochOff(Recording* r) {
  if (r->rows() == 0 || std::abs(r->t[0]) < kEpochLike) return;
  r->time_offset = std::floor(r->t[0]);
  r->t.array() -= r->time_offset;
}

double LongestStep(const Eigen::VectorXd& t) {
  Recording times;
  times.t = t;
  return std::max(kGapPeriods * times.SamplePeriod(), kGapSeconds);
}

std::vector<Gap> FindGaps(const Eigen::VectorXd& t) {
  std::vector<Gap> gaps;
  const double longest = LongestStep(t) * (1.0 + 1e-9);
  for (Eigen::Index k = 1; k < t.size(); ++k) {
    if (t[k] - t[k - 1] > longest) gaps.push_back({static_cast<int>(k), t[k] - t[k - 1]});
  }
  return gaps;
}

std::vector<Recording> SplitAtGaps(const Recording& r) {
  std::vector<Recording> pieces;
  int first = 0;
  const auto add = [&](int end) {
    pieces.push_back(Slice(r, first, end - first));
    if (std::isnan(r.window_origin)) pieces.back().window_origin = r.t[0];
    first = end;
  };
  const std::vector<Gap> gaps = FindGaps(r.t);
  if (gaps.empty()) return {r};
  for (const Gap& gap : gaps) add(gap.row);
  add(r.rows());
  return pieces;
}

namespace {

void AppendColumns(const Eigen::MatrixXd& more, Eigen::MatrixXd* x) {
  if (x->size() == 0 || more.size() == 0) return;
  const Eigen::Index before = x->cols();
  x->conservativeResize(Eigen::NoChange, before + more.cols());
  x->rightCols(more.cols()) = more;
}

// A piece without turns has zeros.
void JoinTurns(const Recording& r, Eigen::Index before, Recording* whole) {
  if (r.turns_added.size() == 0 && whole->turns_added.size() == 0) return;
  Eigen::MatrixXd turns = Eigen::MatrixXd::Zero(whole->q.rows(), whole->q.cols());
  if (whole->turns_added.size() > 0) turns.leftCols(before) = whole->turns_added;
  if (r.turns_added.size() > 0) turns.rightCols(r.turns_added.cols()) = r.turns_added;
  whole->turns_added = turns;
}

void AppendRows(const Eigen::VectorXd& more, Eigen::VectorXd* x) {
  const Eigen::Index before = x->size();
  x->conservativeResize(before + more.size());
  x->tail(more.size()) = more;
}

bool Continues(const Recording& before, const Recording& r) {
  return before.name == r.name && before.split == r.split && before.t[before.rows() - 1] < r.t[0] &&
         before.has_velocity() == r.has_velocity();
}

}  // namespace

std::vector<Recording> JoinPieces(std::vector<Recording> recordings) {
  std::vector<Recording> out;
  for (Recording& r : recordings) {
    if (out.empty() || !Continues(out.back(), r)) {
      out.push_back(std::move(r));
      continue;
    }
    Recording& whole = out.back();
    AppendRows(r.t, &whole.t);
    const Eigen::Index before = whole.q.cols();
    AppendColumns(r.q, &whole.q);
    JoinTurns(r, before, &whole);
    AppendColumns(r.v, &whole.v);
    AppendColumns(r.effort_command, &whole.effort_command);
    AppendColumns(r.effort_measured, &whole.effort_measured);
    for (auto& [name, column] : whole.other) AppendRows(r.other.at(name), &column);
  }
  return out;
}

}  // namespace rg::recordings
