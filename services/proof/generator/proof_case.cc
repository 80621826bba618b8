#include "services/proof/generator/proof_case.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Joint.hpp>
#include <dart/dynamics/PrismaticJoint.hpp>
#include <dart/dynamics/RevoluteJoint.hpp>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "services/proof/generator/bodies.h"
#include "services/proof/generator/comparison.h"
#include "services/proof/generator/engine.h"
#include "services/proof/generator/equivalents.h"
#include "services/proof/generator/hypotheses.h"
#include "services/proof/generator/ordinary.h"
#include "services/proof/generator/references.h"
#include "services/proof/generator/robots.h"
#include "services/proof/generator/set_files.h"
#include "services/proof/generator/tuning.h"
#include "services/proof/generator/urdf_text.h"
#include "services/proof/generator/visibility.h"

namespace rg::proof {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

constexpr int kAttempts = 6;
constexpr double kApart = 1e-9;  // of a joint's own inertia, that couples it to none
constexpr double kNear = 1.05;   // strengths that need no telling apart
// An ordinary robot's error without one of its effects, over that with all.
constexpr double kPartShows = 1.3;

// Everything a case is made from.
class Maker {
 public:
  Maker(const CaseRequest& request, uint64_t seed) : request_(request), rng_(seed) {}

  Result<CaseSummary> Run(const std::string& sets_folder, const std::string& labels_folder);

 private:
  Status LoadRobot();
  VectorXd Gravity(const VectorXd& q) const;  // and leaves the skeleton at rest in q
  MatrixXd Select(const MatrixXd& full) const;
  double GravityGrowth(const VectorXd& q) const;
  VectorXd CalmHome(Rng rng) const;
  void ChooseMotion();
  Truth Nominal() const { return Truth{std::vector<JointTruth>(joints_.size())}; }
  Track Record(const Truth& truth, const std::string& kind, double duration, uint64_t stream,
               bool regular) const;
  Status MeasureScales(const Truth& truth);
  // `without`: leaves out the effect of this index.
  Truth Draw(double strength, bool wrong_parameters, json* effects, int without = -1) const;
  Motion TuningMotion(const Truth& truth) const;
  Status TuneNominal(const Truth& truth, json* effects);
  double SensorNoise() const {  // of positions, rad or m
    return std::sqrt(noise_.position * noise_.position + noise_.resolution * noise_.resolution / 12);
  }
  Comparison Compared() const { return {skeleton_, joints_, dt_, request_.rate_hz}; }
  // The robot as it is recorded to fit, first or second: what does not show there is not there to be named.
  Track ToFit(const Truth& truth, size_t which) const {
    const PlannedRecording planned = DrawPlan(rng_.Split(4))[which];
    return Record(truth, planned.kind, planned.duration_s, which, true);
  }
  Visibility VisibilityOf(const Truth& truth) const;
  std::vector<bool> ToTellFromBodies(const Truth& truth, json effects) const;
  Status KeepVisible(Truth* truth, json* effects) const;
  double Ratio(const Truth& truth) const;
  Result<Truth> SearchStrength(json* effects, std::string* warning);
  std::set<std::string> JointsApart() const;
  RobotFacts Facts(const Truth& truth) const;
  VectorXd Controller(const VectorXd& q, const VectorXd& v, const VectorXd& q_ref,
                      const VectorXd& v_ref) const;

  // One effect of an ordinary robot and the robot without it.
  struct Part {
    std::string id;
    Truth without;
  };
  Status MakeOrdinary(Truth* truth, json* effects);
  Status ShowGears(Truth* truth) const;
  Status AddOneThingMore(Truth* truth, json* effects);
  Status KeepOrdinaryVisible(const Truth& truth, json* effects) const;
  Status Declare(const Truth& truth);

  CaseRequest request_;
  Rng rng_;
  std::string original_urdf_, urdf_;                // of the robot without its effects; as handed out
  dart::dynamics::SkeletonPtr skeleton_, nominal_;  // the robot without its effects; as handed out
  std::vector<std::string> joints_, links_;
  std::vector<Eigen::Index> at_;  // skeleton index of joint i
  ReferenceLimits limits_;
  VectorXd effort_;
  Truth servo_;              // what the controller knows of the gears; no joint: nothing
  double compensated_ = 0;   // share of their friction that it feeds forward
  std::vector<Part> parts_;  // of an ordinary robot
  Truth declared_;           // what the set declares beyond its URDF; no joint: nothing
  std::string model_;        // of the set's model.json
  Scales scales_;
  SetStyle style_;
  Noise noise_{};
  double dt_ = 2e-4, wn_ = 8, strength_ = 1;
};

Status Maker::LoadRobot() {
  original_urdf_ = request_.urdf;
  if (original_urdf_.empty()) {
    RG_ASSIGN_OR_RETURN(original_urdf_, DrawRobot(request_.kind, request_.robots, rng_.Split(2)));
  }
  RG_ASSIGN_OR_RETURN(skeleton_, ParseBodies(original_urdf_));
  if (request_.ordinary) {  // whose damping is part of what it is about
    for (size_t i = 0; i < skeleton_->getNumJoints(); ++i) {
      const auto* joint = skeleton_->getJoint(i);
      if (joint->getNumDofs() == 1) original_urdf_ = WithLosses(original_urdf_, joint->getName(), 0, 0);
    }
    RG_ASSIGN_OR_RETURN(skeleton_, ParseBodies(original_urdf_));
  }
  urdf_ = original_urdf_;
  nominal_ = skeleton_;
  for (size_t i = 0; i < skeleton_->getNumJoints(); ++i) {
    auto* joint = skeleton_->getJoint(i);
    if (joint->getNumDofs() != 1) continue;
    joints_.push_back(joint->getName());
    links_.push_back(joint->getChildBodyNode()->getName());
    at_.push_back(static_cast<Eigen::Index>(joint->getDof(0)->getIndexInSkeleton()));
    scales_.prismatic.push_back(joint->getType() == dart::dynamics::PrismaticJoint::getStaticType());
  }
  return joints_.empty() ? InvalidError(request_.kind + ": no movable joint") : Status::Ok();
}

// How fast a small deviation grows under gravity at constant torque, 1/s; 0: stable.
double Maker::GravityGrowth(const VectorXd& q) const {
  const int n = static_cast<int>(joints_.size());
  MatrixXd stiffness(n, n);
  for (int i = 0; i < n; ++i) {
    VectorXd up = q, down = q;
    up[i] += 1e-4, down[i] -= 1e-4;
    stiffness.col(i) = (Gravity(up) - Gravity(down)) / 2e-4;
  }
  Gravity(q);
  const VectorXd eigenvalues =
      -(Select(skeleton_->getMassMatrix()).llt().solve(stiffness)).eigenvalues().real();
  return std::sqrt(std::max(0.0, eigenvalues.maxCoeff()));
}

// A pose round which the arm hangs calmly, so that a second of open-loop prediction says something
// about the model and not only about the noise of the restart.
VectorXd Maker::CalmHome(Rng rng) const {
  const int n = static_cast<int>(joints_.size());
  VectorXd best;
  double best_growth = 1e9;
  for (int attempt = 0; attempt < 3000; ++attempt) {
    VectorXd q(n);
    for (int i = 0; i < n; ++i) {
      const auto* dof = skeleton_->getJoint(joints_[static_cast<size_t>(i)])->getDof(0);
      const double low = std::max(-3.1, dof->getPositionLowerLimit()),
                   high = std::min(6.2, dof->getPositionUpperLimit());
      const double margin = std::min(0.6, 0.3 * (high - low));
      q[i] = rng.Uniform(low + margin, high - margin);
    }
    double growth = GravityGrowth(q);
    for (int i = 0; i < n && growth < best_growth; ++i) {
      for (const double side : {-0.45, 0.45}) {
        VectorXd beside = q;
        beside[i] += side;
        growth = std::max(growth, GravityGrowth(beside));
      }
    }
    if (growth < best_growth) best = q, best_growth = growth;
  }
  return best;
}

void Maker::ChooseMotion() {
  const int n = static_cast<int>(joints_.size());
  limits_.home = limits_.amplitude = limits_.velocity = effort_ = VectorXd::Zero(n);
  Rng rng = rng_.Split(1);
  const VectorXd home = CalmHome(rng.Split(0));
  for (int i = 0; i < n; ++i) {
    const auto* dof = skeleton_->getJoint(joints_[static_cast<size_t>(i)])->getDof(0);
    const double low = std::max(-10.0, dof->getPositionLowerLimit()),
                 high = std::min(10.0, dof->getPositionUpperLimit());
    const bool bounded = high - low < 12.0;
    limits_.home[i] = home[i];
    const double room = bounded ? std::min(home[i] - low, high - home[i]) : 3.0;
    const double reach = scales_.prismatic[static_cast<size_t>(i)] ? 0.25 : n > 2 ? 0.45 : 0.9;
    limits_.amplitude[i] = std::min(room, reach) * rng.Uniform(0.7, 1.0);
    // Arms of one or two joints may swing fast, as far as their speed limit lets them.
    limits_.velocity[i] = std::min(n > 2 ? 1.2 : 5.0, dof->getVelocityUpperLimit());
    effort_[i] = dof->getForceUpperLimit();
  }
  dt_ = n > 2 ? 2e-4 : 1e-4;
  style_ = DrawStyle(request_.rate_hz, request_.with_velocity, rng_.Split(3));
  const double control_hz = request_.rate_hz / style_.rows_per_command;
  wn_ = control_hz < 40 ? 5 : control_hz < 150 ? 7.5 : 9;
  noise_ = {rng.Uniform(2e-4, 8e-4), rng.Uniform(3e-3, 1e-2), rng.Uniform(1e-4, 4e-4)};
  if (rng.Uniform() < 0.15) noise_.position = 1e-4, noise_.resolution = rng.Uniform(8e-4, 1.5e-3);
  // A linear axis is measured more finely in metres than an arm in radians.
  const auto linear = std::count(scales_.prismatic.begin(), scales_.prismatic.end(), true);
  const double finer = linear == n ? 0.15 : linear > 0 ? 0.4 : 1.0;
  noise_.position *= finer, noise_.velocity *= finer, noise_.resolution *= finer;
}

VectorXd Maker::Gravity(const VectorXd& q) const {
  VectorXd full = VectorXd::Zero(static_cast<Eigen::Index>(skeleton_->getNumDofs()));
  for (size_t i = 0; i < joints_.size(); ++i) full[at_[i]] = q[static_cast<Eigen::Index>(i)];
  skeleton_->setPositions(full);
  skeleton_->setVelocities(VectorXd::Zero(full.size()));
  return skeleton_->getGravityForces()(at_);
}

MatrixXd Maker::Select(const MatrixXd& full) const { return full(at_, at_); }

VectorXd Maker::Controller(const VectorXd& q, const VectorXd& v, const VectorXd& q_ref,
                           const VectorXd& v_ref) const {
  const VectorXd gravity = Gravity(q);
  const VectorXd wish = wn_ * wn_ * (q_ref - q) + 2 * 0.8 * wn_ * (v_ref - v);
  VectorXd torque = Select(skeleton_->getMassMatrix()) * wish + gravity;
  constexpr double kSlow = 0.05;  // rad/s or m/s, at which dry friction is not fed forward with a jump
  for (size_t i = 0; i < servo_.joint.size(); ++i) {
    const JointTruth& j = servo_.joint[i];
    const auto at = static_cast<Eigen::Index>(i);
    const double dry = 0.5 * (j.dry.coulomb_positive + j.dry.coulomb_negative);
    torque[at] +=
        j.armature * wish[at] + compensated_ * (j.viscous * v_ref[at] + dry * std::tanh(v_ref[at] / kSlow));
  }
  return torque.cwiseMax(-effort_).cwiseMin(effort_);
}

Track Maker::Record(const Truth& truth, const std::string& kind, double duration, uint64_t stream,
                    bool regular) const {
  const int n = static_cast<int>(joints_.size());
  Rng rng = rng_.Split(100 + stream);
  const Reference reference = MakeReference(kind, limits_, duration, request_.rate_hz, rng.Split(0));
  const RowPlan plan = PlanRows(style_, regular, duration, request_.rate_hz, dt_, rng.Split(1));
  const auto rows = static_cast<Eigen::Index>(std::count(plan.written.begin(), plan.written.end(), true));
  Track track{VectorXd(rows),    MatrixXd(n, rows), MatrixXd(n, rows),
              MatrixXd(n, rows), MatrixXd(n, rows), MatrixXd(n, rows)};
  Engine engine(skeleton_, joints_, truth, dt_);
  const VectorXd zero = VectorXd::Zero(n);
  VectorXd q(n), v(n), u = Controller(reference.q.col(0), zero, reference.q.col(0), zero);
  engine.Reset(reference.q.col(0), zero, u, 0.0);
  long fine = 0;
  Eigen::Index row = 0;
  for (size_t k = 0; k < plan.time.size(); ++k) {
    const VectorXd true_q = engine.SensedPosition(), true_v = engine.SensedVelocity();
    for (int i = 0; i < n; ++i) {
      const double noisy = true_q[i] + noise_.position * rng.Normal();
      q[i] = std::round(noisy / noise_.resolution) * noise_.resolution;
      v[i] = true_v[i] + noise_.velocity * rng.Normal();
    }
    if (plan.commands[k]) {
      const double at =
          std::min(plan.time[k] * request_.rate_hz, static_cast<double>(reference.q.cols() - 1));
      const auto low = static_cast<Eigen::Index>(at);
      const Eigen::Index high = std::min(low + 1, reference.q.cols() - 1);
      const double part = at - static_cast<double>(low);
      u = Controller(q, v, (1 - part) * reference.q.col(low) + part * reference.q.col(high),
                     (1 - part) * reference.v.col(low) + part * reference.v.col(high));
      for (int i = 0; i < n; ++i) u[i] = std::round(u[i] * 1e6) * 1e-6;  // as the file has it
    }
    if (plan.written[k]) {
      track.t[row] = plan.time[k];
      track.q.col(row) = q, track.v.col(row) = v, track.u.col(row) = u;
      track.true_q.col(row) = true_q, track.true_v.col(row) = true_v;
      ++row;
    }
    if (k + 1 == plan.time.size()) break;
    for (const long end = std::lround(plan.time[k + 1] / dt_); fine < end; ++fine) engine.Step(u);
    if (!engine.finite() || BeyondStops(skeleton_, joints_, limits_.home, true_q, true_v)) {
      track.ok = false;
      return track;
    }
  }
  return track;
}

Status Maker::MeasureScales(const Truth& truth) {
  const int n = static_cast<int>(joints_.size());
  const Track track = Record(truth, "multisine", 7.0, 50, true);
  if (!track.ok) return InternalError("the robot ran away");
  scales_.joints = joints_;
  scales_.links = links_;
  scales_.home = limits_.home;
  scales_.amplitude = limits_.amplitude;
  const double rows = static_cast<double>(track.u.cols());
  scales_.torque = (track.u.rowwise().squaredNorm() / rows).cwiseSqrt();
  scales_.peak_torque = track.u.cwiseAbs().rowwise().maxCoeff();
  scales_.velocity = (track.true_v.rowwise().squaredNorm() / rows).cwiseSqrt();
  const Eigen::Vector3d tool = ToolOffset(skeleton_, joints_.back());
  scales_.tool = {tool[0], tool[1], tool[2]};
  MatrixXd motion(n, track.u.cols());
  scales_.tip_low = 1e9, scales_.tip_high = -1e9;
  for (Eigen::Index k = 0; k < track.u.cols(); ++k) {
    motion.col(k) = track.u.col(k) - Controller(track.true_q.col(k), VectorXd::Zero(n), track.true_q.col(k),
                                                VectorXd::Zero(n));
    const double tip = (skeleton_->getBodyNode(links_.back())->getTransform() * tool).z();
    scales_.tip_low = std::min(scales_.tip_low, tip);
    scales_.tip_high = std::max(scales_.tip_high, tip);
  }
  scales_.motion_torque = (motion.rowwise().squaredNorm() / rows).cwiseSqrt();
  scales_.zero_matters = VectorXd::Zero(n);
  for (int i = 0; i < n; ++i) {
    VectorXd beside = limits_.home;
    beside[i] += 0.05;
    const VectorXd here = Gravity(limits_.home);
    const MatrixXd mass = Select(skeleton_->getMassMatrix());
    const VectorXd there = Gravity(beside);
    scales_.zero_matters[i] =
        ((there - here).cwiseQuotient(scales_.torque.cwiseMax(1e-9))).cwiseAbs().maxCoeff() +
        0.5 * (Select(skeleton_->getMassMatrix()) - mass)
                  .diagonal()
                  .cwiseQuotient(mass.diagonal())
                  .cwiseAbs()
                  .maxCoeff();
  }
  Gravity(limits_.home);
  scales_.inertia = Select(skeleton_->getMassMatrix()).diagonal();
  scales_.last_mass = skeleton_->getBodyNode(links_.back())->getMass();
  scales_.duration_s = 7.0;
  return Status::Ok();
}

Truth Maker::Draw(double strength, bool wrong_parameters, json* effects, int without) const {
  Truth truth = Nominal();
  *effects = json::array();
  uint64_t stream = 10;
  for (const std::string& id : request_.effects) {
    if (id != "none" && without-- != 0)
      effects->push_back(AddEffect(id, strength, scales_, rng_.Split(stream), &truth));
    ++stream;
  }
  if (wrong_parameters)
    effects->push_back(AddEffect("parameters_only", 1.0, scales_, rng_.Split(stream), &truth));
  return truth;
}

Motion Maker::TuningMotion(const Truth& truth) const {
  Motion motion;
  uint64_t stream = 80;
  for (const char* kind : {"multisine", "p2p"}) {
    const Track track = Record(truth, kind, 6.0, stream++, true);
    if (!track.ok) return {};
    const Eigen::Index k = track.q.cols() - 1, old = motion.q.cols();
    const auto append = [&](MatrixXd* to, const MatrixXd& x) {
      to->conservativeResize(x.rows(), old + k);
      to->rightCols(k) = x;
    };
    append(&motion.q, 0.5 * (track.true_q.leftCols(k) + track.true_q.rightCols(k)));
    append(&motion.v, 0.5 * (track.true_v.leftCols(k) + track.true_v.rightCols(k)));
    append(&motion.a, request_.rate_hz * (track.true_v.rightCols(k) - track.true_v.leftCols(k)));
    append(&motion.u, track.u.leftCols(k));
  }
  return motion;
}

// Hands out a URDF that has absorbed of the effects what it can; the label says that it is wrong.
Status Maker::TuneNominal(const Truth& truth, json* effects) {
  const Motion motion = TuningMotion(truth);
  if (motion.q.size() == 0) return InternalError("the true robot ran away");
  const json& effect = effects->front();
  const TunedPart part = PartThatHides(effect["id"]);
  const std::vector<std::string> links = LinksBeside(effect["joints"], joints_, links_);
  const Tuning tuning = Tune(skeleton_, joints_, links, motion, part);
  urdf_ = WithTuning(original_urdf_, skeleton_, joints_, tuning);
  RG_ASSIGN_OR_RETURN(nominal_, ParseBodies(urdf_));
  json changes = json::object();
  for (const auto& [link, change] : tuning.links)
    changes[link] = {{"mass_factor", 1 / change.mass_factor}, {"inertia_factor", 1 / change.inertia_factor}};
  json damping = json::object();
  for (size_t i = 0; i < joints_.size(); ++i) damping[joints_[i]] = tuning.damping[i];
  effects->push_back(
      {{"id", "parameters_only"},
       {"joints", json::array()},
       {"localisation", "links"},
       {"parameters", {{"*", {{"links", {{"value", changes}}}, {"urdf_damping", {{"value", damping}}}}}}},
       {"also_acceptable", part == TunedPart::kDamping ? json{"viscous_friction"} : json::array()},
       {"equivalents", json::array()}});
  return Status::Ok();
}

double Maker::Ratio(const Truth& truth) const {
  const Track track = Record(truth, "chirp", 5.0, 70, true);
  if (!track.ok) return 1e9;
  WindowSquares squares;
  Compared().Add(truth, track, {{nominal_, Nominal(), Start::kRow}}, &squares);
  return Rms(squares.rivals[0]) / std::max(1e-12, Rms(squares.oracle));
}

// Makes the effect as strong as was asked, by bisection on the logarithm of the strength; a URDF that is
// wrong beside it does not count for that.
Result<Truth> Maker::SearchStrength(json* effects, std::string* warning) {
  const double low = request_.weak ? 1.5 : 4.0, high = request_.weak ? 2.5 : 30.0;
  auto [below, above] = StrengthsOf(request_.effects);
  double& strength = strength_ = std::max(request_.weak ? 0.25 : 1.0, below);
  bool seen = false;
  Truth truth;
  const auto finished = [&] { return request_.wrong_parameters ? Draw(strength, true, effects) : truth; };
  for (int attempt = 0; attempt < 9; ++attempt) {
    truth = Draw(strength, false, effects);
    if (request_.tuned) RG_RETURN_IF_ERROR(TuneNominal(truth, effects));
    const double ratio = Ratio(truth);
    if (ratio >= low && ratio <= high) return finished();
    seen = seen || ratio > high;
    (ratio < low ? below : above) = strength;
    if (above < kNear * below) break;
    if (attempt < 8) strength = std::sqrt(below * above);
  }
  if (request_.weak || !seen) return InternalError("no strength gives the error ratio that was asked for");
  *warning = "stronger than was asked for";
  return finished();
}

// What the questions of visibility.h are asked of, but for what other masses are found from.
Visibility Maker::VisibilityOf(const Truth& truth) const {
  double fit_s = 0;
  for (const PlannedRecording& r : DrawPlan(rng_.Split(4))) fit_s += r.split == "fit" ? r.duration_s : 0.0;
  return {Compared(), joints_, links_, scales_.tool, SensorNoise(), fit_s, ToFit(truth, 0)};
}

// Of each effect whether the answer must tell it from other masses: it may look like them, and they are wrong
// too. Where the URDF is right an effect explains with few numbers what takes them many.
std::vector<bool> Maker::ToTellFromBodies(const Truth& truth, json effects) const {
  std::vector<bool> out(request_.effects.size(), false);
  if (!request_.wrong_parameters && !request_.tuned) return out;
  AddEquivalents(Facts(truth), &effects);
  for (size_t e = 0; e < out.size(); ++e) {
    const json& same = effects[e]["equivalents"];
    out[e] = PartThatHides(request_.effects[e]) == TunedPart::kBodies &&
             std::find(same.begin(), same.end(), "parameters_only") == same.end();
  }
  return out;
}

// Joints that several effects act on.
std::set<std::string> SharedJoints(const json& effects) {
  std::set<std::string> once, shared;
  for (const json& effect : effects)
    for (const json& joint : effect["joints"])
      if (!once.insert(joint.get<std::string>()).second) shared.insert(joint.get<std::string>());
  return shared;
}

// A limit that is never reached and a gap that looks like a rotor's inertia are not there to be named: every
// effect of several must show, on every joint that stays, by what makes it more than a simpler one.
Status Maker::KeepVisible(Truth* truth, json* effects) const {
  Visibility seen = VisibilityOf(*truth);
  if (!seen.track.ok) return InternalError("the true robot ran away");
  const std::vector<bool> from_bodies = ToTellFromBodies(*truth, *effects);
  if (std::find(from_bodies.begin(), from_bodies.end(), true) != from_bodies.end())
    seen.for_bodies = {seen.track, ToFit(*truth, 1)};
  if (Hides(Facts(*truth), *effects)) return InternalError("one effect is part of what the other does");
  for (size_t e = 0; e < request_.effects.size(); ++e) {
    json ignored;
    const Truth without = Draw(strength_, request_.wrong_parameters, &ignored, static_cast<int>(e));
    if (request_.effects.size() > 1 && !seen.Shows(*truth, {without}))
      return InternalError(request_.effects[e] + " does not show beside the other effect");
    if (from_bodies[e] && seen.LooksLikeBodies(*truth, without, (*effects)[e]["joints"]))
      return InternalError(request_.effects[e] + " looks like other masses");
  }
  const std::set<std::string> shared = SharedJoints(*effects);
  bool dropped = false;
  for (size_t e = 0; e < effects->size(); ++e) {
    json& effect = (*effects)[e];
    const std::string id = effect["id"];
    if (effect["joints"].empty()) {
      if (!seen.ShowsAsMore(*truth, id, 0)) return InternalError(id + " looks like a simpler effect");
      continue;
    }
    if (!effect["parameters"].contains(effect["joints"][0].get<std::string>())) continue;
    const bool told = e < from_bodies.size() && from_bodies[e];
    if (told && dropped) {  // the robot moves otherwise since
      seen.for_bodies = {ToFit(*truth, 0), ToFit(*truth, 1)};
      dropped = false;
    }
    const std::vector<std::string> all = effect["joints"],
                                   show = seen.JointsThatShow(*truth, effect, shared, told);
    for (const std::string& name : all) {
      if (std::find(show.begin(), show.end(), name) != show.end()) continue;
      if (show.empty() || shared.count(name) > 0)
        return InternalError(id + " on " + name + " looks like a simpler effect");
      truth->joint[static_cast<size_t>(std::find(joints_.begin(), joints_.end(), name) - joints_.begin())] =
          JointTruth{};
      effect["parameters"].erase(name);
      dropped = true;
    }
    effect["joints"] = show;
  }
  return Status::Ok();
}

// By the mass matrix and gravity in some poses.
std::set<std::string> Maker::JointsApart() const {
  const auto n = static_cast<Eigen::Index>(joints_.size());
  std::set<std::string> apart(joints_.begin(), joints_.end());
  MatrixXd mass;
  VectorXd gravity;
  for (int pose = 0; pose < 3; ++pose) {
    const VectorXd here = Gravity(limits_.home + 0.3 * pose * limits_.amplitude);
    const MatrixXd now = Select(skeleton_->getMassMatrix());
    if (pose == 0) mass = now, gravity = here;
    for (Eigen::Index i = 0; i < n; ++i) {
      const double least = kApart * now(i, i), sum = now.row(i).cwiseAbs().sum();
      const bool alone = sum - now(i, i) < least && std::abs(now(i, i) - mass(i, i)) < least &&
                         std::abs(here[i] - gravity[i]) < kApart * (1 + std::abs(gravity[i]));
      if (!alone) apart.erase(joints_[static_cast<size_t>(i)]);
    }
  }
  Gravity(limits_.home);
  return apart;
}

RobotFacts Maker::Facts(const Truth& truth) const {
  RobotFacts facts;
  facts.joints = static_cast<int>(joints_.size());
  facts.first_joint = joints_.front();
  facts.linear = scales_.prismatic[0];
  for (const std::string& name : joints_) {
    if (nominal_->getJoint(name)->getDof(0)->getDampingCoefficient() > 0) facts.damped.insert(name);
  }
  facts.upright_plane = true;
  Eigen::Vector3d first = Eigen::Vector3d::Zero();
  for (size_t i = 0; i < joints_.size(); ++i) {
    const auto* joint = dynamic_cast<const dart::dynamics::RevoluteJoint*>(skeleton_->getJoint(joints_[i]));
    if (joint == nullptr) {
      facts.upright_plane = false;
      break;
    }
    const Eigen::Vector3d axis = joint->getChildBodyNode()->getTransform().linear() * joint->getAxis();
    if (i == 0) first = axis;
    facts.upright_plane = facts.upright_plane && std::abs(axis.z()) < 1e-6 && axis.cross(first).norm() < 1e-6;
  }
  if (facts.joints > 1) {
    facts.apart = JointsApart();
    return facts;
  }
  const auto inertia = [&](const dart::dynamics::SkeletonPtr& bodies) {
    VectorXd q = VectorXd::Zero(1);
    bodies->setPositions(q);
    return bodies->getMassMatrix()(0, 0);
  };
  facts.heavier =
      (inertia(TrueBodies(skeleton_, joints_, truth)) + truth.joint[0].armature) / truth.joint[0].gain >
      inertia(nominal_->cloneSkeleton("urdf"));
  return facts;
}

// Doubles what does not show of an effect on a joint, where it is not seen without it.
Status Maker::ShowGears(Truth* truth) const {
  constexpr int kDoublings = 3;
  const int n = static_cast<int>(joints_.size());
  for (int attempt = 0; attempt <= kDoublings; ++attempt) {
    const Visibility seen = VisibilityOf(*truth);
    if (!seen.track.ok) return InternalError("the true robot ran away");
    std::vector<Truth> models;
    std::vector<std::string> ids = GearEffects(*request_.ordinary);
    if (!request_.ordinary->timing.empty()) ids.pop_back();  // on all joints at once
    for (const std::string& id : ids)
      for (int i = 0; i < n; ++i) models.push_back(WithoutGear(*truth, id, i));
    const std::vector<bool> show = seen.ShowEach(*truth, models);
    if (std::find(show.begin(), show.end(), false) == show.end()) return Status::Ok();
    for (size_t k = 0; k < show.size(); ++k) {
      const auto joints = static_cast<size_t>(n);
      if (!show[k]) Strengthen(ids[k / joints], k % joints, truth);
    }
  }
  return InternalError("friction or a rotor of a joint does not show");
}

// As strong as it must be to show, and as usual where it can.
Status Maker::AddOneThingMore(Truth* truth, json* effects) {
  const std::string& id = request_.ordinary->extra;
  const Truth before = *truth;
  Rng rng = rng_.Split(32);
  const double usual = std::exp(rng.Uniform(-0.5, 0.5));
  for (const double factor : {0.6, 1.2, 2.4, 4.8}) {
    Truth with = before;
    const auto entry = AddExtra(id, factor * usual, scales_, rng.Split(0), &with);
    if (!entry) return InternalError(id + " fits no joint");
    const Visibility seen = VisibilityOf(with);
    if (!seen.track.ok) return InternalError("the true robot ran away");
    const VectorXd load = seen.track.u.cwiseAbs().rowwise().mean();
    std::vector<Truth> models = OrdinarySiblings(with, *entry, scales_, load);
    for (const json& joint : (*entry)["joints"]) {  // on each of several
      if ((*entry)["joints"].size() < 2 || !(*entry)["parameters"].contains(joint.get<std::string>()))
        continue;
      const auto at = static_cast<size_t>(std::find(joints_.begin(), joints_.end(), joint) - joints_.begin());
      models.push_back(with);
      models.back().joint[at] = before.joint[at];
    }
    models.push_back(before);
    if (!seen.Shows(with, models) || !seen.StandsOut(with, before)) continue;
    *truth = with;
    effects->push_back(*entry);
    parts_.push_back({id, before});
    return Status::Ok();
  }
  return InternalError(id + " does not show beside friction and rotors");
}

// Names that the recordings do not tell from the label's become equivalents.
Status Maker::KeepOrdinaryVisible(const Truth& truth, json* effects) const {
  const Visibility seen = VisibilityOf(truth);
  if (!seen.track.ok) return InternalError("the true robot ran away");
  const VectorXd load = seen.track.u.cwiseAbs().rowwise().mean();
  for (json& effect : *effects) {
    const std::string id = effect["id"];
    const bool law = OneOf(id, {"stribeck_friction", "asymmetric_friction"});
    if (!law && !OneOf(id, {"actuator_lag", "actuator_delay"})) continue;
    if (seen.Shows(truth, OrdinarySiblings(truth, effect, scales_, load))) continue;
    effect["equivalents"].push_back(law                    ? "coulomb_friction"
                                    : id == "actuator_lag" ? "actuator_delay"
                                                           : "actuator_lag");
  }
  return Status::Ok();
}

// Puts friction and damping into the URDF that is handed out, and what a URDF has no words for into a model
// file.
Status Maker::Declare(const Truth& truth) {
  json effects = json::array();
  for (const json& entry : GearLabels(*request_.ordinary, scales_, truth)) {
    if (!OneOf(entry["id"], {"rotor_inertia", "actuator_lag", "actuator_delay"})) continue;
    json row = {{"effect", entry["id"]}, {"joints", entry["joints"]}, {"parameters", json::object()}};
    for (const auto& [joint, figures] : entry["parameters"].items())
      for (const auto& [name, figure] : figures.items()) row["parameters"][joint][name] = figure["value"];
    effects.push_back(row);
  }
  for (size_t i = 0; i < joints_.size(); ++i)
    urdf_ = WithLosses(urdf_, joints_[i], truth.joint[i].viscous, truth.joint[i].dry.coulomb_positive);
  RG_ASSIGN_OR_RETURN(nominal_, ParseBodies(urdf_));
  declared_ = truth;
  for (JointTruth& j : declared_.joint) j.viscous = 0, j.dry = DryFriction{};
  if (effects.empty()) return Status::Ok();
  model_ = json{{"format", "realitygrad.model/1"},
                {"version", 0},
                {"robot", request_.kind},
                {"urdf", urdf_},
                {"joints", joints_},
                {"gravity", {0, 0, -9.81}},
                {"effects", effects},
                {"parameters", json::object()}}
               .dump(1);
  return Status::Ok();
}

Status Maker::MakeOrdinary(Truth* truth, json* effects) {
  const Ordinary& ordinary = *request_.ordinary;
  Rng rng = rng_.Split(30);
  *truth = Nominal(), *effects = json::array();
  SetGears(ordinary, scales_, request_.rate_hz, rng.Split(0), truth);
  servo_ = *truth;
  compensated_ = rng.Uniform(0.3, 1.0);
  RG_RETURN_IF_ERROR(ShowGears(truth));
  servo_ = *truth;
  if (request_.declared) return Declare(*truth);
  RG_RETURN_IF_ERROR(MeasureScales(*truth));
  json more = json::array();
  if (ordinary.wrong_bodies) {
    more.push_back(AddEffect("parameters_only", 1.0, scales_, rng_.Split(31), truth));
    parts_.push_back({"parameters_only", *truth});
    parts_.back().without.links.clear();
  }
  if (!ordinary.extra.empty()) RG_RETURN_IF_ERROR(AddOneThingMore(truth, &more));
  *effects = GearLabels(ordinary, scales_, *truth);
  for (Part& part : parts_)
    if (part.id == "parameters_only") part.without = *truth, part.without.links.clear();
  for (const json& effect : *effects) parts_.push_back({effect["id"], WithoutGear(*truth, effect["id"], -1)});
  for (const json& entry : more) effects->push_back(entry);
  return KeepOrdinaryVisible(*truth, effects);
}

Result<CaseSummary> Maker::Run(const std::string& sets_folder, const std::string& labels_folder) {
  RG_RETURN_IF_ERROR(LoadRobot());
  ChooseMotion();
  RG_RETURN_IF_ERROR(MeasureScales(Nominal()));
  CaseSummary summary;
  json effects;
  const bool control = request_.declared || request_.effects == std::vector<std::string>{"none"} ||
                       request_.effects == std::vector<std::string>{"parameters_only"};
  Truth truth;
  if (request_.ordinary) {
    RG_RETURN_IF_ERROR(MakeOrdinary(&truth, &effects));
  } else if (control) {
    truth = Draw(1.0, false, &effects);
  } else {
    RG_ASSIGN_OR_RETURN(truth, SearchStrength(&effects, &summary.warning));
    RG_RETURN_IF_ERROR(KeepVisible(&truth, &effects));
  }
  const std::vector<PlannedRecording> plan = DrawPlan(rng_.Split(4));
  WindowSquares squares;
  std::vector<Rival> rivals = {{nominal_, declared_.joint.empty() ? Nominal() : declared_, Start::kRow}};
  for (const Part& part : parts_) rivals.push_back({skeleton_, part.without});
  std::vector<std::pair<std::string, std::string>> files;
  int hidden = 0;
  for (size_t r = 0; r < plan.size(); ++r) {
    const bool concealed = plan[r].split == "hidden";
    const Track track = Record(truth, plan[r].kind, plan[r].duration_s, r, concealed);
    if (!track.ok) return InternalError("the true robot ran away");
    char number[16];
    std::snprintf(number, sizeof number, "_%03d.csv", concealed ? hidden++ : static_cast<int>(r));
    files.emplace_back((concealed ? labels_folder : sets_folder) + "/" + request_.name +
                           (concealed ? "/hidden" : "/rec") + number,
                       Csv(track, joints_, style_.with_velocity, concealed));
    if (concealed) Compared().Add(truth, track, rivals, &squares);
  }
  summary.nominal_rms = Rms(squares.rivals[0]), summary.oracle_rms = Rms(squares.oracle);
  summary.ratio = summary.nominal_rms / summary.oracle_rms;
  if (!control && !(summary.ratio > 1.3))
    return InternalError("the nominal model is as good as the true one");
  json without = json::object();
  for (size_t p = 0; p < parts_.size(); ++p) {
    without[parts_[p].id] = Rms(squares.rivals[p + 1]);
    if (!(without[parts_[p].id] > kPartShows * summary.oracle_rms) && parts_[p].id != "parameters_only")
      return InternalError(parts_[p].id + " does not show beside the rest");
  }
  AddEquivalents(Facts(truth), &effects);
  const json label = {{"name", request_.name},
                      {"robot", request_.kind},
                      {"stratum", request_.declared   ? "declared"
                                  : request_.ordinary ? "ordinary"
                                                      : "plain"},
                      {"rate_hz", std::lround(request_.rate_hz)},
                      {"weak", request_.weak},
                      {"tuned", request_.tuned},
                      {"rows", style_.rows == Rows::kRegular    ? "regular"
                               : style_.rows == Rows::kJittered ? "jittered"
                                                                : "missing"},
                      {"rows_per_command", style_.rows_per_command},
                      {"verdict", AcceptedVerdicts(effects)},
                      {"effects", effects},
                      {"truth_dt", dt_},
                      {"warnings", summary.warning.empty() ? json::array() : json{summary.warning}}};
  json oracle_json = {{"window_s", 1},
                      {"nominal_rms", summary.nominal_rms},
                      {"oracle_rms", summary.oracle_rms},
                      {"ratio", summary.ratio},
                      {"recordings", json::array()}};
  if (!parts_.empty()) oracle_json["rms_without"] = without;
  const std::string set = sets_folder + "/" + request_.name, sealed = labels_folder + "/" + request_.name;
  files.emplace_back(set + "/robot.urdf", urdf_);
  if (!model_.empty()) files.emplace_back(set + "/model.json", model_);
  files.emplace_back(set + "/manifest.json",
                     Manifest(style_, joints_, plan, noise_, request_.rate_hz).dump(1));
  files.emplace_back(sealed + "/oracle.json", oracle_json.dump(1));
  files.emplace_back(sealed + "/label.json", label.dump(1));
  for (const auto& [file, text] : files) RG_RETURN_IF_ERROR(WriteFileAtomically(file, text));
  return summary;
}

}  // namespace

Result<CaseSummary> MakeCase(const CaseRequest& request, const std::string& sets_folder,
                             const std::string& labels_folder) {
  std::string why;
  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    const uint64_t seed =
        attempt == 0 ? request.seed : Rng(request.seed).Split(static_cast<uint64_t>(attempt)).Next();
    auto summary = Maker(request, seed).Run(sets_folder, labels_folder);
    if (summary.ok() || summary.status().code() != StatusCode::kInternal) return summary;
    why = summary.status().message();
  }
  return InternalError(request.name + ": " + why + ", in " + std::to_string(kAttempts) + " drawings");
}

}  // namespace rg::proof
