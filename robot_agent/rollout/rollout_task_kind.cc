#include "robot_agent/rollout/rollout_task_kind.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/hash.h"
#include "common/base/printf.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/parameters.pb.h"
#include "realitygrad/v1/payloads.pb.h"
#include "robot_agent/rollout/rollout_task.h"
#include "services/jobs/job_graphs.h"
#include "services/jobs/kinds.h"
#include "services/jobs/task_support.h"
#include "services/rollouts/recording_bundle.h"
#include "services/rollouts/trust.h"
#include "worker/task_registry.h"

namespace rg::robot_agent {
namespace {

namespace pb = ::realitygrad::v1;

Eigen::VectorXd ToVector(const google::protobuf::RepeatedField<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), values.size());
}

// All that is asked for, and of which database; the numbers of jobs begin again in another one.
std::string RequestHash(const worker::TaskInput& input) {
  std::string text;
  const auto add = [&](const std::string& part) { text += std::to_string(part.size()) + ":" + part; };
  for (const std::string& part : {input.database, input.task_name, input.kind, input.payload}) add(part);
  for (const auto& artifact : input.inputs) add(artifact.name), add(artifact.sha256);
  return Sha256Hex(text);
}

// The same attempt at the same request of the same database has the same id, whatever else never: a repeat
// moves nothing, and what is asked for anew is never answered with what was recorded before.
std::string RolloutId(const worker::TaskInput& input) {
  constexpr size_t kName = 20, kDatabase = 8, kRequest = 12;  // at most 70 letters with the numbers
  return "job" + std::to_string(input.job) + "-" + input.task_name.substr(0, kName) + "-" +
         std::to_string(input.attempt) + "-" + input.database.substr(0, kDatabase) + "-" +
         RequestHash(input).substr(0, kRequest);
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

// From the oldest version on, each recording once. What another kind of driver did (a simulated arm of the
// same name) says nothing of this one.
double TrustIn(coordinator::Client& client, const std::string& robot, const std::string& driver) {
  constexpr uint32_t kVersions = 64;
  const auto history = client.ParameterHistory(robot, kVersions);
  double trust = 0.0;
  std::set<std::string> counted;
  for (size_t i = history.ok() ? history->size() : 0; i-- > 0;) {
    const std::string& sha256 = (*history)[i].recording_sha256();
    if (sha256.empty() || !counted.insert(sha256).second) continue;
    const auto info = client.ShowArtifact(sha256);
    if (!info.ok()) continue;
    const auto said = nlohmann::json::parse(info->metadata_json(), nullptr, false);
    if (said.is_object() && said.value("driver", "") == driver)
      trust = rollouts::TrustAfter(trust, said.value("end_reason", ""), said.value("held", false));
  }
  return trust;
}

// Without a coordinator to ask: none.
double TrustOf(const AgentConfig& config, worker::TaskContext& context) {
  if (!config.first_rollouts.on()) return 1.0;
  const auto client = context.Coordinator();
  const double trust = client.ok() ? TrustIn(**client, config.name, config.driver) : 0.0;
  const std::string text = Printf("trust in %s is %.2f of 1: at most %.0f %% of its speed",
                                  config.name.c_str(), trust, 100 * config.first_rollouts.SpeedOf(trust));
  context.Log(text);
  return trust;
}

// A policy that diverges in simulation does not drive an arm: the controller that it learned from does.
std::string ControllerOf(const pb::RolloutPayload& payload, const worker::TaskInput& input,
                         worker::TaskContext& context) {
  const std::string asked = payload.controller().empty() ? "policy" : payload.controller();
  const worker::InputArtifact* artifact = input.Find(jobs::kInputExamination);
  if (asked != "policy" || artifact == nullptr) return asked;
  const auto said = nlohmann::json::parse(artifact->bytes, nullptr, false);
  const auto at = [&](const char* pointer) { return said.value(nlohmann::json::json_pointer(pointer), 0); };
  if (!said.is_object() || at("/policy/diverged") == 0) return asked;
  context.Log("the policy diverges in simulation from " + std::to_string(at("/policy/diverged")) + " of " +
              std::to_string(at("/pairs")) + " starts: MPC drives instead");
  return "mpc";
}

// A failed task has no outputs: its recording goes to the store by itself, at once, not when the spool is
// emptied.
Status StoreRecording(const worker::TaskInput& input, const RolloutTaskOutput& done,
                      worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto client, context.Coordinator());
  pb::ArtifactInfo info;
  info.set_kind(jobs::kArtifactRecording);
  info.set_metadata_json(done.metadata_json);
  info.set_job_id(std::to_string(input.job));
  info.set_task_id(std::to_string(input.task));
  for (const worker::InputArtifact& from : input.inputs) info.add_parents(from.sha256);
  return client->PutArtifact(done.bundle, info).status();
}

Status NotWhole(const worker::TaskInput& input, const RolloutTaskOutput& done, worker::TaskContext& context) {
  const Status stored = StoreRecording(input, done, context);
  if (!stored.ok()) context.Log("the recording stays in the spool until it can be sent: " + stored.message());
  return AbortedError(done.end.text + "; its recording is kept: artefact " +
                      Sha256Hex(done.bundle).substr(0, 12));
}

}  // namespace

void RegisterRolloutKind(const AgentConfig& config, const std::string& spool_folder,
                         worker::TaskRegistry* registry) {
  registry->Register(
      jobs::kKindRollout,
      [config, spool_folder](const worker::TaskInput& input,
                             worker::TaskContext& context) -> Result<worker::TaskOutputs> {
        RG_ASSIGN_OR_RETURN(const auto payload, jobs::ParsePayload<pb::RolloutPayload>(input));
        if (payload.robot() != config.name) {
          return FailedPreconditionError("this agent stands beside '" + config.name + "', not '" +
                                         payload.robot() + "'");
        }
        RG_ASSIGN_OR_RETURN(const worker::InputArtifact* model, input.Require(jobs::kInputModel));
        const worker::InputArtifact* policy = input.Find(jobs::kInputPolicy);
        RolloutTaskInput task;
        task.trust = TrustOf(config, context);
        task.slower_attempts =
            static_cast<int>(std::min<uint32_t>(payload.slower_attempts(), jobs::kMostSlowerAttempts));
        task.model_json = model->bytes;
        task.database = input.database;
        task.job_id = std::to_string(input.job);
        task.task_id = std::to_string(input.task);
        task.controller = ControllerOf(payload, input, context);
        if (policy != nullptr) task.policy_bytes = policy->bytes;
        const worker::InputArtifact* motion = input.Find(jobs::kInputMotion);
        if (motion != nullptr) task.motion_csv = motion->bytes;
        task.spec = SpecOf(payload, RolloutId(input));
        RG_ASSIGN_OR_RETURN(
            const RolloutTaskOutput done,
            RunRolloutTask(config, spool_folder, task, context.progress_fn(), context.cancel_token()));
        context.Log(done.summary_json);
        RG_RETURN_IF_ERROR(done.usable);  // its recording goes to the store from the spool
        if (payload.whole() && !done.end.as_asked) return NotWhole(input, done, context);
        worker::TaskOutputs outputs;
        if (!done.end.as_asked) outputs.remark = "rollout " + done.end.text;
        outputs.artifacts.push_back(
            {jobs::kOutputRecording, jobs::kArtifactRecording, done.bundle, done.metadata_json});
        outputs.summary_json = done.summary_json;
        return outputs;
      },
      LongestEnd(config.stop));
}

}  // namespace rg::robot_agent
