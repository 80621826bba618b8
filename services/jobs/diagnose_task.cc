#include "services/jobs/diagnose_task.h"

#include <nlohmann/json.hpp>
#include <optional>

#include "common/base/clock.h"
#include "common/sim/model_file.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/diagnosis/diagnosis.h"
#include "services/jobs/diagnosis_inputs.h"
#include "services/jobs/kinds.h"
#include "services/jobs/remote_fits.h"
#include "services/jobs/task_support.h"
#include "services/report/diagnosis_page.h"

namespace rg::jobs {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

namespace {

FitInputs FitInputsOf(const worker::TaskInput& input, const pb::DiagnosePayload& payload) {
  FitInputs inputs;
  inputs.of_a_task = true;
  inputs.rollouts = payload.rollouts();
  if (const worker::InputArtifact* model = input.Find(kInputModel)) inputs.model = model->sha256;
  for (const worker::InputArtifact* recording : input.All(kInputRecording))
    inputs.recordings.push_back(recording->sha256);
  return inputs;
}

// A loop goes on with the model it has where its rollouts say too little.
Result<worker::TaskOutputs> NotDiagnosed(const worker::TaskInput& input, const Status& why,
                                         const json& quiet, worker::TaskContext& context) {
  context.Log(why.message());
  RG_ASSIGN_OR_RETURN(const worker::InputArtifact* model, input.Require(kInputModel));
  const json said = {{"format", "realitygrad.diagnosis/1"},
                     {"verdict", "not_diagnosed"},
                     {"findings", json::array()},
                     {"note", why.message()}};
  const json summary = {{"verdict", "not_diagnosed"}, {"note", why.message()}, {"quiet_joints", quiet}};
  worker::TaskOutputs outputs;
  outputs.artifacts.push_back({kOutputDiagnosis, kArtifactDiagnosis, said.dump(), summary.dump()});
  outputs.artifacts.push_back({kOutputModel, kArtifactModel, model->bytes, "{}"});
  outputs.summary_json = summary.dump();
  return outputs;
}

}  // namespace

Result<worker::TaskOutputs> RunDiagnose(const worker::TaskInput& input, worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::DiagnosePayload>(input));
  const auto set = SetToDiagnose(input, payload.rollouts());
  diagnosis::DiagnosisOptions options;
  if (payload.window_s() > 0) options.window_s = payload.window_s();
  if (payload.seed() > 0) options.seed = payload.seed();
  if (payload.work_limit() > 0) options.work_limit = payload.work_limit();
  options.threads = static_cast<int>(payload.threads());
  options.trust_effort = payload.trust_effort() || payload.rollouts();  // the agent's own commands
  if (!set.ok() && !payload.rollouts()) return set.status();
  if (set.ok()) {
    RG_ASSIGN_OR_RETURN(options.model, ModelToDiagnose(input, payload.rollouts()));
    RG_ASSIGN_OR_RETURN(options.earlier, EarlierDiagnosis(input));
  }
  const auto coordinator = context.Coordinator();
  std::optional<RemoteFits> fits;
  if (coordinator.ok()) {
    fits.emplace(**coordinator, FitInputsOf(input, payload), &context.cancel_token());
    options.fits = &*fits;
  }
  const auto outcome = set.ok() ? diagnosis::Diagnose(*set, options, RealClock(), context.progress_fn(),
                                                      &context.cancel_token())
                                : Result<diagnosis::DiagnosisResult>(set.status());
  if (fits) {
    context.Log(std::to_string(fits->by_workers()) + " fits by other tasks, " + std::to_string(fits->here()) +
                " by this one");
  }
  if (context.cancelled()) return CancelledError("diagnosis was cancelled");
  json quiet = json::array();
  if (payload.rollouts() && set.ok() && options.model) quiet = QuietJoints(*set, options.model->plant);
  if (!outcome.ok() && payload.rollouts()) return NotDiagnosed(input, outcome.status(), quiet, context);
  if (!outcome.ok()) return outcome.status();
  const diagnosis::DiagnosisResult& result = *outcome;
  const std::string said = diagnosis::DiagnosisJson(result);
  const json parsed = json::parse(said);
  json names = json::array();
  for (const json& f : parsed.at("findings"))
    names.push_back(
        {{"effect", f.at("effect")}, {"joints", f.at("joints")}, {"confidence", f.at("confidence")}});
  const json summary = {{"verdict", parsed.at("verdict")},
                        {"findings", names},
                        {"holdout", parsed.at("fit").at("holdout")},
                        {"quiet_joints", quiet}};
  worker::TaskOutputs outputs;
  outputs.artifacts.push_back({kOutputDiagnosis, kArtifactDiagnosis, said, summary.dump()});
  outputs.artifacts.push_back({kOutputModel, kArtifactModel, sim::ModelToJson(*result.plant, result.values, 0, result.held_before),
                               json{{"robot", result.robot}}.dump()});
  outputs.artifacts.push_back({kOutputReport, kArtifactReport, report::DiagnosisPage(result), "{}"});
  if (result.motion) {
    const json motion = {{"name", "motion.csv"}, {"duration_s", result.motion->t.back()}};
    outputs.artifacts.push_back(
        {kOutputMotion, kArtifactMotion, diagnosis::MotionCsv(result), motion.dump()});
  }
  outputs.summary_json = summary.dump();
  return outputs;
}

}  // namespace rg::jobs
