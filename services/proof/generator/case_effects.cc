// The effects of a case that asks for some: how strong they are, and whether they show.
#include <algorithm>
#include <cmath>

#include "services/proof/generator/bodies.h"
#include "services/proof/generator/case_maker.h"
#include "services/proof/generator/hypotheses.h"

namespace rg::proof {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

namespace {

constexpr double kNear = 1.05;  // strengths that need no telling apart

// Joints that several effects act on.
std::set<std::string> SharedJoints(const json& effects) {
  std::set<std::string> once, shared;
  for (const json& effect : effects)
    for (const json& joint : effect["joints"])
      if (!once.insert(joint.get<std::string>()).second) shared.insert(joint.get<std::string>());
  return shared;
}

}  // namespace

Truth CaseMaker::Draw(double strength, bool wrong_parameters, json* effects, int without) const {
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

Motion CaseMaker::TuningMotion(const Truth& truth) const {
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
Status CaseMaker::TuneNominal(const Truth& truth, json* effects) {
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

double CaseMaker::Ratio(const Truth& truth) const {
  const Track track = Record(truth, "chirp", 5.0, 70, true);
  if (!track.ok) return 1e9;
  WindowSquares squares;
  Compared().Add(truth, track, {{nominal_, Nominal(), Start::kRow}}, &squares);
  return Rms(squares.rivals[0]) / std::max(1e-12, Rms(squares.oracle));
}

// Makes the effect as strong as was asked, by bisection on the logarithm of the strength; a URDF that is
// wrong beside it does not count for that.
Result<Truth> CaseMaker::SearchStrength(json* effects, std::string* warning) {
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
Visibility CaseMaker::VisibilityOf(const Truth& truth) const {
  double fit_s = 0;
  for (const PlannedRecording& r : DrawPlan(rng_.Split(4))) fit_s += r.split == "fit" ? r.duration_s : 0.0;
  return {Compared(), joints_, links_, scales_.tool, SensorNoise(), fit_s, ToFit(truth, 0)};
}

// Of each effect whether the answer must tell it from other masses: it may look like them, and they are wrong
// too. Where the URDF is right an effect explains with few numbers what takes them many.
std::vector<bool> CaseMaker::ToTellFromBodies(const Truth& truth, json effects) const {
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

// A limit that is never reached and a gap that looks like a rotor's inertia are not there to be named: every
// effect of several must show, on every joint that stays, by what makes it more than a simpler one.
Status CaseMaker::KeepVisible(Truth* truth, json* effects) const {
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

}  // namespace rg::proof
