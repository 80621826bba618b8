#include "services/jobs/diagnose_task.h"

#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/sim/model_file.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/diagnosis/diagnosis.h"
#include "services/jobs/kinds.h"
#include "services/jobs/task_support.h"
#include "services/report/diagnosis_page.h"
#include "services/rollouts/recording_bundle.h"

namespace rg::jobs {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

Result<worker::TaskOutputs> RunDiagnose(const worker::TaskInput& input, worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::DiagnosePayload>(input));
  RG_ASSIGN_OR_RETURN(const worker::InputArtifact* artifact, input.Require(kInputRecording));
  auto set = rollouts::LoadBundle(artifact->bytes);
  if (!set.ok()) return set.status().WithPrefix("recording set " + artifact->sha256.substr(0, 12));
  diagnosis::DiagnosisOptions options;
  if (payload.window_s() > 0) options.window_s = payload.window_s();
  if (payload.seed() > 0) options.seed = payload.seed();
  options.threads = static_cast<int>(payload.threads());
  RG_ASSIGN_OR_RETURN(
      const diagnosis::DiagnosisResult result,
      diagnosis::Diagnose(*set, options, RealClock(), context.progress_fn(), &context.cancel_token()));
  if (context.cancelled()) return CancelledError("diagnosis was cancelled");
  const std::string said = diagnosis::DiagnosisJson(result);
  const json parsed = json::parse(said);
  json names = json::array();
  for (const json& f : parsed.at("findings"))
    names.push_back(
        {{"effect", f.at("effect")}, {"joints", f.at("joints")}, {"confidence", f.at("confidence")}});
  const json summary = {
      {"verdict", parsed.at("verdict")}, {"findings", names}, {"holdout", parsed.at("fit").at("holdout")}};
  worker::TaskOutputs outputs;
  outputs.artifacts.push_back({kOutputDiagnosis, kArtifactDiagnosis, said, summary.dump()});
  outputs.artifacts.push_back({kOutputModel, kArtifactModel, sim::ModelToJson(*result.plant, result.values),
                               json{{"robot", result.robot}}.dump()});
  outputs.artifacts.push_back({kOutputReport, kArtifactReport, report::DiagnosisPage(result), "{}"});
  outputs.summary_json = summary.dump();
  return outputs;
}

}  // namespace rg::jobs
