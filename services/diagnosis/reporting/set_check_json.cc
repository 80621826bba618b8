// "realitygrad.check/1".
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/model/robot_model.h"
#include "services/diagnosis/reporting/set_check.h"

namespace rg::diagnosis {

using nlohmann::json;

namespace {

// Null: limits that the URDF does not have, temperatures that were not recorded.
json OrNull(double x) { return std::isfinite(x) ? json(x) : json(nullptr); }
json OrNull(const std::optional<double>& x) { return x ? json(*x) : json(nullptr); }

json FileJson(const FileFigures& f) {
  json gaps = json::array();
  for (const auto& [start, end] : f.gaps) gaps.push_back({{"start", start}, {"end", end}});
  return {{"file", f.name},
          {"split", f.split == recordings::Split::kFit ? "fit" : "holdout"},
          {"rows", f.rows},
          {"duration_s", f.duration},
          {"rate_hz", 1 / f.period},
          {"gaps", gaps},
          {"missing_rows", f.missing},
          {"columns", f.columns}};
}

json JointJson(const recordings::RecordingSet& set, const sim::Plant& plant, const MotionSurvey& s, int j) {
  const model::Joint& joint = plant.model().joint(j);
  const JointFigures& f = s.joints[j];
  json out = {{"joint", joint.name},
              {"type", model::JointTypeName(joint.type)},
              {"moved", f.moved},
              {"prescribed", f.prescribed},
              {"position",
               {{"low", f.low},
                {"high", f.high},
                {"lower_limit", OrNull(joint.lower)},
                {"upper_limit", OrNull(joint.upper)},
                {"stddev", s.estimated.position_stddev[j]},
                {"stddev_manifest", OrNull(set.noise.position_stddev)},
                {"resolution", s.estimated.position_resolution[j]},
                {"resolution_manifest", OrNull(set.noise.position_resolution)}}},
              {"speed",
               {{"peak", f.peak_speed},
                {"limit", OrNull(joint.velocity)},
                {"measured", set.recordings.front().has_velocity()},
                {"stddev", s.estimated.velocity_stddev[j]},
                {"stddev_manifest", OrNull(set.noise.velocity_stddev)},
                {"lag_s", s.velocity_lag[j]}}},
              {"effort", {{"rms", f.effort_rms}, {"peak", f.peak_effort}, {"limit", OrNull(joint.effort)}}},
              {"holds_against", nullptr}};
  if (std::isfinite(f.temperature_low))
    out["temperature"] = {{"low", f.temperature_low}, {"high", f.temperature_high}};
  return out;
}

json EffectJson(const EffectShows& e) {
  json not_on = json::array();
  for (const WhyNot& w : e.not_on) not_on.push_back({{"joints", w.joints}, {"reason", w.reason}});
  return {
      {"effect", e.effect}, {"shows", e.shows}, {"joints", e.joints}, {"within", e.within}, {"not", not_on}};
}

}  // namespace

json CheckJson(const recordings::RecordingSet& set, const sim::Plant& plant, const SetCheck& check,
               const std::vector<EffectShows>& effects) {
  json out = {
      {"set", set.folder},
      {"robot",
       {{"name", plant.model().name()},
        {"urdf", set.urdf_path},
        {"joints", set.joints},
        {"locked", LockedJoints(set)},
        {"gravity", {set.gravity.x(), set.gravity.y(), set.gravity.z()}},
        {"drive", set.recordings.front().drive == recordings::EffortKind::kMeasured ? "effort_measured"
                                                                                    : "effort_command"},
        {"effort_excludes_gravity", set.effort_excludes_gravity}}},
      {"recordings", json::array()},
      {"joints", json::array()},
      {"effects", json::array()},
      {"warnings", check.warnings},
      {"refusal", check.refusal.ok() ? json(nullptr) : json(check.refusal.message())}};
  for (const FileFigures& f : check.survey.files) out["recordings"].push_back(FileJson(f));
  for (int j = 0; j < check.survey.n; ++j) out["joints"].push_back(JointJson(set, plant, check.survey, j));
  for (const StillJoint& s : StillJoints(check.survey)) out["joints"][s.joint]["holds_against"] = s.withstood;
  for (const EffectShows& e : effects) out["effects"].push_back(EffectJson(e));
  return out;
}

}  // namespace rg::diagnosis
