#include "services/jobs/fit_task.h"

#include <memory>
#include <string>

#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/search/fit_requests.h"
#include "services/jobs/diagnosis_inputs.h"
#include "services/jobs/fit_messages.h"
#include "services/jobs/kinds.h"
#include "services/jobs/task_support.h"

namespace rg::jobs {

namespace pb = ::realitygrad::v1;

namespace {

// One set, ready to be fitted.
struct ReadySet {
  ReadySet(recordings::RecordingSet from, sim::Plant plant)
      : set(std::move(from)), nominal(std::move(plant)) {}
  std::string key;
  recordings::RecordingSet set;
  sim::Plant nominal;
  diagnosis::FitData data;  // points into `set`
  diagnosis::MotionScales scales;
};

Result<std::unique_ptr<ReadySet>> Prepare(const worker::TaskInput& input, bool rollouts,
                                          const pb::FitBatch& batch, std::string key) {
  RG_ASSIGN_OR_RETURN(recordings::RecordingSet set, SetToDiagnose(input, rollouts));
  if (batch.recordings_size() > 0) set.KeepForFit({batch.recordings().begin(), batch.recordings().end()});
  RG_ASSIGN_OR_RETURN(const auto model, ModelToDiagnose(input, rollouts));
  RG_ASSIGN_OR_RETURN(sim::Plant nominal, diagnosis::GivenPlant(set, model));
  auto ready = std::make_unique<ReadySet>(std::move(set), std::move(nominal));
  diagnosis::DiagnosisOptions options;
  options.fit_window_s = batch.fit_window_s();
  RG_ASSIGN_OR_RETURN(ready->data, diagnosis::PrepareData(ready->set, ready->nominal, options));
  ready->scales = diagnosis::ScalesOf(ready->data, ready->nominal);
  ready->key = std::move(key);
  return ready;
}

class FitTask {
 public:
  Result<worker::TaskOutputs> Run(const worker::TaskInput& input) {
    RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::FitPayload>(input));
    RG_ASSIGN_OR_RETURN(const worker::InputArtifact* bytes, input.Require(kInputFitBatch));
    pb::FitBatch batch;
    if (!batch.ParseFromString(bytes->bytes)) return InvalidError("fit: the batch cannot be read");
    std::string key = std::to_string(payload.rollouts()) + " " + std::to_string(batch.fit_window_s());
    for (const worker::InputArtifact* recording : input.All(kInputRecording)) key += " " + recording->sha256;
    for (const uint32_t place : batch.recordings()) key += " " + std::to_string(place);
    if (const auto* model = input.Find(kInputModel)) key += " from " + model->sha256;
    if (ready_ == nullptr || ready_->key != key) {
      RG_ASSIGN_OR_RETURN(ready_, Prepare(input, payload.rollouts(), batch, key));
    }
    const diagnosis::FitSetting setting{ready_->data, ready_->nominal, ready_->scales};
    RG_ASSIGN_OR_RETURN(const diagnosis::FitRequest request, RequestOf(batch, payload.index(), setting));
    worker::TaskOutputs outputs;
    outputs.artifacts.push_back(
        {kOutputFit, kArtifactFit, ReplyOf(diagnosis::MakeFit(setting, request)).SerializeAsString(), "{}"});
    return outputs;
  }

 private:
  std::unique_ptr<ReadySet> ready_;
};

}  // namespace

worker::TaskFunction MakeFitTask() {
  return [task = std::make_shared<FitTask>()](const worker::TaskInput& input, worker::TaskContext&) {
    return task->Run(input);
  };
}

}  // namespace rg::jobs
