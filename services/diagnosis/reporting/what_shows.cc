#include "services/diagnosis/reporting/what_shows.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>

#include "common/dynamics/dynamics.h"
#include "common/effects/effect_catalog.h"
#include "common/effects/torque_ripple.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/data/words.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using effects::EffectInfo;
using effects::Need;
using effects::Scope;

namespace {

// Thresholds of the needs.
constexpr double kOneWay = 0.05;      // of the travel, above which motion is in both directions
constexpr double kSpeedsApart = 1.5;  // 90 % over 10 % quantile of the speed
constexpr int kSlowRows = 5;          // rows of slow motion
constexpr double kAboveNoise = 2.0;   // times its stddev, of an acceleration
constexpr double kTravel = 0.05, kTravelPrismatic = 0.01;  // rad, m
constexpr double kChange = 0.005;        // of the joint's usual torque, that a probe must change it by
constexpr double kHardly = 1e-3;         // of the largest usual torque: less is none
constexpr double kPosture = 0.05;        // rad or m, by which a joint is moved to see
constexpr double kTilt = 0.05;           // rad
constexpr double kLastMass = 0.1;        // of the last link's mass
constexpr double kEffortChanges = 0.02;  // of its peak
constexpr double kLoadChanges = 0.1;     // of its mean
constexpr double kEitherSign = 0.02;     // of the peak, either way
constexpr double kAlike = 0.98;          // correlation of two efforts that are in proportion
constexpr double kWarmer = 0.5;          // K
constexpr double kShortest = 0.03,
                 kLongest = 4.0;       // of a recording's motion, of the time friction takes to change
constexpr double kMostRipples = 40.0;  // per turn, considered
constexpr int kProbes = 200;           // instants

// Why a need is not met (empty: it is), and for which part of the effects it is.
struct Judged {
  std::string why_not, within;
};
Judged Met(std::string within = "") { return {"", std::move(within)}; }
Judged Not(std::string why) { return {std::move(why), ""}; }
Judged MetIf(bool met, std::string why_not) { return met ? Met() : Not(std::move(why_not)); }

class EffectJudge {
 public:
  EffectJudge(const MotionSurvey& survey, const sim::Plant& plant)
      : s_(survey), plant_(plant), model_(plant.model()) {
    period_ = s_.FirstToFit().period;
    Probe();
  }

  EffectShows Of(const EffectInfo& info) const {
    EffectShows out;
    out.effect = info.id;
    std::map<std::string, std::vector<std::string>> reasons;
    std::vector<std::string> shown;
    std::map<std::string, std::vector<std::string>> within;
    for (int j = 0; j < s_.n; ++j) {
      const Judged judged = OnJoint(info, j);
      if (!judged.why_not.empty()) {
        reasons[judged.why_not].push_back(Name(j));
        continue;
      }
      shown.push_back(Name(j));
      if (!judged.within.empty()) within[judged.within].push_back(Name(j));
    }
    out.shows = !shown.empty();
    const bool of_robot = info.scope == Scope::kRobot;
    if (!of_robot) out.joints = shown;
    for (const auto& [text, joints] : within) {
      const bool all = joints.size() == shown.size() || of_robot;
      out.within += (out.within.empty() ? "" : "; ") + text + (all ? "" : " (" + Listed(joints) + ")");
    }
    // What belongs to the robot shows if any joint shows it.
    if (of_robot && out.shows) return out;
    for (auto& [reason, joints] : reasons) out.not_on.push_back({std::move(joints), reason});
    return out;
  }

 private:
  const std::string& Name(int j) const { return model_.joint(j).name; }
  const JointFigures& Figures(int j) const { return s_.joints[j]; }

  Judged OnJoint(const EffectInfo& info, int j) const {
    if (Figures(j).prescribed) return Not("moves as measured");
    if (!Figures(j).moved) return Not("never moved");
    if (info.NeedsDrive() && (plant_.IsPassive(j) || !(Figures(j).peak_effort > 0)))
      return Not("no effort drives it");
    if (info.scope == Scope::kJointPair && Others(j) == 0) return Not("no other joint moves");
    Judged out;
    for (const Need need : info.needs) {
      const Judged judged = Has(need, j);
      if (!judged.why_not.empty()) return judged;
      if (!judged.within.empty()) out.within += (out.within.empty() ? "" : ", ") + judged.within;
    }
    return out;
  }

  int Others(int j) const {
    int out = 0;
    for (int i = 0; i < s_.n; ++i) out += i != j && Figures(i).moved ? 1 : 0;
    return out;
  }

  Judged Has(Need need, int j) const {
    const JointFigures& f = Figures(j);
    const double rate = 1.0 / period_;
    const std::string apart = "rows " + Number(1e3 * period_) + " ms apart are too rare";
    switch (need) {
      case Need::kBothWays:
        return MetIf(std::min(f.up, f.down) >= kOneWay * (f.up + f.down), "moves one way only");
      case Need::kManySpeeds:
        return MetIf(f.fast >= kSpeedsApart * f.slow, "moves at one speed only (" + Number(f.fast) + ")");
      case Need::kSlowMotion:
        return MetIf(f.slow_rows >= kSlowRows, "hardly moves slowly (" + std::to_string(f.slow_rows) +
                                                   " rows below a tenth of its usual speed)");
      case Need::kDenseRows:
        return MetIf(rate >= kRateOfReversals, apart);
      case Need::kResonances:
        return rate >= kRateOfResonances ? Met("vibrations below " + Number(rate / 4) + " Hz")
                                         : Not(apart + " for vibrations");
      case Need::kAcceleration:
        return MetIf(f.acceleration >= kAboveNoise * f.acceleration_noise,
                     "its accelerations do not stand out of their noise");
      case Need::kTravel:
        return Travel(j);
      case Need::kPeriods:
        return Periods(j);
      case Need::kPosture:
        return MetIf(posture_[j] > kChange, "the torques do not change with its position");
      case Need::kTilt:
        return MetIf(tilt_[j] > kChange, "its torque does not change with the direction of gravity");
      case Need::kLastMass:
        return MetIf(last_mass_[j] > kChange, "its torque does not change with the last link's mass");
      case Need::kEffort:
        return MetIf(f.effort_stddev > kEffortChanges * f.peak_effort, "its effort hardly changes");
      case Need::kEffortSign:
        return MetIf(std::min(-f.effort_least, f.effort_most) > kEitherSign * f.peak_effort,
                     "its effort keeps its sign");
      case Need::kPeakEffort:
        return Met("limits below its peak effort");
      case Need::kLoad:
        return MetIf(f.load_stddev > kLoadChanges * f.load_mean, "its load hardly changes while it moves");
      case Need::kWarming:
        return Warming(j);
      case Need::kOtherEffort:
        return OtherEffort(j);
    }
    return Met();
  }

  Judged Travel(int j) const {
    const JointFigures& f = Figures(j);
    const bool revolute = model_.joint(j).is_revolute();
    return f.high - f.low >= (revolute ? kTravel : kTravelPrismatic)
               ? Met()
               : Not("travels by " + Number(f.high - f.low) + (revolute ? " rad" : " m") + " only");
  }

  // Ripples of which enough lies within the travel, and which pass slowly enough when it is slow.
  Judged Periods(int j) const {
    const JointFigures& f = Figures(j);
    const double least =
        std::max(2.0, effects::TorqueRipple::kLeastPeriods * 2 * M_PI / std::max(1e-9, f.high - f.low));
    const double most = std::min(kMostRipples, 2 * M_PI / (4 * period_ * std::max(1e-9, f.slow)));
    if (least > most) return Not("travels too little, or too fast for its rows, to see a ripple's periods");
    return Met("with " + Number(effects::TorqueRipple::kLeastPeriods) + " of a period or more in its travel");
  }

  Judged Warming(int j) const {
    const JointFigures& f = Figures(j);
    const double warmer = f.temperature_high - f.temperature_low;
    if (std::isfinite(warmer) && warmer < kWarmer)
      return Not("its temperature changes by " + Number(warmer) + " K only");
    double longest = 0;
    for (const JointFigures& other : s_.joints) longest = std::max(longest, other.moving_s);
    return Met("changes within " + Number(kShortest * longest) + " to " + Number(kLongest * longest) +
               " s of motion");
  }

  Judged OtherEffort(int j) const {
    for (int i = 0; i < s_.n; ++i) {
      if (i != j && Figures(i).peak_effort > 0 && std::abs(Correlation(i, j)) < kAlike) return Met();
    }
    return Not("every other joint's effort is in proportion to its own");
  }

  double Correlation(int i, int j) const {
    double x = 0, y = 0, xx = 0, yy = 0, xy = 0;
    for (const MotionSamples& m : s_.samples) {
      x += m.u.row(i).sum(), y += m.u.row(j).sum();
      xx += m.u.row(i).squaredNorm(), yy += m.u.row(j).squaredNorm(), xy += m.u.row(i).dot(m.u.row(j));
    }
    const double count = std::max(1.0, static_cast<double>(s_.Samples()));
    const double vx = xx / count - x * x / count / count, vy = yy / count - y * y / count / count;
    return vx > 0 && vy > 0 ? (xy / count - x * y / count / count) / std::sqrt(vx * vy) : 0.0;
  }

  // How much torques change, over the joint's usual one, where its position, gravity's direction or the last
  // link's mass are a little off.
  void Probe() {
    posture_ = tilt_ = last_mass_ = VectorXd::Zero(s_.n);
    const VectorXd values = plant_.parameters().Nominal();
    const dynamics::Mechanism own = sysid::MechanismOf(plant_, values);
    dynamics::Mechanism heavier = own, tilted_x = own, tilted_y = own;
    dynamics::LinkParametersMatrix links = sysid::LinkParametersOf(plant_, values);
    for (int i = 0; i < model_.num_links(); ++i) {
      if (model_.link(i).body == s_.n - 1) links(0, i) *= 1 + kLastMass;
    }
    heavier.SetLinkParameters(model_, links);
    const Eigen::Vector3d g = own.gravity();
    if (g.norm() > 0) {
      const Eigen::Vector3d side = g.unitOrthogonal() * g.norm() * kTilt;
      tilted_x.SetGravity(g + side), tilted_y.SetGravity(g + g.normalized().cross(side));
    }
    dynamics::Workspace workspace;
    VectorXd torque(s_.n);
    MatrixXd posture = MatrixXd::Zero(s_.n, s_.n);
    VectorXd tilt_x = VectorXd::Zero(s_.n), tilt_y = tilt_x, mass = tilt_x, needed = tilt_x;
    double count = 0;
    const long every = std::max<long>(1, s_.Samples() / kProbes);
    long at = 0;
    for (const MotionSamples& m : s_.samples) {
      for (Eigen::Index k = 0; k < m.q.cols(); ++k, ++at) {
        if (at % every != 0) continue;
        ++count;
        const auto change = [&](const dynamics::Mechanism& mechanism, const VectorXd& q) -> VectorXd {
          dynamics::Rnea(mechanism, workspace, q, m.v.col(k), m.a.col(k), torque);
          return (torque - m.rigid.col(k)).cwiseAbs2();
        };
        const VectorXd q = m.q.col(k);
        needed += m.rigid.col(k).cwiseAbs2();
        tilt_x += change(tilted_x, q), tilt_y += change(tilted_y, q), mass += change(heavier, q);
        for (int j = 0; j < s_.n; ++j) posture.col(j) += change(own, q + kPosture * VectorXd::Unit(s_.n, j));
      }
    }
    count = std::max(1.0, count);
    VectorXd scale = (needed / count).cwiseSqrt();
    for (int j = 0; j < s_.n; ++j) scale[j] = std::max(scale[j], Figures(j).effort_rms);
    scale = scale.cwiseMax(std::max(1e-9, kHardly * scale.maxCoeff()));
    const auto relative = [&](const VectorXd& squares) -> VectorXd {
      return (squares / count).cwiseSqrt().cwiseQuotient(scale);
    };
    for (int j = 0; j < s_.n; ++j) posture_[j] = relative(posture.col(j)).maxCoeff();
    tilt_ = relative(tilt_x).cwiseMax(relative(tilt_y));
    last_mass_ = relative(mass);
  }

  const MotionSurvey& s_;
  const sim::Plant& plant_;
  const model::RobotModel& model_;
  double period_ = 0;                    // s
  VectorXd posture_, tilt_, last_mass_;  // n
};

}  // namespace

std::vector<EffectShows> WhatShows(const MotionSurvey& survey, const sim::Plant& plant) {
  const EffectJudge judge(survey, plant);
  std::vector<EffectShows> out;
  for (const EffectInfo& info : effects::Catalog()) {
    // An unnamed force over two joints is reported as one over a joint.
    if (!(IsUnnamed(info.id) && info.scope == Scope::kJointPair)) out.push_back(judge.Of(info));
  }
  return out;
}

std::vector<std::string> InWords(const EffectShows& e, int joints) {
  const auto named = [&](const std::vector<std::string>& names) {
    return joints > 1 && static_cast<int>(names.size()) == joints ? "all joints" : Listed(names);
  };
  std::string not_on;
  for (const WhyNot& w : e.not_on) not_on += (not_on.empty() ? "" : "; ") + named(w.joints) + ": " + w.reason;
  const std::string on = !e.shows ? "–" : e.joints.empty() ? "the robot" : named(e.joints);
  return {e.effect, on, e.within, not_on};
}

}  // namespace rg::diagnosis
