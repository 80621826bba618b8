#include "services/diagnosis/likelihood/swing_starts.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <optional>

#include "common/dynamics/dynamics.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"

namespace rg::diagnosis {

namespace {

constexpr Eigen::Index kEvery = 20;                       // sample of a motion, to see how its link is turned
constexpr double kShortestRod = 0.02, kLongestRod = 0.3;  // m, that a fit starts at
constexpr double kAlike = 1e-3;                           // m, of which no rod knows where it hangs
constexpr double kTurned = 1e-3;                          // rad
constexpr double kPoint = 0.01;                           // of its length, a radius of gyration that is none
// Of the length of a point that swings alike: kShorter + kWide²/kShorter is one.
constexpr double kShorter = 0.9, kWide = 0.3;
constexpr double kSwing = 0.7;  // rad
// Directions of a rod about its hinge: so many about the first axis, at three angles about the second.
constexpr int kDirections = 8;
constexpr double kAside = M_PI / 3;   // rad
constexpr double kLongestFall = 0.2;  // s, after which it may be anywhere

bool OnRod(const EffectSpec& e) { return e.options.count("form") > 0 && e.options.at("form") == "rod"; }

// Positions (n) as the robot had them.
void AlongMotions(const FitData& data, const std::function<void(const VectorXd&)>& visit) {
  for (const FineMotion& fine : data.fine) {
    for (Eigen::Index k = 0; k < fine.q.cols(); k += kEvery) visit(fine.q.col(k));
  }
}

// What hangs on one of the frames swings as it would on the other: they are turned alike, and the way from
// one to the other was the same all along the motions.
bool MovedAlike(const FitData& data, const sim::Plant& nominal, const model::Frame& a,
                const model::Frame& b) {
  const dynamics::Mechanism mechanism(nominal.model());
  dynamics::Workspace workspace;
  std::optional<Eigen::Vector3d> first;
  bool alike = true;
  AlongMotions(data, [&](const VectorXd& q) {
    const model::Pose to_a = dynamics::FramePose(mechanism, workspace, q, a);
    const model::Pose to_b = dynamics::FramePose(mechanism, workspace, q, b);
    const Eigen::Vector3d way = to_b.translation - to_a.translation;
    if (!first) first = way;
    alike = alike && (way - *first).norm() <= kAlike && (to_a.rotation - to_b.rotation).norm() <= kTurned;
  });
  return alike;
}

}  // namespace

model::Frame FrameOfMass(const model::RobotModel& model, const EffectSpec& mass) {
  const bool last_link = SwingsOnLastLink({mass});
  return *model.FindFrame(last_link ? model.link(model.joint(model.num_joints() - 1).child_link).name
                                    : model.end_effector().name);
}

bool HasPendulum(const std::vector<EffectSpec>& specs) { return std::ranges::any_of(specs, OnRod); }

bool HasMassInSprings(const std::vector<EffectSpec>& specs) {
  return std::ranges::any_of(
      specs, [](const EffectSpec& e) { return e.id == effects::SwingingMass().id && !OnRod(e); });
}

bool SwingsOnLastLink(const std::vector<EffectSpec>& specs) {
  return std::ranges::any_of(specs, [](const EffectSpec& e) {
    const auto point = e.options.find("point");
    return e.id == effects::SwingingMass().id && point != e.options.end() && point->second == "last_link";
  });
}

void WidenPoint(const sim::Plant& plant, VectorXd* values) {
  const auto of = [&](const char* field) -> double& {
    return (*values)[plant.parameters().Find(effects::SwingingMass().id + ".*." + field)];
  };
  if (!HasPendulum(plant.effects()) || of("radius") > kPoint * of("length")) return;
  // m·L stays, and L + r²/L.
  of("radius") = kWide * of("length");
  of("mass") /= kShorter;
  of("length") *= kShorter;
}

EffectSpec LongerRod(EffectSpec rod, double times) {
  auto& values = rod.values.begin()->second;
  values.at("length") *= times, values.at("radius") *= times;
  return rod;
}

std::vector<EffectSpec> EitherPlace(const FitData& data, const sim::Plant& nominal, const EffectSpec& rod) {
  EffectSpec other = rod;
  other.options["point"] = SwingsOnLastLink({rod}) ? "end_effector" : "last_link";
  if (MovedAlike(data, nominal, FrameOfMass(nominal.model(), rod), FrameOfMass(nominal.model(), other)))
    return {rod};
  return {rod, other};
}

VectorXd HangingFrom(const sim::Simulator& simulator, const VectorXd& start) {
  const Eigen::Index n = simulator.plant().num_joints();
  VectorXd still = start;
  // Angle and rate about the first axis of the hinge, then about the second.
  still.tail<4>() = simulator.MakeState(start.head(n), start.segment(n, n)).z.tail<4>();
  return still;
}

std::vector<VectorXd> SwingsFrom(const sim::Simulator& simulator, const VectorXd& start) {
  const sim::Plant& plant = simulator.plant();
  if (!HasPendulum(plant.effects())) return {};
  const VectorXd still = HangingFrom(simulator, start);
  const auto of = [&](const char* field) {
    return simulator.parameters()[plant.parameters().Find(effects::SwingingMass().id + ".*." + field)];
  };
  const double length = of("length") + of("radius") * of("radius") / of("length");
  const double rate = kSwing * std::sqrt(plant.options().gravity.norm() / length);
  std::vector<VectorXd> out = {still};
  for (const Eigen::Index angle : {4, 2}) {
    for (const double side : {1.0, -1.0}) {
      out.push_back(still), out.back()[still.size() - angle] += side * kSwing;
      out.push_back(still), out.back()[still.size() - angle + 1] += side * rate;
    }
  }
  return out;
}

std::vector<VectorXd> LetGo(const FitData& data, sim::Simulator& simulator, const NodeWindow& window,
                            const VectorXd& start) {
  std::vector<VectorXd> out;
  const auto r = static_cast<size_t>(window.recording);
  const double begin = data.recordings[r].recording->t[0], to = window.t.front();
  if (!HasPendulum(simulator.plant().effects()) || to - begin > kLongestFall) return out;
  VectorXd q, v, a;
  data.motions[r].At(begin, &q, &v, &a);
  sim::State x = simulator.MakeState(q, v, begin, data.recordings[r].command);
  for (const double second : {0.0, kAside, -kAside}) {
    for (int i = 0; i < kDirections; ++i) {
      x.z.tail<4>() << 2 * M_PI * i / kDirections, 0.0, second, 0.0;
      const sim::Trajectory fall = simulator.Simulate(x, data.recordings[r].command, {to});
      if (!fall.outcome.ok() || !fall.state.allFinite()) continue;
      out.push_back(start);
      out.back().tail<4>() = fall.state.col(0).tail<4>();
    }
  }
  return out;
}

double RowsPerWindow(const FitData& data) { return data.Rows() / static_cast<double>(data.windows.size()); }

double TypicalChi2(const FitData& data, const std::vector<double>& window_chi2, double noise_scale,
                   double share) {
  if (window_chi2.empty()) return std::numeric_limits<double>::infinity();
  std::vector<double> sorted = window_chi2;
  std::ranges::sort(sorted);
  sorted.resize(std::max<size_t>(1, static_cast<size_t>(share * static_cast<double>(sorted.size()))));
  return std::accumulate(sorted.begin(), sorted.end(), 0.0) /
         (RowsPerWindow(data) * static_cast<double>(sorted.size()) * noise_scale);
}

EffectSpec RodThatSwingsLike(double length, double moment, double decay, EffectSpec place) {
  // A body that is not small swings with L + r²/L, and from r = 0 no fit leads away.
  const double mass = moment / (kShorter * length);
  place.values = effects::MakeSpec(place.id, {},
                                   {{"mass", mass},
                                    {"length", kShorter * length},
                                    {"radius", kWide * length},
                                    {"damping", decay * mass / kShorter}})
                     .values;
  place.options["form"] = "rod";
  return place;
}

std::vector<EffectSpec> AboutEachAxis(const FitData& data, const sim::Plant& nominal, EffectSpec rod) {
  const model::Frame frame = FrameOfMass(nominal.model(), rod);
  const dynamics::Mechanism mechanism(nominal.model());
  dynamics::Workspace workspace;
  const Eigen::Vector3d gravity = nominal.options().gravity;
  Eigen::Vector3d along = Eigen::Vector3d::Zero();
  AlongMotions(data, [&](const VectorXd& q) {
    const model::Pose pose = dynamics::FramePose(mechanism, workspace, q, frame);
    along += (pose.rotation.transpose() * gravity).cwiseAbs2();
  });
  std::array<int, 3> axes = {0, 1, 2};
  std::ranges::stable_sort(axes, [&](int a, int b) { return along[a] < along[b]; });
  std::vector<EffectSpec> out;
  for (const int axis : axes) {
    rod.options["hinge"] = std::string(1, "xyz"[axis]);
    out.push_back(rod);
  }
  return out;
}

std::vector<EffectSpec> RodStarts(const FitData& data, const sim::Plant& nominal, const EffectSpec& springs) {
  const auto& of = springs.values.begin()->second;
  // Springs that take in what else is missing say metres: no tool carries that.
  const double gravity = nominal.options().gravity.norm();
  const double length = std::clamp(of.at("mass") * gravity / of.at("stiffness"), kShortestRod, kLongestRod);
  EffectSpec rod = RodThatSwingsLike(length, kShorter * length * of.at("mass"), 0, springs);
  rod.values.begin()->second["damping"] = of.at("damping");
  return AboutEachAxis(data, nominal, rod);
}

}  // namespace rg::diagnosis
