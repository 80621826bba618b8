// diagnosis.json as RECORDINGS.md has it, and the three files of a diagnosis.
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/recordings/csv.h"
#include "common/sim/model_file.h"
#include "services/diagnosis/diagnosis.h"

namespace rg::diagnosis {

using nlohmann::json;

namespace {

json FindingJson(const Finding& f) {
  json where = {{"summary", f.summary},
                {"share_of_mismatch", f.share_of_mismatch},
                {"regions", json::array()},
                {"windows", json::array()}};
  for (const Region& r : f.regions)
    where["regions"].push_back({{"variable", r.variable}, {"low", r.low}, {"high", r.high}});
  for (const TimeWindow& w : f.windows) {
    where["windows"].push_back({{"recording", w.recording}, {"start", w.start}, {"end", w.end}});
  }
  json parameters = json::object();
  for (const ParameterEstimate& p : f.parameters) {
    parameters[p.owner][p.name] = {{"value", p.value}, {"stddev", p.stddev}, {"unit", p.unit}};
  }
  json alternatives = json::array();
  for (const Alternative& a : f.alternatives) {
    alternatives.push_back({{"effect", a.effect},
                            {"joints", a.joints},
                            {"evidence", a.evidence},
                            {"separable", a.separable},
                            {"experiment", a.experiment}});
  }
  return {{"effect", f.effect},     {"joints", f.joints},       {"confidence", f.confidence},
          {"where", where},         {"statement", f.statement}, {"class", f.effect_class},
          {"equation", f.equation}, {"parameters", parameters}, {"alternatives", alternatives}};
}

}  // namespace

std::string DiagnosisJson(const DiagnosisResult& r) {
  json findings = json::array();
  for (const Finding& f : r.findings) findings.push_back(FindingJson(f));
  const HoldoutFit& h = r.holdout;
  json recordings = json::array();
  for (const HoldoutRecording& rec : h.recordings) {
    recordings.push_back({{"file", rec.name},
                          {"before_rms", rec.before_rms},
                          {"calibrated_rms", rec.calibrated_rms},
                          {"after_rms", rec.after_rms},
                          {"before_median", rec.before_median},
                          {"calibrated_median", rec.calibrated_median},
                          {"after_median", rec.after_median}});
  }
  json out = {{"format", "realitygrad.diagnosis/1"},
              {"verdict", r.verdict},
              {"findings", findings},
              {"fit",
               {{"window_s", r.window_s},
                {"holdout",
                 {{"before_rms", h.before_rms},
                  {"calibrated_rms", h.calibrated_rms},
                  {"after_rms", h.after_rms},
                  {"noise_floor_rms", h.noise_floor_rms},
                  {"improvement_ci95", {h.improvement_low, h.improvement_high}},
                  {"recordings", recordings}}},
                {"mismatch", r.mismatch},
                {"remaining", r.remaining},
                {"noise_scale", r.noise_scale}}},
              {"notes", r.notes},
              {"elapsed_s", r.elapsed_s}};
  if (r.motion) {
    out["motion"] = {{"file", "motion.csv"},
                     {"separates", r.motion->effects},
                     {"description", r.motion->description},
                     {"duration_s", r.motion->t.back()},
                     {"expected_nats", r.motion->expected_nats}};
  }
  return out.dump(1);
}

std::string MotionCsv(const DiagnosisResult& r) {
  if (!r.motion) return "";
  recordings::Recording rows;
  rows.joints = r.joints;
  rows.t =
      Eigen::Map<const Eigen::VectorXd>(r.motion->t.data(), static_cast<Eigen::Index>(r.motion->t.size()));
  rows.q = r.motion->q, rows.v = r.motion->v;
  return recordings::FormatCsv(rows, 9);
}

Status WriteDiagnosis(const std::string& folder, const DiagnosisResult& r, const std::string& page) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return UnavailableError(folder + ": " + error.message());
  RG_RETURN_IF_ERROR(WriteFileAtomically(folder + "/diagnosis.json", DiagnosisJson(r) + "\n"));
  if (r.plant)
    RG_RETURN_IF_ERROR(sim::SaveModelFile(folder + "/model.json", *r.plant, r.values, 0, r.held_before));
  if (r.motion) {
    RG_RETURN_IF_ERROR(WriteFileAtomically(folder + "/motion.csv", MotionCsv(r)));
  } else {
    std::filesystem::remove(folder + "/motion.csv", error);  // of an earlier diagnosis
  }
  return page.empty() ? Status::Ok() : WriteFileAtomically(folder + "/report.html", page);
}

}  // namespace rg::diagnosis
