#include "services/diagnosis/hypotheses/rod_screen.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "common/base/check.h"
#include "common/base/parallel.h"
#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/force_samples.h"
#include "services/diagnosis/likelihood/free_force.h"
#include "services/diagnosis/likelihood/swing_starts.h"

namespace rg::diagnosis {

namespace {

using Eigen::Matrix3d, Eigen::Vector3d;

constexpr double kFollowed = 3.0;     // s of each recording: later an error of the length is one of the phase
constexpr double kPut = 8.0;          // s of each recording, which trials begin in
constexpr Eigen::Index kStride = 2;   // samples of the fine motion, in a step of the rod
constexpr size_t kRodRecordings = 8;  // at most
constexpr double kShortestSwing = 0.02, kLongestSwing = 0.35;  // m, of a point that swings alike
constexpr double kNextLength = 1.03;
constexpr double kDecays[] = {0.0, 0.5};  // 1/s, of the rate of turn relative to the link
constexpr double kStartDecay = 0.1;       // where a fit of one that hardly decays begins
constexpr double kMostLeftByRod = 0.9;    // of what any two laws leave
constexpr double kClearGain = 30.0;       // of χ²
constexpr double kOtherLength = 1.15;     // from which on a length is another one
constexpr size_t kMostLengths = 2;

// What the hinge of a rod did in one recording, at every other sample of the fine motion.
struct HingeMotion {
  double begin = 0, dt = 0;
  std::vector<Matrix3d> axes;            // of its link, in the world's
  std::vector<Vector3d> turn, velocity;  // rates of its link; of the hinge
  std::vector<Vector3d> pull;            // g − a at the hinge: what acts on a unit of mass there
  std::vector<MatrixXd> jacobian;        // 3 × n

  size_t steps() const { return pull.size(); }
  // Steps from its beginning to t [s].
  double StepsTo(double t) const { return std::max(0.0, (t - begin) / dt); }
};

HingeMotion MotionOfHinge(const sim::Plant& nominal, const model::Frame& frame, const FineMotion& fine,
                          double seconds) {
  const dynamics::Mechanism mechanism(nominal.model());
  dynamics::Workspace workspace;
  MatrixXd J(6, fine.q.rows());
  HingeMotion out;
  out.begin = fine.t[0], out.dt = kStride * (fine.t[1] - fine.t[0]);
  // Nobody knows how it moved where rows are missing.
  if (!fine.gaps.empty()) seconds = std::min(seconds, fine.gaps.front().first - fine.t[0]);
  const auto count = std::clamp<size_t>(static_cast<size_t>(std::max(0.0, seconds) / out.dt) + 1, 1,
                                        (fine.t.size() + kStride - 1) / kStride);
  for (size_t k = 0; k < count; ++k) {
    const Eigen::Index at = kStride * static_cast<Eigen::Index>(k);
    const model::Pose pose = dynamics::FrameKinematics(mechanism, workspace, fine.q.col(at), frame, J);
    const VectorXd twist = J * fine.v.col(at);
    out.axes.push_back(pose.rotation);
    out.turn.push_back(twist.head<3>()), out.velocity.push_back(twist.tail<3>());
    out.jacobian.push_back(J.bottomRows<3>());
  }
  for (size_t k = 0; k < count; ++k) {
    const size_t a = k > 0 ? k - 1 : k, b = std::min(k + 1, count - 1);
    const double between = out.dt * static_cast<double>(std::max<size_t>(1, b - a));
    out.pull.push_back(nominal.options().gravity - (out.velocity[b] - out.velocity[a]) / between);
  }
  return out;
}

// Calls visit(step, u, ω, ω̇), with u the rod's direction and ω its rate of turn across u:
// u̇ = ω × u,  ω̇ = u × (g − a)/ℓ − c (ω − ω_link).
template <class Visit>
void Follow(const HingeMotion& hinge, const Vector3d& gravity, const Swing& swing, const Visit& visit) {
  Vector3d u = gravity.normalized();
  if (swing.start > 0) {
    const int axis = (swing.start - 1) / 2;
    u = hinge.axes[0].col(axis) * (swing.start % 2 == 0 ? -1.0 : 1.0);
  }
  const auto across = [&](const Vector3d& x) -> Vector3d { return x - u * u.dot(x); };
  Vector3d w = swing.start > 0 ? across(hinge.turn[0]) : Vector3d(Vector3d::Zero());
  const auto rate = [&](size_t k) -> Vector3d {
    return u.cross(hinge.pull[k]) / swing.length - swing.decay * (w - across(hinge.turn[k]));
  };
  Vector3d dw = rate(0);
  for (size_t k = 0; k < hinge.steps(); ++k) {
    visit(k, u, w, dw);
    if (k + 1 == hinge.steps()) break;
    w += 0.5 * hinge.dt * dw;  // leapfrog
    const double angle = w.norm() * hinge.dt;
    if (angle > 1e-12) u = (Eigen::AngleAxisd(angle, w.normalized()) * u).normalized();
    dw = rate(k + 1);
    w = across(w + 0.5 * hinge.dt * dw);
  }
}

// Force on the hinge of a unit of mass on the rod, beyond that of one at rest: −ℓ ü.
std::vector<Vector3d> PullOf(const HingeMotion& hinge, const Vector3d& gravity, const Swing& swing) {
  std::vector<Vector3d> out;
  Follow(hinge, gravity, swing, [&](size_t, const Vector3d& u, const Vector3d& w, const Vector3d& dw) {
    out.push_back(-swing.length * (dw.cross(u) + w.cross(w.cross(u))));
  });
  return out;
}

// Direction in its link's axes, and its rate, 6 × steps.
MatrixXd WayOf(const HingeMotion& hinge, const Vector3d& gravity, const Swing& swing) {
  MatrixXd out(6, static_cast<Eigen::Index>(hinge.steps()));
  Follow(hinge, gravity, swing, [&](size_t k, const Vector3d& u, const Vector3d& w, const Vector3d&) {
    const Matrix3d& axes = hinge.axes[k];
    out.col(static_cast<Eigen::Index>(k)) << axes.transpose() * u,
        axes.transpose() * (w - hinge.turn[k]).cross(u);
  });
  return out;
}

// Segments of the missing force in the first seconds, whitened: row j·segments + s is joint j's in segment s.
class RodRegression {
 public:
  RodRegression(const FitSetting& setting, const MissingForce& missing, const FeatureSet& laws,
                const model::Frame& frame, int threads)
      : data_(setting.data), n_(setting.data.n), gravity_(setting.nominal.options().gravity) {
    for (size_t r = 0; r < std::min(data_.fine.size(), kRodRecordings); ++r)
      hinges_.push_back(MotionOfHinge(setting.nominal, frame, data_.fine[r], kFollowed));
    FindSegments(missing);
    const auto rows = n_ * static_cast<Eigen::Index>(segments_.size());
    force_.resize(rows);
    for (size_t i = 0; i < segments_.size(); ++i)
      Put(static_cast<Eigen::Index>(i), missing.force[segments_[i].window].col(segments_[i].column), &force_);
    at_rest_ = Torques([&](size_t r, size_t k) -> const Vector3d& { return hinges_[r].pull[k]; });
    at_rest_.normalize();
    WithoutMassAtRest(force_);
    if (segments_.empty()) return;
    MakeLaws(laws);
    MakeSwings(threads);
  }

  struct Hit {
    Swing swing;
    int law = -1;     // feature; -1: none
    double mass = 0;  // moment of the rod over its length, kg
    double left = 0;  // of the squares of the whitened force
  };

  // Of each swing with the law that leaves least beside it, the best first.
  std::vector<Hit> Hits() const {
    std::vector<Hit> out;
    const double all = force_.squaredNorm();
    for (size_t i = 0; i < swings_.size(); ++i) {
      const auto column = swing_columns_.col(static_cast<Eigen::Index>(i));
      const Term swing{column.squaredNorm(), column.dot(force_)};
      if (!(swing.squares > 0) || !std::isfinite(swing.squares)) continue;
      Hit best{swings_[i], -1, 0, std::numeric_limits<double>::infinity()};
      const auto offer = [&](int law, double mass, double left) {
        if (mass > 0 && left < best.left) best.law = law, best.mass = mass, best.left = left;
      };
      offer(-1, swing.force / swing.squares, all - swing.Gain());
      for (const Law& law : laws_) {
        const double both = law.with_swings[static_cast<Eigen::Index>(i)];
        const double det = Determinant(swing, law.own, both);
        if (det == 0) continue;
        offer(law.feature, (swing.force * law.own.squares - law.own.force * both) / det,
              all - GainOfBoth(swing, law.own, both));
      }
      if (std::isfinite(best.left)) out.push_back(best);
    }
    std::ranges::sort(out, {}, &Hit::left);
    return out;
  }

  // About seconds of one thread.
  double Work() const {
    double steps = 0;
    for (const HingeMotion& hinge : hinges_) steps += static_cast<double>(hinge.steps());
    const double pairs = static_cast<double>(segments_.size() * laws_.size());
    return static_cast<double>(swings_.size()) * (1.5e-7 * steps + 3e-10 * pairs);
  }

  // The least of what two laws leave.
  double LeftByLaws() const {
    double gain = 0;
    for (size_t a = 0; a < laws_.size(); ++a) {
      gain = std::max(gain, laws_[a].own.Gain());
      for (size_t b = 0; b < a; ++b)
        gain = std::max(gain, GainOfBoth(laws_[a].own, laws_[b].own, Products(laws_[a], laws_[b])));
    }
    return force_.squaredNorm() - gain;
  }

 private:
  // 1 − cos² of two columns, from which on they are two. Effort, inertia and a mass at rest add up to the
  // missing force itself, in coefficients that no drive has.
  static constexpr double kApart = 0.05;
  static constexpr double kNothing = 1e-6;  // of a law's squares, beside a mass at rest

  struct Segment {
    size_t window, recording, from, to;  // steps
    Eigen::Index column;
    VectorXd weight;  // n, 1/σ
  };
  // A column's squares, and its product with the missing force.
  struct Term {
    double squares = 0, force = 0;
    double Gain() const { return force * force / squares; }
  };
  struct Law {
    int feature = 0, joint = 0;
    double at_rest = 0;  // what it has of a mass at rest
    Term own;
    VectorXd with_swings;
  };

  // Of their normal equations; 0 where the columns are alike. both: their product.
  static double Determinant(const Term& a, const Term& b, double both) {
    const double det = a.squares * b.squares - both * both;
    return det > kApart * a.squares * b.squares ? det : 0.0;
  }
  // Of squares that both explain; of the first alone where they are alike.
  static double GainOfBoth(const Term& a, const Term& b, double both) {
    const double det = Determinant(a, b, both);
    if (det == 0) return a.Gain();
    return (a.force * a.force * b.squares - 2 * a.force * b.force * both + b.force * b.force * a.squares) /
           det;
  }
  double Products(const Law& a, const Law& b) const {
    const double same =
        a.joint == b.joint ? law_columns_.col(a.feature).dot(law_columns_.col(b.feature)) : 0.0;
    return same - a.at_rest * b.at_rest;
  }

  void FindSegments(const MissingForce& missing) {
    for (size_t w = 0; w < data_.windows.size(); ++w) {
      const auto r = static_cast<size_t>(data_.windows[w].recording);
      if (r >= hinges_.size() || missing.t[w].empty()) continue;
      const double half = 0.5 * (data_.windows[w].t.back() - data_.windows[w].t.front()) /
                          static_cast<double>(missing.t[w].size());
      for (size_t s = 0; s < missing.t[w].size(); ++s) {
        const auto column = static_cast<Eigen::Index>(s);
        const auto from = static_cast<size_t>(std::lround(hinges_[r].StepsTo(missing.t[w][s] - half))),
                   to = static_cast<size_t>(std::lround(hinges_[r].StepsTo(missing.t[w][s] + half)));
        if (from >= to || to > hinges_[r].steps() || !missing.force[w].col(column).allFinite()) continue;
        // Nothing acts on a joint that moves as prescribed.
        VectorXd weight = missing.stddev[w].col(column).cwiseInverse();
        for (int j = 0; j < n_; ++j) {
          if (!data_.Judged(j)) weight[j] = 0;
        }
        if (weight.allFinite()) segments_.push_back({w, r, from, to, column, weight});
      }
    }
  }

  void Put(Eigen::Index segment, const VectorXd& torque, VectorXd* column) const {
    const auto S = static_cast<Eigen::Index>(segments_.size());
    for (int j = 0; j < n_; ++j)
      (*column)[j * S + segment] = torque[j] * segments_[static_cast<size_t>(segment)].weight[j];
  }

  // The joints' torques by a force at the hinge, its means over segments.
  template <class ForceAt>
  VectorXd Torques(const ForceAt& force) const {
    VectorXd out(n_ * static_cast<Eigen::Index>(segments_.size()));
    for (size_t i = 0; i < segments_.size(); ++i) {
      const Segment& s = segments_[i];
      VectorXd torque = VectorXd::Zero(n_);
      for (size_t k = s.from; k < s.to; ++k)
        torque.noalias() += hinges_[s.recording].jacobian[k].transpose() * force(s.recording, k);
      Put(static_cast<Eigen::Index>(i), torque / static_cast<double>(s.to - s.from), &out);
    }
    return out;
  }

  void WithoutMassAtRest(Eigen::Ref<VectorXd> column) const { column -= at_rest_ * at_rest_.dot(column); }

  void MakeLaws(const FeatureSet& laws) {
    const auto S = static_cast<Eigen::Index>(segments_.size());
    const FreeForce any{{0}, VectorXd::Ones(n_)};
    const int C = static_cast<int>(laws.block.joint.size());
    law_columns_ = MatrixXd::Zero(S, C);  // on its own joint alone
    size_t window = data_.windows.size();
    MatrixXd means;
    for (Eigen::Index i = 0; i < S; ++i) {
      const Segment& s = segments_[static_cast<size_t>(i)];
      if (s.window != window) {
        const MatrixXd on = SegmentsOf(any, data_.windows[s.window]).phi.transpose();
        means = laws.block.phi[s.window] * on * on.colwise().sum().cwiseInverse().asDiagonal();
        window = s.window;
        RG_CHECK(s.column < means.cols()) << "a missing force over other segments";
      }
      for (int c = 0; c < C; ++c)
        law_columns_(i, c) = means(c, s.column) * s.weight[laws.block.joint[static_cast<size_t>(c)]];
    }
    for (int c = 0; c < C; ++c) {
      const int joint = laws.block.joint[static_cast<size_t>(c)];
      const auto column = law_columns_.col(c);
      const double rest = column.dot(at_rest_.segment(joint * S, S)), squares = column.squaredNorm();
      Law law{c, joint, rest, {squares - rest * rest, column.dot(force_.segment(joint * S, S))}, {}};
      if (law.own.squares > kNothing * squares) laws_.push_back(std::move(law));
    }
  }

  void MakeSwings(int threads) {
    for (int start = 0; start <= 6; ++start) {
      for (const double decay : kDecays) {
        for (double length = kShortestSwing; length < kLongestSwing; length *= kNextLength)
          swings_.push_back({length, decay, start});
      }
    }
    swing_columns_.resize(force_.size(), static_cast<Eigen::Index>(swings_.size()));
    ParallelFor(threads, static_cast<int>(swings_.size()), [&](int, int i) {
      std::vector<std::vector<Vector3d>> pulls;
      for (const HingeMotion& hinge : hinges_)
        pulls.push_back(PullOf(hinge, gravity_, swings_[static_cast<size_t>(i)]));
      swing_columns_.col(i) = Torques([&](size_t r, size_t k) -> const Vector3d& { return pulls[r][k]; });
      WithoutMassAtRest(swing_columns_.col(i));
    });
    // Of joint after joint: a law is on one.
    const auto S = static_cast<Eigen::Index>(segments_.size());
    for (Law& law : laws_) {
      const Eigen::Index from = law.joint * S;
      law.with_swings = swing_columns_.middleRows(from, S).transpose() * law_columns_.col(law.feature);
    }
  }

  const FitData& data_;
  const int n_;
  const Vector3d gravity_;
  std::vector<HingeMotion> hinges_;
  std::vector<Segment> segments_;
  VectorXd force_, at_rest_;
  MatrixXd law_columns_, swing_columns_;
  std::vector<Law> laws_;
  std::vector<Swing> swings_;
};

// Axes of its link, the one first that it comes least near to along the first seconds.
std::string ClearHinges(const FitSetting& setting, const EffectSpec& rod, const Swing& swing) {
  const model::Frame frame = FrameOfMass(setting.nominal.model(), rod);
  Vector3d nearest = Vector3d::Zero();
  for (size_t r = 0; r < std::min(setting.data.fine.size(), kRodRecordings); ++r) {
    const HingeMotion hinge = MotionOfHinge(setting.nominal, frame, setting.data.fine[r], kFollowed);
    const MatrixXd way = WayOf(hinge, setting.nominal.options().gravity, swing);
    nearest = nearest.cwiseMax(way.topRows<3>().cwiseAbs().rowwise().maxCoeff());
  }
  std::string out = "xyz";
  std::ranges::stable_sort(out, {}, [&](char axis) { return nearest[axis - 'x']; });
  return out;
}

}  // namespace

std::vector<RodStart> ScreenRods(const FitSetting& setting, const MissingForce& missing,
                                 const FeatureSet& laws, int threads, double* work) {
  std::vector<std::pair<RodRegression::Hit, EffectSpec>> found;
  EffectSpec hung = effects::MakeSpec(effects::SwingingMass().id, {},
                                      {{"mass", 1.0}, {"length", 0.1}, {"radius", 0.0}, {"damping", 0.0}});
  hung.options["form"] = "rod";
  for (const EffectSpec& place : EitherPlace(setting.data, setting.nominal, hung)) {
    const RodRegression regression(setting, missing, laws, FrameOfMass(setting.nominal.model(), place),
                                   threads);
    if (work != nullptr) *work += regression.Work();
    const double least = regression.LeftByLaws();
    for (const RodRegression::Hit& hit : regression.Hits()) {
      if (!(hit.left < kMostLeftByRod * least && hit.left < least - kClearGain)) break;
      found.push_back({hit, place});
      found.back().first.left /= least;
    }
  }
  std::ranges::stable_sort(found, {}, [](const auto& f) { return f.first.left; });
  std::vector<RodStart> out;
  std::vector<double> lengths;
  for (const auto& [hit, place] : found) {
    const double length = hit.swing.length;
    const bool known = std::ranges::any_of(
        lengths, [&](double other) { return std::max(length / other, other / length) < kOtherLength; });
    if (known || lengths.size() == kMostLengths) continue;
    lengths.push_back(length);
    RodStart start{
        RodThatSwingsLike(length, hit.mass * length, std::max(kStartDecay, hit.swing.decay), place),
        hit.swing,
        hit.left,
        {}};
    if (hit.law >= 0) start.beside = laws.features[static_cast<size_t>(hit.law)];
    for (const char hinge : ClearHinges(setting, start.rod, hit.swing)) {
      start.rod.options["hinge"] = std::string(1, hinge);
      out.push_back(start);
    }
  }
  return out;
}

void PutSwing(const FitSetting& setting, const RodStart& start, NodeStates* states) {
  const FitData& data = setting.data;
  const model::Frame frame = FrameOfMass(setting.nominal.model(), start.rod);
  const Eigen::Index a = start.rod.options.at("hinge")[0] - 'x', b = (a + 1) % 3, c = (a + 2) % 3;
  std::vector<HingeMotion> hinges;
  std::vector<MatrixXd> ways;
  for (const FineMotion& fine : data.fine) {
    hinges.push_back(MotionOfHinge(setting.nominal, frame, fine, kPut));
    ways.push_back(WayOf(hinges.back(), setting.nominal.options().gravity, start.swing));
  }
  for (size_t w = 0; w < data.windows.size(); ++w) {
    const NodeWindow& window = data.windows[w];
    const auto r = static_cast<size_t>(window.recording);
    if (!(hinges[r].StepsTo(window.t.back()) < static_cast<double>(ways[r].cols() - 1))) continue;
    for (size_t k = 0; k < window.t.size(); ++k) {
      const double steps = hinges[r].StepsTo(window.t[k]);
      const auto at = static_cast<Eigen::Index>(steps);
      const double part = steps - static_cast<double>(at);
      const VectorXd way = (1 - part) * ways[r].col(at) + part * ways[r].col(at + 1);
      const Vector3d u = way.head<3>(), du = way.tail<3>();
      // u = (−sin φ₂, sin φ₁ cos φ₂, −cos φ₁ cos φ₂) along the axes a, b, c.
      const double clear = std::max(1e-6, u[b] * u[b] + u[c] * u[c]);
      Eigen::Vector4d swing(std::atan2(u[b], -u[c]), (u[b] * du[c] - du[b] * u[c]) / clear,
                            std::asin(std::clamp(-u[a], -1.0, 1.0)), -du[a] / std::sqrt(clear));
      auto node = (*states)[w].col(static_cast<Eigen::Index>(k));
      // Of angles that are the same, the nearest to the one before.
      if (k > 0) {
        const double before = (*states)[w](node.size() - 4, static_cast<Eigen::Index>(k) - 1);
        swing[0] += 2 * M_PI * std::round((before - swing[0]) / (2 * M_PI));
      }
      node.tail<4>() = swing;
    }
  }
}

}  // namespace rg::diagnosis
