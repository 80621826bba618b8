// The effects of a case of an ordinary robot, whose drives lose something and all of which show.
#include <algorithm>
#include <cmath>

#include "services/proof/generator/bodies.h"
#include "services/proof/generator/case_maker.h"
#include "services/proof/generator/hypotheses.h"
#include "services/proof/generator/siblings.h"
#include "services/proof/generator/urdf_text.h"

namespace rg::proof {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

// Doubles what does not show of an effect on a joint, where it is not seen without it.
Status CaseMaker::ShowGears(Truth* truth) const {
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
Status CaseMaker::AddOneThingMore(Truth* truth, json* effects) {
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
Status CaseMaker::KeepOrdinaryVisible(const Truth& truth, json* effects) const {
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
Status CaseMaker::Declare(const Truth& truth) {
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

Status CaseMaker::MakeOrdinary(Truth* truth, json* effects) {
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

}  // namespace rg::proof
