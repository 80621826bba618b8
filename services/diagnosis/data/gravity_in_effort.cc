#include "services/diagnosis/data/gravity_in_effort.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

#include "common/dynamics/dynamics.h"
#include "services/diagnosis/data/words.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

namespace {

constexpr double kLoaded = 0.1;     // gravity's torque over that of the most loaded joint: joints considered
constexpr double kMostRotor = 3.0;  // of the joint's own inertia
constexpr double kKept = 0.9;       // share of the rows kept by the trimmed least squares
constexpr double kExplains = 0.3;   // residual over gravity's torque, at most, of the right form
constexpr double kClearly = 3.0;    // residual of the wrong form over that of the right one, at least
constexpr double kSeen = 0.7;     // residual over that of friction alone, above which motion explains nothing
constexpr double kAbsent = 0.15;  // residual of friction alone over gravity's torque, at most, in slow motion
constexpr double kNowhere = 0.8;  // share of that left by gravity of any size: it is not in the effort
constexpr double kLeastGain = 0.4, kMostGain = 2.5;
constexpr double kSure = 4.0;  // standard deviations
constexpr int kBlocks = 10;    // of rows, to estimate them by
constexpr long kLeastSamples = 50;

struct Explained {
  double gain = 0, left = 0;  // RMS of the rows kept
};

// Least squares with no coefficient below 0, over the columns in turn: few columns, so all subsets.
VectorXd NonNegative(const MatrixXd& X, const VectorXd& y) {
  const auto C = static_cast<int>(X.cols());
  const MatrixXd H = X.transpose() * X;
  const VectorXd g = X.transpose() * y;
  VectorXd best = VectorXd::Zero(C);
  double most = 0;
  for (int subset = 1; subset < (1 << C); ++subset) {
    std::vector<int> in;
    for (int c = 0; c < C; ++c) {
      if (subset & (1 << c)) in.push_back(c);
    }
    const VectorXd part = H(in, in).colPivHouseholderQr().solve(g(in));
    if (!part.allFinite() || part.minCoeff() < 0) continue;
    const double gain = part.dot(g(in));
    if (gain <= most) continue;
    most = gain, best.setZero();
    for (size_t i = 0; i < in.size(); ++i) best[in[i]] = part[i];
  }
  return best;
}

// Of one joint, by all that may be in its effort at once.
struct GravityCoefficient {
  double gain = 0;  // of the motion's torque
  double beyond_least =
      0;  // gravity's coefficient less kLeastGain times the motion's gain: below 0, gravity is not there
  double stddev = 0;
  double left_without = 0;  // of the effort, that everything but gravity leaves
};

class Weigher {
 public:
  Weigher(const MotionSurvey& survey, const sim::Plant& plant) : s_(survey) {
    const dynamics::Mechanism mechanism = sysid::MechanismOf(plant, plant.parameters().Nominal());
    dynamics::Workspace workspace;
    inertia_ = VectorXd::Zero(s_.n);
    MatrixXd M(s_.n, s_.n);
    long count = 0;
    for (const MotionSamples& m : s_.samples) {
      const auto S = static_cast<long>(m.t.size());
      for (long k = 0; k < S; k += std::max<long>(1, S / 20), ++count) {
        dynamics::Crba(mechanism, workspace, m.q.col(k), M);
        inertia_ += M.diagonal();
      }
    }
    inertia_ /= std::max<double>(1.0, static_cast<double>(count));
  }

  GravityEvidence Run() {
    GravityEvidence out;
    const long samples = s_.Samples();
    if (samples < kLeastSamples) return out;
    VectorXd weight(s_.n);
    for (int j = 0; j < s_.n; ++j)
      weight[j] =
          std::sqrt(s_.Along(&MotionSamples::gravity, j).squaredNorm() / static_cast<double>(samples));
    if (!(weight.maxCoeff() > 0)) return out;
    Sum with, without, friction, any;
    int absent = 0, present = 0;
    for (int j = 0; j < s_.n; ++j) {
      const JointFigures& f = s_.joints[j];
      if (weight[j] < kLoaded * weight.maxCoeff() || !f.moved || f.prescribed) continue;
      const VectorXd u = s_.Along(&MotionSamples::u, j);
      if (!(u.cwiseAbs().maxCoeff() > 0)) continue;
      const VectorXd whole = s_.Along(&MotionSamples::rigid, j), G = s_.Along(&MotionSamples::gravity, j);
      with.Add(Explain(j, u, whole, kLeastGain), weight[j]);
      without.Add(Explain(j, u, whole - G, kLeastGain), weight[j]);
      friction.Add(Explain(j, u, VectorXd::Zero(u.size()), 0), weight[j]);
      any.Add(Explain(j, u, whole, 0), weight[j]);
      const GravityCoefficient c = RegressGravity(j, u, whole - G, G);
      present += c.beyond_least > kSure * c.stddev;
      absent += c.beyond_least < -kSure * c.stddev && c.gain > kLeastGain && c.gain < kMostGain &&
                c.left_without < kExplains;
      out.joints.push_back(j);
    }
    if (out.joints.empty()) return out;
    out.with = with.Rms(), out.without = without.Rms();
    // Where the URDF's torques are better with gravity, however bad, they are wrong in another way.
    const bool missing = Slow(friction, any) || (absent > 0 && present == 0);
    if (Follows(without, with, friction) || (missing && out.without < out.with))
      out.side = GravitySide::kInDrive;
    if (Follows(with, without, friction)) out.side = GravitySide::kInEffort;
    return out;
  }

 private:
  // Over joints, in units of gravity's torque on each.
  struct Sum {
    std::vector<double> left;
    bool gains = true;  // that drives have
    void Add(const Explained& e, double weight) {
      left.push_back(e.left / weight), gains = gains && e.gain < kMostGain;
    }
    double Rms() const {
      double squares = 0;
      for (const double x : left) squares += x * x;
      return std::sqrt(squares / static_cast<double>(left.size()));
    }
    bool LessOnEach(const Sum& other) const { return std::ranges::equal(left, other.left, std::less{}); }
  };

  static bool Follows(const Sum& right, const Sum& wrong, const Sum& friction) {
    const double left = right.Rms();
    return right.gains && right.LessOnEach(wrong) && left < kExplains && wrong.Rms() > kClearly * left &&
           left < kSeen * friction.Rms();
  }
  static bool Slow(const Sum& friction, const Sum& any) {
    return friction.Rms() < kAbsent && any.Rms() > kNowhere * friction.Rms();
  }

  // By `torque` times `least` or more.
  Explained Explain(int j, const VectorXd& effort, const VectorXd& torque, double least) const {
    const VectorXd u = effort - least * torque;
    const VectorXd v = s_.Along(&MotionSamples::v, j), a = s_.Along(&MotionSamples::a, j);
    const double width = std::max(1e-9, 1.5 * s_.speed_noise[j]);
    MatrixXd X(u.size(), 4);
    const VectorXd rotor =
        torque.isZero(0) ? VectorXd::Zero(u.size()) : VectorXd(kMostRotor * inertia_[j] * a);
    X << torque, torque + rotor, v, (v.array() / width).tanh().matrix();
    VectorXd c;
    const std::vector<long> kept = FitMostRows(X, u, &c);
    const VectorXd left = u(kept) - X(kept, Eigen::all) * c;
    return {least + c[0] + c[1], Rms(left)};
  }

  // Regression on motion, rotor, gravity, viscous and Coulomb friction together.
  GravityCoefficient RegressGravity(int j, const VectorXd& effort, const VectorXd& motion,
                                    const VectorXd& gravity) const {
    const VectorXd v = s_.Along(&MotionSamples::v, j), a = s_.Along(&MotionSamples::a, j);
    const double width = std::max(1e-9, 1.5 * s_.speed_noise[j]);
    MatrixXd X(effort.size(), 5);
    X << motion, motion + kMostRotor * inertia_[j] * a, gravity, v, (v.array() / width).tanh().matrix();
    VectorXd c;
    const std::vector<long> kept = FitMostRows(X, effort, &c);
    const auto contrast = [](const VectorXd& c) { return c[2] - kLeastGain * (c[0] + c[1]); };
    GravityCoefficient out;
    out.gain = c[0] + c[1];
    out.beyond_least = contrast(c);
    // The spread over rows left out a block at a time: neighbours are not independent.
    const long rows = static_cast<long>(kept.size());
    VectorXd of(kBlocks);
    for (int block = 0; block < kBlocks; ++block) {
      std::vector<long> rest(kept.begin(), kept.begin() + rows * block / kBlocks);
      rest.insert(rest.end(), kept.begin() + rows * (block + 1) / kBlocks, kept.end());
      of[block] = contrast(NonNegative(X(rest, Eigen::all), effort(rest)));
    }
    out.stddev = std::sqrt((of.array() - of.mean()).square().sum() * (kBlocks - 1) / kBlocks);
    X.col(2).setZero();
    const std::vector<long> without = FitMostRows(X, effort, &c);
    out.left_without = Rms(effort(without) - X(without, Eigen::all) * c) / Rms(effort(without));
    return out;
  }

  static double Rms(const VectorXd& x) { return std::sqrt(x.squaredNorm() / static_cast<double>(x.size())); }

  // Least squares of all but the worst tenth of the rows, which are returned in their order.
  static std::vector<long> FitMostRows(const MatrixXd& X, const VectorXd& u, VectorXd* c) {
    std::vector<long> kept(static_cast<size_t>(u.size()));
    *c = NonNegative(X, u);
    for (int round = 0; round < 2; ++round) {
      const VectorXd left = (u - X * *c).cwiseAbs();
      kept.resize(static_cast<size_t>(u.size()));
      std::iota(kept.begin(), kept.end(), 0L);
      const auto end = kept.begin() + static_cast<long>(kKept * static_cast<double>(kept.size()));
      std::nth_element(kept.begin(), end, kept.end(), [&](long a, long b) { return left[a] < left[b]; });
      kept.resize(static_cast<size_t>(end - kept.begin()));
      *c = NonNegative(X(kept, Eigen::all), u(kept));
    }
    std::ranges::sort(kept);
    return kept;
  }

  const MotionSurvey& s_;
  VectorXd inertia_;  // n
};

}  // namespace

GravityEvidence WeighGravity(const MotionSurvey& survey, const sim::Plant& plant) {
  return Weigher(survey, plant).Run();
}

std::string GravityContradiction(const GravityEvidence& e, bool excludes,
                                 const std::vector<std::string>& joint_names) {
  const GravitySide said = excludes ? GravitySide::kInDrive : GravitySide::kInEffort;
  if (e.side == GravitySide::kUnclear || e.side == said) return "";
  std::vector<std::string> joints;
  for (const int j : e.joints) joints.push_back(joint_names[j]);
  const bool in_drive = e.side == GravitySide::kInDrive;
  const std::string right = Number(100 * (in_drive ? e.without : e.with)),
                    wrong = Number(100 * (in_drive ? e.with : e.without));
  if (in_drive)
    return "the efforts of " + Listed(joints) + " follow the URDF's torques without gravity (all but " +
           right + " % of gravity's torque; with gravity all but " + wrong +
           " %): if the drive compensates gravity itself, write \"effort_excludes_gravity\": true into the "
           "manifest (false goes on all the same); if the robot hangs otherwise, write its \"gravity\"";
  return "the manifest says effort_excludes_gravity, but the efforts of " + Listed(joints) +
         " carry gravity (with it the URDF's torques explain all but " + right +
         " % of gravity's torque, without it all but " + wrong +
         " %): write \"effort_excludes_gravity\": false";
}

}  // namespace rg::diagnosis
