#include "services/jobs/adopt_task.h"

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/base/hash.h"
#include "common/sim/model_file.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/identify_problem.h"
#include "services/jobs/identify_tasks.h"
#include "services/jobs/iteration_result.h"
#include "services/jobs/kinds.h"
#include "services/jobs/rollout_inputs.h"
#include "services/jobs/task_support.h"
#include "services/rollouts/recording_bundle.h"
#include "services/rollouts/scoring.h"

namespace rg::jobs {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;
using recordings::Recording;

constexpr double kWindow_s = 1.0;
constexpr double kInfinite = std::numeric_limits<double>::infinity();

// RMS over rows and joints [rad or m]; infinite where the simulation broke down.
struct Error {
  double windows = 0.0;    // restarted every second
  double open_loop = 0.0;  // from the first row to the last
  double tip_m = 0.0;      // accumulated over the rows, open loop
};

Error ErrorOn(const sim::ModelFile& model, const std::vector<const Recording*>& recordings) {
  double windows = 0.0, open_loop = 0.0, rows = 0.0;
  Error error;
  for (const Recording* recording : recordings) {
    rollouts::SimulationScoreOptions restarted;
    restarted.window_s = kWindow_s;
    const auto short_runs = rollouts::ScoreSimulation(model.plant, model.values, *recording, restarted);
    const auto long_run = rollouts::ScoreSimulation(model.plant, model.values, *recording, {});
    const double weight = recording->rows();
    windows += short_runs.ok ? weight * short_runs.joint_rms * short_runs.joint_rms : kInfinite;
    open_loop += long_run.ok ? weight * long_run.joint_rms * long_run.joint_rms : kInfinite;
    error.tip_m += long_run.accumulated_tip_m;
    rows += weight;
  }
  error.windows = std::sqrt(windows / rows);
  error.open_loop = std::sqrt(open_loop / rows);
  return error;
}

json NumberOrNull(double value) { return std::isfinite(value) ? json(value) : json(nullptr); }

json ErrorJson(const Error& e) {
  return {{"window_rms", NumberOrNull(e.windows)},
          {"open_loop_rms", NumberOrNull(e.open_loop)},
          {"accumulated_tip_m", NumberOrNull(e.tip_m)}};
}

std::vector<const Recording*> RecordingsOf(const ReadRollouts& rollouts) {
  std::vector<const Recording*> out;
  for (const auto& set : rollouts.sets) out.push_back(&set.recordings.front());
  return out;
}

Result<sim::ModelFile> ModelNamed(const worker::TaskInput& input, const char* name) {
  RG_ASSIGN_OR_RETURN(const worker::InputArtifact* artifact, input.Require(name));
  return sim::ModelFromJson(artifact->bytes, std::string(name) + " " + artifact->sha256.substr(0, 12));
}

// What identification made of the diagnosed model; nothing where no chain could be simulated.
Result<std::optional<sim::ModelFile>> Refined(const worker::TaskInput& input, const pb::AdoptPayload& payload,
                                              const sim::ModelFile& diagnosed, const Recording& newest,
                                              worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, ModelToFit(diagnosed, OptionsOf(payload.identify())));
  RG_ASSIGN_OR_RETURN(
      const IdentifyProblem problem,
      IdentifyProblem::Create(model.plant, model.values, newest, LastRoundOf(payload.identify())));
  const auto best = BestChain(input, problem);
  if (!best.ok()) {
    context.Log("refinement: " + best.status().message());
    return std::optional<sim::ModelFile>();
  }
  return std::optional<sim::ModelFile>({model.plant, problem.FullValues(best->best), model.version});
}

struct Choice {
  std::string name;
  const sim::ModelFile* model;
};

bool Better(const Error& a, const Error& b) { return a.windows < b.windows && a.open_loop <= b.open_loop; }

// By this much less error more structure is worth having where both models were fitted to the rollout.
constexpr double kWorthItsStructure = 0.8;

// Whether the diagnosed model goes on, and not identification alone. `unseen`: the errors are on a rollout that was made
// after both models.
bool GoesOn(const Error& diagnosed, const Error& identified, bool unseen) {
  const double share = unseen ? 1.0 : kWorthItsStructure;
  return diagnosed.windows < share * identified.windows && (unseen || diagnosed.open_loop <= identified.open_loop);
}

// Whether the last diagnosis predicted the newest rollout better than the model that identification alone had come to
// before it; nothing where there was none. Their errors are added to `unseen`.
Result<std::optional<bool>> PredictedBetter(const worker::TaskInput& input,
                                            const std::vector<const Recording*>& newest, json* unseen) {
  if (input.Find(kInputDiagnosedBefore) == nullptr) return std::optional<bool>();
  RG_ASSIGN_OR_RETURN(const sim::ModelFile identified, ModelNamed(input, kInputIdentifiedBefore));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile diagnosed, ModelNamed(input, kInputDiagnosedBefore));
  const Error by_identified = ErrorOn(identified, newest), by_diagnosed = ErrorOn(diagnosed, newest);
  (*unseen)["identified"] = ErrorJson(by_identified), (*unseen)["diagnosed"] = ErrorJson(by_diagnosed);
  return std::optional<bool>(GoesOn(by_diagnosed, by_identified, true));
}

// Everything that is not as the URDF has it.
json ChangedValues(const sim::ModelFile& model) {
  json rows = json::array();
  const auto& table = model.plant.parameters();
  for (int i = 0; i < table.size(); ++i) {
    const bool effect = table[i].kind == sim::ParameterKind::kEffect;
    if (effect || model.values[i] != table[i].nominal)
      rows.push_back({{"name", table[i].name}, {"value", model.values[i]}});
  }
  return rows;
}

std::string Named(const json& diagnosis) {
  std::string names;
  for (const json& finding : diagnosis.at("findings")) {
    names += (names.empty() ? "" : "; ") + finding.at("effect").get<std::string>();
    for (const json& joint : finding.at("joints")) names += " " + joint.get<std::string>();
  }
  return names.empty() ? diagnosis.at("verdict").get<std::string>() : names;
}

json Shortened(const json& diagnosis) {
  json findings = json::array();
  for (const json& f : diagnosis.at("findings"))
    findings.push_back({{"effect", f.at("effect")},
                        {"joints", f.at("joints")},
                        {"confidence", f.at("confidence")},
                        {"statement", f.value("statement", "")}});
  json out = {{"verdict", diagnosis.at("verdict")}, {"findings", findings}};
  for (const char* key : {"fit", "note", "elapsed_s"}) {
    if (diagnosis.contains(key)) out[key] = diagnosis.at(key);
  }
  return out;
}

}  // namespace

Result<worker::TaskOutputs> RunAdopt(const worker::TaskInput& input, worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::AdoptPayload>(input));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile nominal, ModelNamed(input, kInputNominal));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile planned_with, ModelNamed(input, kInputModel));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile identified, ModelNamed(input, kInputIdentified));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile diagnosed, ModelNamed(input, kInputDiagnosed));
  RG_ASSIGN_OR_RETURN(const ReadRollouts read, RolloutsOf(input, rollouts::LoadBundleOfWholeTorques));
  for (const std::string& line : read.left_out) context.Log(line);
  const std::vector<const Recording*> all = RecordingsOf(read), last = {all.back()};
  RG_ASSIGN_OR_RETURN(const worker::InputArtifact* said, input.Require(kInputDiagnosis));
  RG_ASSIGN_OR_RETURN(const worker::InputArtifact* concluded, input.Require(kInputResult));
  const json diagnosis = json::parse(said->bytes, nullptr, false);
  json result = json::parse(concluded->bytes, nullptr, false);
  if (diagnosis.is_discarded() || result.is_discarded())
    return DataLossError(input.task_name + ": diagnosis or result is no JSON");
  RG_ASSIGN_OR_RETURN(const auto refined, Refined(input, payload, diagnosed, *all.back(), context));

  const Error diagnosed_all = ErrorOn(diagnosed, all);
  const Error refined_all = refined ? ErrorOn(*refined, all) : Error{kInfinite, kInfinite, kInfinite};
  const Error identified_all = ErrorOn(identified, all);
  const bool further = refined && (Better(refined_all, diagnosed_all) || !std::isfinite(diagnosed_all.windows));
  const Choice found = further ? Choice{"diagnosed and identified", &*refined} : Choice{"diagnosed", &diagnosed};
  json unseen = {{"nominal", ErrorJson(ErrorOn(nominal, last))}};
  RG_ASSIGN_OR_RETURN(const std::optional<bool> predicted_better, PredictedBetter(input, last, &unseen));
  const bool goes_on =
      predicted_better.value_or(GoesOn(further ? refined_all : diagnosed_all, identified_all, false));
  const Choice choice = goes_on ? found : Choice{"identified", &identified};
  json fitted = {{"nominal", ErrorJson(ErrorOn(nominal, all))},
                 {"identified", ErrorJson(identified_all)},
                 {"diagnosed", ErrorJson(diagnosed_all)}};
  if (refined) fitted["diagnosed and identified"] = ErrorJson(refined_all);
  json brought = Shortened(diagnosis);
  brought["rollouts"] = all.size();
  if (!read.left_out.empty()) brought["left_out"] = read.left_out;
  brought["quiet_joints"] = MetadataOf(*said).value("quiet_joints", json::array());
  brought["window_s"] = kWindow_s;
  brought["unseen"] = unseen;
  brought["all_rollouts"] = fitted;
  brought["adopted"] = choice.name;
  brought["adopted_error"] = ErrorJson(ErrorOn(*choice.model, all));
  if (all.size() <= 2) brought.erase("fit");  // nothing was held out
  result["diagnosis"] = brought;
  result["identified_model"] = input.Find(kInputIdentified)->sha256;
  const std::string found_json = sim::ModelToJson(found.model->plant, found.model->values);
  result["diagnosed_model"] = Sha256Hex(found_json);

  const std::string model_json = sim::ModelToJson(choice.model->plant, choice.model->values,
                                                  std::max(identified.version, planned_with.version) + 1);
  json metadata = {{"robot", payload.robot()},
                         {"source", "identified"},
                         {"values", ChangedValues(*choice.model)},
                         {"recording", read.inputs.back()->sha256},
                         {"model", Sha256Hex(model_json)},
                         {"note", "iteration " + std::to_string(payload.iteration()) + ", " + choice.name +
                                      ": " + Named(diagnosis)}};
  worker::TaskOutputs outputs;
  outputs.remark = NoteRolloutEnd(*read.inputs.back(), payload.accept_partial(), &metadata);
  const std::string robot = json{{"robot", payload.robot()}}.dump();
  outputs.artifacts.push_back({kOutputDiagnosed, kArtifactModel, found_json, robot});
  outputs.artifacts.push_back({kOutputModel, kArtifactModel, model_json, robot});
  outputs.artifacts.push_back(
      {kOutputParameters, kArtifactParameters, metadata.at("values").dump(), metadata.dump()});
  outputs.artifacts.push_back({kOutputResult, kArtifactResult, result.dump(), robot});
  outputs.summary_json = json{
      {"verdict", diagnosis.at("verdict")},
      {"named", Named(diagnosis)},
      {"adopted", choice.name},
      {"all_rollouts", fitted},
      {"unseen", unseen}}.dump();
  return outputs;
}

}  // namespace rg::jobs
