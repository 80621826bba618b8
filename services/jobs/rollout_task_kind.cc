#include "services/jobs/rollout_task_kind.h"

#include "realitygrad/v1/payloads.pb.h"
#include "robot_agent/rollout_task.h"
#include "services/jobs/kinds.h"
#include "services/jobs/task_support.h"
#include "services/rollouts/recording_bundle.h"
#include "worker/task_registry.h"

namespace rg::jobs {
namespace {

namespace pb = ::realitygrad::v1;

Eigen::VectorXd ToVector(const google::protobuf::RepeatedField<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), values.size());
}

// The same task of the same job always has the same id, another one never: a repeat moves nothing.
std::string RolloutId(const worker::TaskInput& input, const std::string& model, const std::string& steering) {
  return "job" + std::to_string(input.job) + "-" + input.task_name + "-" + model.substr(0, 8) +
         (steering.empty() ? "" : "-" + steering.substr(0, 8));
}

rollouts::RolloutSpec SpecOf(const pb::RolloutPayload& payload, std::string id) {
  rollouts::RolloutSpec spec;
  spec.id = std::move(id);
  if (payload.rate_hz() > 0) spec.rate_hz = payload.rate_hz();
  if (payload.duration_s() > 0) spec.duration_s = payload.duration_s();
  spec.start = ToVector(payload.start_q());
  spec.goal = ToVector(payload.goal_q());
  spec.goal_position = ToVector(payload.goal_position());
  spec.goal_seed = payload.seed();
  spec.robot_seed = payload.seed();
  if (payload.reach_s() > 0) spec.goal_reach_s = payload.reach_s();
  if (payload.has_excitation()) spec.excitation = payload.excitation();
  return spec;
}

}  // namespace

void RegisterAgentKinds(const robot_agent::AgentConfig& config, const std::string& spool_folder,
                        worker::TaskRegistry* registry) {
  registry->Register(
      kKindRollout,
      [config, spool_folder](const worker::TaskInput& input,
                             worker::TaskContext& context) -> Result<worker::TaskOutputs> {
        RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::RolloutPayload>(input));
        if (payload.robot() != config.name) {
          return FailedPreconditionError("this agent stands beside '" + config.name + "', not '" +
                                         payload.robot() + "'");
        }
        RG_ASSIGN_OR_RETURN(const worker::InputArtifact* model, input.Require(kInputModel));
        const worker::InputArtifact* policy = input.Find(kInputPolicy);
        robot_agent::RolloutTaskInput task;
        task.model_json = model->bytes;
        task.job_id = std::to_string(input.job);
        task.task_id = std::to_string(input.task);
        if (!payload.controller().empty()) task.controller = payload.controller();
        if (policy != nullptr) task.policy_bytes = policy->bytes;
        const worker::InputArtifact* motion = input.Find(kInputMotion);
        if (motion != nullptr) task.motion_csv = motion->bytes;
        const worker::InputArtifact* steering = policy != nullptr ? policy : motion;
        task.spec = SpecOf(payload, RolloutId(input, model->sha256, steering ? steering->sha256 : ""));
        RG_ASSIGN_OR_RETURN(const robot_agent::RolloutTaskOutput done,
                            robot_agent::RunRolloutTask(config, spool_folder, task, context.progress_fn(),
                                                        context.cancel_token()));
        context.Log(done.summary_json);
        worker::TaskOutputs outputs;
        outputs.artifacts.push_back({kOutputRecording, kArtifactRecording, done.bundle, done.metadata_json});
        outputs.summary_json = done.summary_json;
        return outputs;
      });
}

}  // namespace rg::jobs
