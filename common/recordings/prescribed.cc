#include "common/recordings/prescribed.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
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
constexpr double kAnySpeed = 1e2;    // stddev of a motion of which nothing is known
constexpr double kWandered = 10.0;   // s in which the acceleration has come to be what it is at the first row
// How much a motion wanders is chosen from what lies within so much of a row on either side: arms rest, and move fast.
constexpr double kAround = 0.25;     // s
constexpr int kRowsAround = 25;      // at least
constexpr double kVarianceHeld = 0.99;
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
  VectorXd log_likelihood;  // of each row, given those before it
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

// `intensity`: of the jerk between each row and the next.
Pass Forward(const Track& track, const VectorXd& intensity) {
  const auto K = static_cast<size_t>(track.t.size());
  Pass out;
  for (auto* list : {&out.x, &out.ahead}) list->resize(K);
  for (auto* list : {&out.P, &out.P_ahead}) list->resize(K);
  out.log_likelihood.setZero(track.t.size());
  Vector3d x(track.q[0], 0.0, 0.0);
  Matrix3d P = Vector3d(track.q_variance, kAnySpeed * kAnySpeed, intensity[0] * kWandered).asDiagonal();
  for (size_t k = 0; k < K; ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    if (k > 0) {
      const double dt = track.t[row] - track.t[row - 1];
      const Matrix3d F = Transition(dt);
      x = F * x;
      P = F * P * F.transpose() + Wander(dt, intensity[row - 1]);
    }
    out.ahead[k] = x, out.P_ahead[k] = P;
    out.log_likelihood[row] += Correct(0, track.q[row], track.q_variance, &x, &P);
    if (track.v.size() > 0) out.log_likelihood[row] += Correct(1, track.v[row], track.v_variance, &x, &P);
    out.x[k] = x, out.P[k] = P;
  }
  return out;
}

// Sums over the rows within kAround of each.
VectorXd SumsAround(const VectorXd& t, const VectorXd& x) {
  const Eigen::Index K = t.size();
  VectorXd before = VectorXd::Zero(K + 1), out(K);
  for (Eigen::Index k = 0; k < K; ++k) before[k + 1] = before[k] + x[k];
  Eigen::Index first = 0, end = 0;
  for (Eigen::Index k = 0; k < K; ++k) {
    while (t[first] < t[k] - kAround) ++first;
    while (end < K && t[end] <= t[k] + kAround) ++end;
    out[k] = before[std::max(end, std::min(K, k + kRowsAround + 1))] -
             before[std::min(first, std::max<Eigen::Index>(0, k - kRowsAround))];
  }
  return out;
}

// What makes the rows around each row likeliest.
VectorXd LikeliestIntensity(const Track& track) {
  const Eigen::Index K = track.t.size();
  VectorXd best = VectorXd::Ones(K), most = VectorXd::Constant(K, -std::numeric_limits<double>::infinity());
  for (double power = kSlowest; power <= kFastest; power += kFiner) {
    const double intensity = std::pow(10.0, power);
    const VectorXd likely = SumsAround(track.t, Forward(track, VectorXd::Constant(K, intensity)).log_likelihood);
    for (Eigen::Index k = 0; k < K; ++k) {
      if (likely[k] > most[k]) most[k] = likely[k], best[k] = intensity;
    }
  }
  return best;
}

// What the smoother says of one joint: x_k given x_{k+1} is x̄_k + gain_k·(x_{k+1} − ahead_{k+1}) and `left_k`
// about it.
struct Smoothed {
  Eigen::Matrix3Xd x;                // 3 × K, given all rows
  std::vector<Matrix3d> P;           // of it
  std::vector<Matrix3d> gain, left;  // of all rows but the last
  std::vector<Vector3d> filtered, ahead;
};

Smoothed Smooth(const Track& track) {
  const VectorXd intensity = LikeliestIntensity(track);
  Pass pass = Forward(track, intensity);
  const Eigen::Index K = track.t.size();
  Smoothed out;
  out.x.resize(3, K);
  out.P.resize(static_cast<size_t>(K));
  out.gain.resize(static_cast<size_t>(K) - 1), out.left.resize(static_cast<size_t>(K) - 1);
  out.x.col(K - 1) = pass.x.back(), out.P.back() = pass.P.back();
  for (Eigen::Index row = K - 2; row >= 0; --row) {
    const auto k = static_cast<size_t>(row);
    const double dt = track.t[row + 1] - track.t[row];
    const Matrix3d F = Transition(dt);
    const Matrix3d& gain = out.gain[k] = pass.P[k] * F.transpose() * pass.P_ahead[k + 1].inverse();
    out.x.col(row) = pass.x[k] + gain * (out.x.col(row + 1) - pass.ahead[k + 1]);
    const Matrix3d keep = Matrix3d::Identity() - gain * F;  // Joseph's form again
    out.left[k] = keep * pass.P[k] * keep.transpose() + gain * Wander(dt, intensity[row]) * gain.transpose();
    out.P[k] = out.left[k] + gain * out.P[k + 1] * gain.transpose();
  }
  out.filtered = std::move(pass.x), out.ahead = std::move(pass.ahead);
  return out;
}

// Rows of the recording's i-th prescribed joint, with what its sensors' noise is.
Track TrackOf(const Recording& r, Eigen::Index i, const VelocityLag& late) {
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
  return track;
}

std::vector<Smoothed> SmoothedJoints(const Recording& r) {
  std::vector<Smoothed> out;
  if (r.prescribed.empty()) return out;
  const VelocityLag late = EstimateVelocityLag(r);
  for (Eigen::Index i = 0; i < std::ssize(r.prescribed); ++i) out.push_back(Smooth(TrackOf(r, i, late)));
  return out;
}

SmoothMotionRows RowsFor(Eigen::Index joints, Eigen::Index rows) {
  return {Eigen::MatrixXd(joints, rows), Eigen::MatrixXd(joints, rows), Eigen::MatrixXd(joints, rows)};
}

void SetJoint(Eigen::Index i, const Eigen::Matrix3Xd& x, SmoothMotionRows* to) {
  to->q.row(i) = x.row(0), to->v.row(i) = x.row(1), to->a.row(i) = x.row(2);
}

// A draw from N(0, P); P may be singular, or not quite positive by rounding.
Vector3d DrawnFrom(const Matrix3d& P, Rng& rng) {
  const Eigen::LDLT<Matrix3d> ldlt(P);
  Vector3d z = ldlt.vectorD().cwiseMax(0.0).cwiseSqrt();
  for (double& entry : z) entry *= rng.Normal();
  return ldlt.transpositionsP().transpose() * Vector3d(ldlt.matrixL() * z);
}

}  // namespace

struct PrescribedDoubt::Joint {
  Smoothed smoothed;
};

PrescribedDoubt::PrescribedDoubt(const Recording& recording) {
  for (Smoothed& joint : SmoothedJoints(recording)) joints_.push_back({std::move(joint)});
}
PrescribedDoubt::~PrescribedDoubt() = default;
PrescribedDoubt::PrescribedDoubt(PrescribedDoubt&&) noexcept = default;

WaysToDiffer PrescribedDoubt::Ways(int i, int first, int last) const {
  const Smoothed& s = joints_[static_cast<size_t>(i)].smoothed;
  const Eigen::Index rows = last - first + 1;
  // Cov(x_k, v_l) of all rows k, l here: backwards from the diagonal, Cov(x_k, x_l) = gain_k·Cov(x_{k+1},
  // x_l) for k < l.
  Eigen::MatrixXd q(rows, rows), v(rows, rows), a(rows, rows);
  for (Eigen::Index l = 0; l < rows; ++l) {
    Matrix3d C = s.P[static_cast<size_t>(first + l)];
    for (Eigen::Index k = l; k >= 0; --k) {
      if (k < l) C = s.gain[static_cast<size_t>(first + k)] * C;
      q(k, l) = C(0, 1), v(k, l) = v(l, k) = C(1, 1), a(k, l) = C(2, 1);
      q(l, k) = C(1, 0), a(l, k) = C(1, 2);
    }
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(v);
  const double all = eigen.eigenvalues().cwiseMax(0.0).sum();
  Eigen::Index count = 0;
  for (double held = 0; count < rows && held < kVarianceHeld * all; ++count)
    held += eigen.eigenvalues()[rows - 1 - count];
  const VectorXd size = eigen.eigenvalues().tail(count).cwiseSqrt();
  const Eigen::MatrixXd along = eigen.eigenvectors().rightCols(count) * size.cwiseInverse().asDiagonal();
  return {q * along, v * along, a * along};
}

SmoothMotionRows PrescribedDoubt::Draw(Rng& rng) const {
  const auto m = std::ssize(joints_);
  SmoothMotionRows out = RowsFor(m, m == 0 ? 0 : joints_[0].smoothed.x.cols());
  for (Eigen::Index i = 0; i < m; ++i) {
    const Smoothed& s = joints_[static_cast<size_t>(i)].smoothed;
    Eigen::Matrix3Xd x = s.x;
    x.col(x.cols() - 1) += DrawnFrom(s.P.back(), rng);
    for (Eigen::Index row = x.cols() - 2; row >= 0; --row) {
      const auto k = static_cast<size_t>(row);
      x.col(row) = s.filtered[k] + s.gain[k] * (x.col(row + 1) - s.ahead[k + 1]) + DrawnFrom(s.left[k], rng);
    }
    SetJoint(i, x, &out);
  }
  return out;
}

SmoothMotionRows SmoothPrescribed(const Recording& r) {
  const std::vector<Smoothed> joints = SmoothedJoints(r);
  SmoothMotionRows out = RowsFor(std::ssize(joints), r.rows());
  for (Eigen::Index i = 0; i < std::ssize(joints); ++i) SetJoint(i, joints[static_cast<size_t>(i)].x, &out);
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
