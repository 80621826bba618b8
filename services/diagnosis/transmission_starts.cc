#include "services/diagnosis/transmission_starts.h"

#include <algorithm>
#include <cmath>

#include "common/model/robot_model.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using effects::MakeSpec;
using Eigen::VectorXd;

namespace {

constexpr double kSpan = 0.05;        // s, over which what is left is averaged
constexpr int kSubSteps = 4;          // of the fine grid
constexpr double kFastest = 60.0;     // Hz, of a resonance that the sub-steps follow
constexpr int kRounds = 12;           // of refinement
constexpr double kFirstFactor = 1.5;  // by which a value is changed at first
constexpr double kLastFactor = 1.02;  // and at last
constexpr size_t kStarts = 2;         // for either place of the sensor

double Ratio(double a, double b) { return a > b ? a / b : b / a; }

}  // namespace

TransmissionRecord::TransmissionRecord(const FitData& data, const Candidate& from, const MotionScales& scales,
                                       int joint)
    : name_(from.plant->joint_names()[static_cast<size_t>(joint)]),
      inertia_(scales.inertia[joint]),
      range_(scales.high[joint] - scales.low[joint]) {
  const VectorXd values =
      from.fit.values.size() > 0 ? from.fit.values : VectorXd(from.plant->parameters().Nominal());
  const dynamics::Mechanism mechanism = sysid::MechanismOf(*from.plant, values);
  const int damping_at = from.plant->parameters().Find("damping." + name_);
  const double damping = damping_at >= 0 ? values[damping_at] : 0.0;
  dynamics::Workspace workspace;
  VectorXd tau(data.n);
  Eigen::MatrixXd M(data.n, data.n);
  for (const FineMotion& m : data.fine) {
    const auto F = static_cast<long>(m.t.size());
    Side side;
    side.dt = m.t[1] - m.t[0];
    side.u = m.u.row(joint), side.q = m.q.row(joint), side.v = m.v.row(joint), side.a = m.a.row(joint);
    side.torque.resize(F), side.inertia.resize(F);
    for (long k = 0; k < F; ++k) {
      dynamics::Rnea(mechanism, workspace, m.q.col(k), m.v.col(k), m.a.col(k), tau);
      dynamics::Crba(mechanism, workspace, m.q.col(k), M);
      side.torque[k] = tau[joint] + damping * side.v[k];
      side.inertia[k] = M(joint, joint);
    }
    if (side.torque.allFinite() && side.u.allFinite()) sides_.push_back(std::move(side));
  }
}

// Of one recording. On the motor side J is still open: aa and ae get the sums that it is made of.
double TransmissionRecord::LeftOf(const Side& side, const Values& p, bool on_motor, double* aa,
                                  double* ae) const {
  const double h = side.dt / kSubSteps, half = 0.5 * p.gap;
  const long span = std::max(1L, std::lround(kSpan / side.dt));
  double other = side.q[0], speed = side.v[0];  // of the side that is not measured
  double left = 0, sum = 0, sum_a = 0;
  for (long k = 0; k + 1 < side.u.size(); ++k) {
    double mean = 0;
    for (int s = 0; s < kSubSteps; ++s) {
      const double part = (s + 0.5) / kSubSteps;
      const double q = side.q[k] + part * (side.q[k + 1] - side.q[k]);
      const double v = side.v[k] + part * (side.v[k + 1] - side.v[k]);
      const double deflection = on_motor ? q - other : other - q, rate = on_motor ? v - speed : speed - v;
      double T = 0;
      if (deflection > half) {
        T = p.stiffness * (deflection - half) + p.damping * rate;
        if (p.gap > 0) T = std::max(0.0, T);
      } else if (deflection < -half) {
        T = p.stiffness * (deflection + half) + p.damping * rate;
        if (p.gap > 0) T = std::min(0.0, T);
      }
      const double force = on_motor ? (T - side.torque[k] + side.inertia[k] * side.a[k]) / side.inertia[k]
                                    : (side.u[k] - T) / p.inertia;
      speed += h * force;
      other += h * speed;
      mean += T / kSubSteps;
    }
    sum += on_motor ? side.u[k] - mean : side.torque[k] - mean;
    sum_a += side.a[k];
    if ((k + 1) % span != 0) continue;
    const double e = sum / static_cast<double>(span), a = sum_a / static_cast<double>(span);
    left += e * e;
    *aa += a * a, *ae += a * e;
    sum = sum_a = 0;
  }
  return left;
}

double TransmissionRecord::Left(Values* p, bool on_motor) const {
  double left = 0, aa = 0, ae = 0;
  for (const Side& side : sides_) left += LeftOf(side, *p, on_motor, &aa, &ae);
  if (on_motor) {
    p->inertia = std::max(0.01 * inertia_, aa > 0 ? ae / aa : 0.0);
    left += p->inertia * (p->inertia * aa - 2 * ae);
  }
  p->left = std::isfinite(left) ? left : 1e300;
  return p->left;
}

TransmissionRecord::Values TransmissionRecord::Guess(double share_of_inertia, double hertz,
                                                     double gap) const {
  Values v;
  v.inertia = share_of_inertia * inertia_;
  const double lighter = v.inertia * inertia_ / (v.inertia + inertia_), omega = 2 * M_PI * hertz;
  v.stiffness = omega * omega * lighter;
  v.damping = (gap > 0 ? 0.4 : 0.2) * std::sqrt(v.stiffness * lighter);
  v.gap = gap;
  return v;
}

TransmissionRecord::Values TransmissionRecord::Refined(Values best, bool play, bool on_motor) const {
  double factor = kFirstFactor;
  for (int round = 0; round < kRounds && factor > kLastFactor; ++round) {
    const double before = best.left;
    for (double Values::*field : {&Values::stiffness, &Values::gap, &Values::inertia, &Values::damping}) {
      if (field == &Values::gap ? !play : field == &Values::inertia && on_motor) continue;
      for (const double times : {factor, 1 / factor}) {
        Values other = best;
        other.*field *= times;
        const double lighter = other.inertia * inertia_ / (other.inertia + inertia_);
        const double fastest = 2 * M_PI * kFastest;
        if (other.stiffness > fastest * fastest * lighter) continue;
        if (Left(&other, on_motor) < best.left) best = other;
      }
    }
    if (best.left > 0.99 * before) factor = std::sqrt(factor);
  }
  return best;
}

std::vector<std::vector<EffectSpec>> TransmissionRecord::Starts(const std::string& effect) const {
  const bool play = effect == "backlash";
  std::vector<std::vector<EffectSpec>> out;
  for (const bool on_motor : {false, true}) {
    std::vector<Values> grid;
    for (const double share : {0.1, 0.25, 0.6, 1.5}) {
      if (on_motor && share != 0.6) continue;  // there the motor's inertia follows from the rest
      for (const double hertz :
           play ? std::vector<double>{15, 40} : std::vector<double>{3, 5, 8, 13, 21, 34}) {
        for (const double gap :
             play ? std::vector<double>{0.002, 0.005, 0.012, 0.03, 0.07} : std::vector<double>{0})
          grid.push_back(Guess(share, hertz, gap * range_));
      }
    }
    for (Values& v : grid) Left(&v, on_motor);
    std::sort(grid.begin(), grid.end(), [](const Values& a, const Values& b) { return a.left < b.left; });
    std::vector<Values> taken;
    for (const Values& v : grid) {
      const auto alike = [&](const Values& t) {
        return play ? Ratio(v.gap, t.gap) < 1.1 : Ratio(v.stiffness, t.stiffness) < 1.5;
      };
      if (taken.size() >= kStarts || v.left >= 1e300 || std::any_of(taken.begin(), taken.end(), alike))
        continue;
      taken.push_back(v);
    }
    for (const Values& start : taken) {
      const Values v = Refined(start, play, on_motor);
      EffectSpec spec =
          play ? MakeSpec(effect, {name_},
                          {{"gap", v.gap},
                           {"contact_stiffness", v.stiffness},
                           {"contact_damping", v.damping},
                           {"motor_inertia", v.inertia}})
               : MakeSpec(effect, {name_},
                          {{"stiffness", v.stiffness}, {"damping", v.damping}, {"motor_inertia", v.inertia}});
      spec.options["sensor"] = on_motor ? "motor" : "link";
      out.push_back({std::move(spec)});
    }
  }
  return out;
}

}  // namespace rg::diagnosis
