#include "common/recordings/velocity_column.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <vector>

namespace rg::recordings {
namespace {

using Eigen::Index;
using Eigen::VectorXd;

constexpr double kSlopeBlock = 0.1;  // s over which slopes are taken; at least five rows
constexpr int kBlockRows = 5;
constexpr double kOtherSpeed = 0.3;   // of the RMS slope: differs clearly
constexpr double kSensorSteps = 3.0;  // of the sensor's step
constexpr double kNoiseSteps = 10.0;  // of what the positions' noise makes of a slope
constexpr double kFrozenShare = 0.1;  // of the moving blocks

// Robust spread of second differences, as noise of one position.
double PositionNoise(const VectorXd& q) {
  std::vector<double> d;
  for (Index k = 1; k + 1 < q.size(); ++k) d.push_back(std::abs(q[k + 1] - 2 * q[k] + q[k - 1]));
  if (d.empty()) return 0.0;
  std::nth_element(d.begin(), d.begin() + d.size() / 2, d.end());
  return 1.4826 * d[d.size() / 2] / std::sqrt(6.0);
}

// Smallest change of the column; 0 where it never changes.
double SmallestStep(const VectorXd& v) {
  double least = std::numeric_limits<double>::infinity();
  for (Index k = 1; k < v.size(); ++k) {
    const double step = std::abs(v[k] - v[k - 1]);
    if (step > 0.0) least = std::min(least, step);
  }
  return std::isfinite(least) ? least : 0.0;
}

struct SlopeBlock {
  double slope, seconds, value;
  bool still;  // one value throughout
};

std::vector<SlopeBlock> SlopeBlocks(const VectorXd& t, const VectorXd& q, const VectorXd& v) {
  std::vector<SlopeBlock> out;
  Index start = 0;
  bool still = true;
  for (Index k = 1; k < t.size(); ++k) {
    still = still && v[k] == v[start];
    if (t[k] - t[start] < kSlopeBlock || k - start < kBlockRows) continue;
    out.push_back({(q[k] - q[start]) / (t[k] - t[start]), t[k] - t[start], v[start], still});
    start = k;
    still = true;
  }
  return out;
}

// Share of the moving blocks in which the column stands still at another speed.
double FrozenShare(const VectorXd& t, const VectorXd& q, const VectorXd& v) {
  const std::vector<SlopeBlock> blocks = SlopeBlocks(t, q, v);
  if (std::none_of(blocks.begin(), blocks.end(), [](const SlopeBlock& b) { return b.still; })) return 0.0;
  double squares = 0.0;
  for (const SlopeBlock& b : blocks) squares += b.slope * b.slope;
  const double rms = std::sqrt(squares / static_cast<double>(blocks.size()));
  const double noise = PositionNoise(q), step = SmallestStep(v);
  double moving = 0.0, frozen = 0.0;
  for (const SlopeBlock& b : blocks) {
    const double clear =
        std::max({kOtherSpeed * rms, kSensorSteps * step, kNoiseSteps * noise * std::sqrt(2.0) / b.seconds});
    if (std::abs(b.slope) <= clear) continue;
    moving += 1.0;
    if (b.still && std::abs(b.slope - b.value) > clear) frozen += 1.0;
  }
  return moving >= 3.0 ? frozen / moving : 0.0;
}

}  // namespace

void LeaveOutFrozenVelocity(Recording* r) {
  if (!r->has_velocity()) return;
  for (int i = 0; i < r->n(); ++i) {
    const VectorXd v = r->v.row(i).transpose();
    const double share = FrozenShare(r->t, r->q.row(i).transpose(), v);
    if (share <= kFrozenShare) continue;
    const bool constant = (v.array() == v[0]).all();
    char text[96];
    if (constant && v[0] == 0.0) {
      std::snprintf(text, sizeof text, " is 0 throughout");
    } else {
      std::snprintf(text, sizeof text, " stands still for %.0f %% of the time", 100 * share);
    }
    r->notes.push_back("velocity." + r->joints[static_cast<size_t>(i)] + text +
                       " while its position moves: velocities are left out and estimated from positions");
    r->v.resize(0, 0);
    r->without_velocity.clear();
    return;
  }
}

}  // namespace rg::recordings
