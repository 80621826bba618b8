#include "common/recordings/command_time.h"

#include <algorithm>
#include <cmath>

#include "common/recordings/noise.h"

namespace rg::recordings {

const Eigen::VectorXd& CommandTimes(const Recording& recording) {
  const auto column = recording.other.find(kCommandTime);
  if (column == recording.other.end() || column->second.size() != recording.t.size()) return recording.t;
  const Eigen::VectorXd& sent = column->second;
  for (Eigen::Index k = 0; k < sent.size(); ++k) {
    const bool in_order = sent[k] >= recording.t[k] && (k == 0 || sent[k] > sent[k - 1]);
    if (!in_order || (k + 2 < sent.size() && sent[k] > recording.t[k + 2])) return recording.t;
  }
  return sent;
}

bool StartsAtRest(const Recording& recording) {
  constexpr double kAtRest = 3.0;  // stddev
  if (!recording.has_velocity() || recording.rows() == 0) return recording.rows() > 0;
  for (int j = 0; j < recording.n(); ++j) {
    if (recording.IsPrescribed(j)) continue;
    const double noise = EstimateNoise(recording.t, recording.v.row(j).transpose()).stddev;
    if (std::abs(recording.v(j, 0)) > kAtRest * noise) return false;
  }
  return true;
}

double MotionBegin(const Recording& recording) {
  const bool commanded = recording.drive == EffortKind::kCommand && StartsAtRest(recording);
  return commanded ? CommandTimes(recording)[0] : recording.t[0];
}

}  // namespace rg::recordings
