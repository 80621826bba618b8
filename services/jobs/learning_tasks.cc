#include "services/jobs/learning_tasks.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/model/robot_model.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/kinds.h"
#include "services/jobs/task_support.h"
#include "services/policy/dataset.h"
#include "services/policy/policy.h"
#include "services/policy/train.h"
#include "services/trajectories/aggregation.h"
#include "services/trajectories/shard.h"

namespace rg::jobs {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

Eigen::VectorXd ToVector(const google::protobuf::RepeatedField<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), values.size());
}

trajectories::ShardSpec SpecOf(const pb::TrajectoriesPayload& payload) {
  trajectories::ShardSpec spec;
  spec.mpc.velocity_margin = trajectories::kRobotVelocityMargin;
  spec.mpc.warm_iterations = 1;  // a second one changed no policy's errors by more than seeds do
  spec.seed = payload.seed();
  spec.first = payload.first();
  spec.count = payload.count();
  if (payload.duration_s() > 0) spec.duration_s = payload.duration_s();
  if (payload.reach() > 0) spec.sampling.reach_fraction = payload.reach();
  if (payload.home_size() > 0) spec.sampling.home = ToVector(payload.home());
  if (payload.spread() > 0) spec.sampling.home_range = payload.spread();
  if (payload.peak_torque_size() > 0) spec.mpc.peak_torque = ToVector(payload.peak_torque());
  return spec;
}

json FailuresJson(const trajectories::Shard& shard) {
  json failures = json::object();
  for (int kind = 0; kind < trajectories::kFailureKinds; ++kind) {
    const uint64_t count = shard.failures[static_cast<size_t>(kind)];
    if (count > 0)
      failures[std::string(trajectories::FailureName(static_cast<trajectories::Failure>(kind)))] = count;
  }
  return failures;
}

Result<policy::Dataset> DatasetOf(const worker::TaskInput& input) {
  policy::Dataset dataset;
  const auto shards = input.All(kInputShard);
  if (shards.empty()) return InvalidError(input.task_name + ": no shard of trajectories was given");
  for (const worker::InputArtifact* artifact : shards) {
    RG_ASSIGN_OR_RETURN(const trajectories::Shard shard,
                        trajectories::ParseShard(artifact->bytes, "shard " + artifact->sha256.substr(0, 12)));
    for (const trajectories::Trajectory& t : shard.trajectories) {
      dataset.AddTrajectory((shard.seed << 32) + t.slot, t.q, t.v, t.goal, t.torque);
    }
  }
  return dataset;
}

// Errors that are no number are null.
json QuantilesJson(const std::vector<double>& errors) {
  json out = {{"median", nullptr}, {"p90", nullptr}, {"diverged", 0}};
  if (errors.empty()) return out;
  out["diverged"] = trajectories::Examination::Diverged(errors);
  const double median = trajectories::Quantile(errors, 0.5), p90 = trajectories::Quantile(errors, 0.9);
  if (std::isfinite(median)) out["median"] = median;
  if (std::isfinite(p90)) out["p90"] = p90;
  return out;
}

Result<policy::Policy> PolicyOf(const worker::TaskInput& input, const sim::ModelFile& model) {
  const worker::InputArtifact* artifact = input.Find(kInputPolicy);
  if (artifact == nullptr) return InvalidError(input.task_name + ": no policy was given");
  RG_ASSIGN_OR_RETURN(policy::Policy policy,
                      policy::ParsePolicy(artifact->bytes, "policy " + artifact->sha256.substr(0, 12)));
  const int n = model.plant.num_joints();
  if (policy.input_size() != 3 * n || policy.output_size() != n) {
    return InvalidError(input.task_name + ": the policy has " + std::to_string(policy.output_size()) +
                        " efforts, the model " + std::to_string(n) + " joints");
  }
  return policy;
}

// (q, q̇, q_goal) → effort. `policy` must outlive it.
trajectories::Learner LearnerOf(const policy::Policy& policy) {
  return [&policy, in = std::vector<double>(static_cast<size_t>(policy.input_size()))](
             const Eigen::VectorXd& q, const Eigen::VectorXd& v, const Eigen::VectorXd& goal,
             Eigen::VectorXd* effort) mutable {
    const auto n = static_cast<size_t>(q.size());
    for (size_t i = 0; i < n; ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      in[i] = q[row], in[n + i] = v[row], in[2 * n + i] = goal[row];
    }
    effort->resize(q.size());
    return policy.Evaluate(in, {effort->data(), n}).ok();
  };
}

policy::TrainOptions OptionsOf(const pb::TrainPayload& payload) {
  policy::TrainOptions options;
  options.seed = payload.seed();
  if (payload.epochs() > 0) options.epochs = static_cast<int>(payload.epochs());
  if (payload.batch() > 0) options.batch = static_cast<int>(payload.batch());
  if (payload.learning_rate() > 0) options.learning_rate = payload.learning_rate();
  if (payload.hidden_size() > 0) options.hidden.assign(payload.hidden().begin(), payload.hidden().end());
  return options;
}

json CurveJson(const std::vector<policy::EpochLoss>& curve) {
  json train = json::array(), validation = json::array();
  for (const policy::EpochLoss& epoch : curve) {
    train.push_back(epoch.train);
    validation.push_back(epoch.validation);  // NaN becomes null
  }
  return {{"train", train}, {"validation", validation}};
}

// Whether the examination that this task depends on, if there is one, leaves it nothing to do.
Result<bool> NothingToImprove(const worker::TaskInput& input) {
  const worker::InputArtifact* artifact = input.Find(kInputExamination);
  if (artifact == nullptr) return false;
  const json said = json::parse(artifact->bytes, nullptr, false);
  if (!said.is_object() || !said.contains("train_on"))
    return DataLossError(input.task_name + ": the examination is not one");
  return !said.at("train_on").get<bool>();
}

// The input goes on as it is.
Result<worker::TaskOutputs> PassOn(const worker::TaskInput& input, const char* name, const char* output,
                                   const char* kind) {
  RG_ASSIGN_OR_RETURN(const worker::InputArtifact* artifact, input.Require(name));
  worker::TaskOutputs outputs;
  outputs.artifacts.push_back({output, kind, artifact->bytes, artifact->metadata_json});
  outputs.summary_json = json{{"skipped", true}}.dump();
  return outputs;
}

}  // namespace

Result<worker::TaskOutputs> RunTrajectories(const worker::TaskInput& input, worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::TrajectoriesPayload>(input));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, ModelOf(input));
  const double start = RealClock().SteadySeconds();
  RG_ASSIGN_OR_RETURN(const trajectories::Shard shard,
                      trajectories::GenerateShard(model.plant, model.values, SpecOf(payload),
                                                  context.progress_fn(), &context.cancel_token()));
  if (shard.num_failures() > 0) context.Log("draws replaced: " + shard.FailureSummary());
  const json summary = {
      {"solved", shard.trajectories.size()}, {"failed", shard.num_failures()},
      {"failures", FailuresJson(shard)},     {"unfilled", shard.unfilled.size()},
      {"samples", shard.num_samples()},      {"seconds", RealClock().SteadySeconds() - start}};
  worker::TaskOutputs outputs;
  outputs.artifacts.push_back(
      {kOutputShard, kArtifactShard, trajectories::SerializeShard(shard), summary.dump()});
  outputs.summary_json = summary.dump();
  return outputs;
}

Result<worker::TaskOutputs> RunAggregate(const worker::TaskInput& input, worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::TrajectoriesPayload>(input));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, ModelOf(input));
  RG_ASSIGN_OR_RETURN(const policy::Policy policy, PolicyOf(input, model));
  RG_ASSIGN_OR_RETURN(const bool skipped, NothingToImprove(input));
  trajectories::AggregationSpec spec;
  spec.shard = SpecOf(payload);
  spec.expert_share = payload.expert_share();
  spec.hold_s = payload.hold_s();
  const double start = RealClock().SteadySeconds();
  trajectories::Shard shard;
  shard.joints = model.plant.joint_names();
  if (!skipped) {
    RG_ASSIGN_OR_RETURN(shard, trajectories::AggregateShard(model.plant, model.values, spec, LearnerOf(policy),
                                                            context.progress_fn(), &context.cancel_token()));
  }
  std::vector<double> errors;
  for (const trajectories::Trajectory& t : shard.trajectories) errors.push_back(t.goal_error);
  const json summary = {{"solved", shard.trajectories.size()},
                        {"failed", shard.num_failures()},
                        {"failures", FailuresJson(shard)},
                        {"unfilled", shard.unfilled.size()},
                        {"samples", shard.num_samples()},
                        {"goal_error", QuantilesJson(errors)},
                        {"seconds", RealClock().SteadySeconds() - start}};
  worker::TaskOutputs outputs;
  outputs.artifacts.push_back(
      {kOutputShard, kArtifactShard, trajectories::SerializeShard(shard), summary.dump()});
  outputs.summary_json = summary.dump();
  return outputs;
}

Result<worker::TaskOutputs> RunExamine(const worker::TaskInput& input, worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::TrajectoriesPayload>(input));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, ModelOf(input));
  RG_ASSIGN_OR_RETURN(const policy::Policy policy, PolicyOf(input, model));
  RG_ASSIGN_OR_RETURN(const bool skipped, NothingToImprove(input));
  if (skipped) return PassOn(input, kInputExamination, kOutputExamination, kArtifactExamination);
  RG_ASSIGN_OR_RETURN(const trajectories::Examination examination,
                      trajectories::Examine(model.plant, model.values, SpecOf(payload), LearnerOf(policy),
                                            context.progress_fn(), &context.cancel_token()));
  const json summary = {{"pairs", examination.pairs()},
                        {"passed", examination.Passed()},
                        {"train_on", examination.WorthTrainingOn()},
                        {"policy", QuantilesJson(examination.learner)},
                        {"mpc", QuantilesJson(examination.mpc)}};
  worker::TaskOutputs outputs;
  outputs.artifacts.push_back({kOutputExamination, kArtifactExamination, summary.dump(), summary.dump()});
  outputs.summary_json = summary.dump();
  return outputs;
}

Result<worker::TaskOutputs> RunTrain(const worker::TaskInput& input, worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::TrainPayload>(input));
  RG_ASSIGN_OR_RETURN(const bool skipped, NothingToImprove(input));
  if (skipped) return PassOn(input, kInputPolicy, kOutputPolicy, kArtifactPolicy);
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, ModelOf(input));
  RG_ASSIGN_OR_RETURN(const policy::Dataset dataset, DatasetOf(input));
  policy::TrainOptions options = OptionsOf(payload);
  options.joints = model.plant.joint_names();
  const double start = RealClock().SteadySeconds();
  RG_ASSIGN_OR_RETURN(const policy::TrainResult result,
                      policy::Train(dataset, options, context.progress_fn(), &context.cancel_token()));
  context.Log(result.Message());
  if (result.termination == policy::Termination::kCancelled) return CancelledError("training was cancelled");
  if (result.termination == policy::Termination::kDiverged) {
    return InvalidError("training diverged in epoch " + std::to_string(result.diverged_epoch));
  }
  json summary = {{"points", result.policy.record().points},
                  {"validation_points", result.policy.record().validation_points},
                  {"epochs", result.policy.record().epochs},
                  {"train_loss", result.train_loss},
                  {"validation_loss", result.validation_loss},
                  {"train_rms", result.train_rms},
                  {"validation_rms", result.validation_rms},
                  {"seconds", RealClock().SteadySeconds() - start}};
  worker::TaskOutputs outputs;
  outputs.summary_json = summary.dump();
  summary["curve"] = CurveJson(result.policy.record().curve);
  outputs.artifacts.push_back(
      {kOutputPolicy, kArtifactPolicy, policy::SerializePolicy(result.policy), summary.dump()});
  return outputs;
}

}  // namespace rg::jobs
