#include "services/proof/generator/proof_case.h"

#include <cmath>
#include <cstdio>

#include "common/base/file.h"
#include "services/proof/generator/case_maker.h"
#include "services/proof/generator/equivalents.h"

namespace rg::proof {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

namespace {

constexpr int kAttempts = 6;
// An ordinary robot's error without one of its effects, over that with all.
constexpr double kPartShows = 1.3;

}  // namespace

Result<CaseSummary> CaseMaker::Run(const std::string& sets_folder, const std::string& labels_folder) {
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

Result<CaseSummary> MakeCase(const CaseRequest& request, const std::string& sets_folder,
                             const std::string& labels_folder) {
  std::string why;
  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    const uint64_t seed =
        attempt == 0 ? request.seed : Rng(request.seed).Split(static_cast<uint64_t>(attempt)).Next();
    auto summary = CaseMaker(request, seed).Run(sets_folder, labels_folder);
    if (summary.ok() || summary.status().code() != StatusCode::kInternal) return summary;
    why = summary.status().message();
  }
  return InternalError(request.name + ": " + why + ", in " + std::to_string(kAttempts) + " drawings");
}

}  // namespace rg::proof
