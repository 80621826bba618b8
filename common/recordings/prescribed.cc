#include "common/recordings/prescribed.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "common/recordings/noise.h"
#include "common/recordings/velocity_lag.h"

namespace rg::recordings {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kLeastPosition = 1e-7, kLeastVelocity = 1e-6;  // stddev: no sensor is better
constexpr double kAnySpeed = 1e2, kAnyAcceleration = 1e4;  // stddev of a motion of which nothing is known
constexpr int kRowsToChoose = 4000;
constexpr double kSlowest = -1.0, kFastest = 8.0,
                 kFiner = 0.5;  // powers of ten of the jerk's intensity, its step

// One joint's rows.
struct Track {
  VectorXd t, q, v;  // v may be empty
  double q_variance = 1.0, v_variance = 1.0;
};

// Filtered and predicted (q, v, a) of each row.
struct Pass {
  std::vector<Vector3d> x, ahead;
  std::vector<Matrix3d> P, P_ahead;
  double log_likelihood = 0.0;
};

Matrix3d Transition(double dt) {
  Matrix3d F = Matrix3d::Identity();
  F(0, 1) = F(1, 2) = dt;
  F(0, 2) = 0.5 * dt * dt;
  return F;
}

Matrix3d Wander(double dt, double intensity) {
  Matrix3d Q;
  const double d2 = dt * dt, d3 = d2 * dt;
  Q << d3 * d2 / 20, d2 * d2 / 8, d3 / 6, d2 * d2 / 8, d3 / 3, d2 / 2, d3 / 6, d2 / 2, dt;
  return intensity * Q;
}

// Takes in one measurement of entry `i`; returns its log likelihood.
double Correct(int i, double measured, double variance, Vector3d* x, Matrix3d* P) {
  const double S = (*P)(i, i) + variance, off = measured - (*x)[i];
  const Vector3d gain = P->col(i) / S;
  *x += gain * off;
  // Joseph's form: stays symmetric and positive.
  Matrix3d keep = Matrix3d::Identity();
  keep.col(i) -= gain;
  *P = (keep * *P * keep.transpose() + variance * gain * gain.transpose()).eval();
  return -0.5 * (off * off / S + std::log(S));
}

Pass Forward(const Track& track, double intensity) {
  const auto K = static_cast<size_t>(track.t.size());
  Pass out;
  for (auto* list : {&out.x, &out.ahead}) list->resize(K);
  for (auto* list : {&out.P, &out.P_ahead}) list->resize(K);
  Vector3d x(track.q[0], 0.0, 0.0);
  Matrix3d P =
      Vector3d(track.q_variance, kAnySpeed * kAnySpeed, kAnyAcceleration * kAnyAcceleration).asDiagonal();
  for (size_t k = 0; k < K; ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    if (k > 0) {
      const double dt = track.t[row] - track.t[row - 1];
      const Matrix3d F = Transition(dt);
      x = F * x;
      P = F * P * F.transpose() + Wander(dt, intensity);
    }
    out.ahead[k] = x, out.P_ahead[k] = P;
    out.log_likelihood += Correct(0, track.q[row], track.q_variance, &x, &P);
    if (track.v.size() > 0) out.log_likelihood += Correct(1, track.v[row], track.v_variance, &x, &P);
    out.x[k] = x, out.P[k] = P;
  }
  return out;
}

double LikeliestIntensity(const Track& track) {
  Track part = track;
  if (track.t.size() > kRowsToChoose) {
    const Eigen::Index first = (track.t.size() - kRowsToChoose) / 2;
    part.t = track.t.segment(first, kRowsToChoose), part.q = track.q.segment(first, kRowsToChoose);
    if (track.v.size() > 0) part.v = track.v.segment(first, kRowsToChoose);
  }
  double best = 1.0, most = -std::numeric_limits<double>::infinity();
  for (double power = kSlowest; power <= kFastest; power += kFiner) {
    const double intensity = std::pow(10.0, power), likely = Forward(part, intensity).log_likelihood;
    if (likely > most) most = likely, best = intensity;
  }
  return best;
}

// 3 × K.
Eigen::Matrix3Xd Smooth(const Track& track) {
  const Pass pass = Forward(track, LikeliestIntensity(track));
  const Eigen::Index K = track.t.size();
  Eigen::Matrix3Xd out(3, K);
  Vector3d x = pass.x.back();
  out.col(K - 1) = x;
  for (Eigen::Index row = K - 2; row >= 0; --row) {
    const auto k = static_cast<size_t>(row);
    const Matrix3d F = Transition(track.t[row + 1] - track.t[row]);
    const Matrix3d gain = pass.P[k] * F.transpose() * pass.P_ahead[k + 1].inverse();
    x = pass.x[k] + gain * (x - pass.ahead[k + 1]);
    out.col(row) = x;
  }
  return out;
}

}  // namespace

SmoothMotionRows SmoothPrescribed(const Recording& r) {
  const auto m = static_cast<Eigen::Index>(r.prescribed.size());
  SmoothMotionRows out{Eigen::MatrixXd(m, r.rows()), Eigen::MatrixXd(m, r.rows()),
                       Eigen::MatrixXd(m, r.rows())};
  if (m == 0) return out;
  const VelocityLag late = EstimateVelocityLag(r);
  for (Eigen::Index i = 0; i < m; ++i) {
    const int j = r.prescribed[static_cast<size_t>(i)];
    Track track{r.t, r.q.row(j).transpose(), {}};
    const SignalNoise noise = EstimateNoise(r.t, track.q);
    const double q_stddev = std::max({kLeastPosition, noise.stddev, noise.resolution / std::sqrt(12.0)});
    track.q_variance = q_stddev * q_stddev;
    const bool measured = r.has_velocity() && std::find(r.without_velocity.begin(), r.without_velocity.end(),
                                                        j) == r.without_velocity.end();
    if (measured) {
      track.v = r.v.row(j).transpose();
      const double v_stddev =
          std::max(kLeastVelocity, std::hypot(EstimateNoise(r.t, track.v).stddev, late.error[j]));
      track.v_variance = v_stddev * v_stddev;
    }
    const Eigen::Matrix3Xd x = Smooth(track);
    out.q.row(i) = x.row(0), out.v.row(i) = x.row(1), out.a.row(i) = x.row(2);
  }
  return out;
}

void FillVelocities(Recording* r) {
  if (r->without_velocity.empty() || !r->has_velocity()) return;
  Recording alone;
  alone.t = r->t;
  alone.q.resize(1, r->rows());
  for (const int i : r->without_velocity) {
    alone.q = r->q.row(i);
    r->v.row(i) = SmoothVelocity(alone);
  }
}

Status ResolvePrescribed(RecordingSet* set) {
  set->prescribed.clear();
  for (size_t j = 0; j < set->joints.size(); ++j) {
    const std::string& joint = set->joints[j];
    const auto is = [&](const Recording& r) { return r.IsPrescribed(static_cast<int>(j)); };
    const auto without = std::find_if(set->recordings.begin(), set->recordings.end(), is);
    if (without == set->recordings.end()) continue;
    if (!std::all_of(set->recordings.begin(), set->recordings.end(), is)) {
      return InvalidError(set->folder + "/" + without->name + ": header (line 1): no effort of " + joint +
                          ", which other recordings have (\"prescribed\" in the manifest: it moves as "
                          "measured)");
    }
    set->prescribed.push_back(joint);
  }
  return Status::Ok();
}

std::string NoteOnPrescribed(const RecordingSet& set) {
  if (set.prescribed.empty()) return "";
  std::string names;
  for (const std::string& joint : set.prescribed) names += (names.empty() ? "" : ", ") + joint;
  const bool one = set.prescribed.size() == 1;
  return names + (one ? " moves" : " move") + " as measured (prescribed): " +
         (set.prescribed_listed ? "the manifest says so"
          : one                 ? "it has no effort column, others have"
                                : "they have no effort columns, others have") +
         "; nothing is said of " + (one ? "it" : "them");
}

}  // namespace rg::recordings
