#include "services/jobs/job_graphs.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/base/check.h"
#include "common/base/rng.h"
#include "services/jobs/kinds.h"
#include "services/jobs/options_json.h"

namespace rg::jobs {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

template <class T>
Status InRange(const char* name, T value, T low, T high) {
  if (!(value >= low && value <= high)) {
    return InvalidError(std::string(name) + " is " + json(value).dump() + ", must be between " +
                        json(low).dump() + " and " + json(high).dump());
  }
  return Status::Ok();
}

Status OneOf(const char* name, const std::string& value, const std::vector<std::string>& allowed) {
  std::string list;
  for (const std::string& a : allowed) {
    if (value == a) return Status::Ok();
    list += (list.empty() ? "" : ", ") + a;
  }
  return InvalidError(std::string(name) + " is '" + value + "', must be one of " + list);
}

pb::InputSpec* AddInput(pb::TaskSpec* task, const std::string& name) {
  pb::InputSpec* input = task->add_inputs();
  input->set_name(name);
  return input;
}

void AddArtifact(pb::TaskSpec* task, const std::string& name, const std::string& sha256) {
  AddInput(task, name)->set_artifact(sha256);
}

void AddStageOutputs(pb::TaskSpec* task, const std::string& name, const std::string& stage,
                     const std::string& output) {
  pb::StageOutputsRef* ref = AddInput(task, name)->mutable_stage_outputs();
  ref->set_stage(stage);
  ref->set_output(output);
}

void AddTaskOutput(pb::TaskSpec* task, const std::string& name, const std::string& from,
                   const std::string& output) {
  pb::TaskOutputRef* ref = AddInput(task, name)->mutable_task_output();
  ref->set_task(from);
  ref->set_output(output);
}

// Where an input comes from: a stage of this job, or an artefact if there is none.
void AddFrom(pb::TaskSpec* task, const std::string& name, bool stage_in_job, const std::string& stage,
             const std::string& output, const std::string& artifact) {
  if (stage_in_job) {
    AddStageOutputs(task, name, stage, output);
  } else {
    AddArtifact(task, name, artifact);
  }
}

pb::TaskSpec* AddTask(pb::JobSpec* job, const std::string& name, const std::string& stage,
                      const std::string& kind, const google::protobuf::MessageLite& payload) {
  pb::TaskSpec* task = job->add_tasks();
  task->set_name(name);
  task->set_stage(stage);
  task->set_kind(kind);
  payload.SerializeToString(task->mutable_payload());
  return task;
}

std::string Numbered(const std::string& stem, int number, int width = 3) {
  std::string digits = std::to_string(number);
  if (static_cast<int>(digits.size()) < width)
    digits.insert(0, static_cast<size_t>(width) - digits.size(), '0');
  return stem + "-" + digits;
}

pb::TrajectoriesPayload PairsPayload(const IterationOptions& options, uint64_t seed) {
  const TrajectoriesOptions& o = options.trajectories;
  pb::TrajectoriesPayload payload;
  payload.set_seed(seed);
  payload.set_duration_s(o.duration_s);
  payload.set_reach(o.reach);
  payload.set_spread(o.spread);
  payload.mutable_home()->Assign(options.home.begin(), options.home.end());
  payload.mutable_peak_torque()->Assign(options.peak_torque.begin(), options.peak_torque.end());
  return payload;
}

std::string OfSo(const char* stem, int number, int count) {
  return count == 1 ? stem : std::string(stem) + " " + std::to_string(number) + "/" + std::to_string(count);
}
// Rounds of aggregation after the first examination, each followed by another; they do nothing once one is passed.
int FurtherRounds(const TrainOptions& o) { return o.examination_pairs > 0 ? kFurtherAggregations : 0; }
int AllRounds(const TrainOptions& o) { return o.aggregations + FurtherRounds(o); }
// Policies before the last are stages of their own: their drivers' answers train the next.
std::string PolicyStage(const TrainOptions& o, int round) {
  return OfSo(kStagePolicy, round + 1, AllRounds(o) + 1);
}
std::string LastPolicyStage(const TrainOptions& o) { return PolicyStage(o, AllRounds(o)); }
std::string AggregateStage(const TrainOptions& o, int round) {
  return OfSo(kStageAggregate, round + 1, AllRounds(o));
}
// Of the policy trained after `round` rounds.
std::string ExamineStage(const TrainOptions& o, int round) {
  return OfSo(kStageExamine, round - o.aggregations + 1, FurtherRounds(o) + 1);
}
std::string LastExamineStage(const TrainOptions& o) { return ExamineStage(o, AllRounds(o)); }
bool IsFurther(const TrainOptions& o, int round) { return round > o.aggregations; }

// What a task of a further round reads to know whether it has anything to do.
void AddExamination(const TrainOptions& o, int round, pb::TaskSpec* task) {
  if (IsFurther(o, round)) AddStageOutputs(task, kInputExamination, ExamineStage(o, round - 1), kOutputExamination);
}

// One shard's task after another; `kind` and `stage` tell the expert's own from the answers to a policy.
std::vector<pb::TaskSpec*> AppendShards(const TrajectoriesOptions& o, pb::TrajectoriesPayload payload,
                                        const std::string& stem, const std::string& stage, const char* kind,
                                        const std::string& model, pb::JobSpec* job) {
  std::vector<pb::TaskSpec*> tasks;
  for (int first = 0; first < o.count; first += o.shard_size) {
    payload.set_first(static_cast<uint64_t>(first));
    payload.set_count(static_cast<uint32_t>(std::min(o.shard_size, o.count - first)));
    pb::TaskSpec* task = AddTask(job, Numbered(stem, first / o.shard_size), stage, kind, payload);
    task->set_weight(payload.count());
    AddArtifact(task, kInputModel, model);
    tasks.push_back(task);
  }
  return tasks;
}

void AppendTrajectories(const IterationOptions& options, const IterationInputs& inputs, pb::JobSpec* job) {
  AppendShards(options.trajectories, PairsPayload(options, options.seed), "trajectories", kStageTrajectories,
               kKindTrajectories, inputs.model, job);
}

// Seeds of a job's own beside options.seed: pairs that the expert's trajectories do not use.
uint64_t DerivedSeed(const IterationOptions& options, uint64_t which) {
  return Rng(options.seed).Split(0x706f6c696379).Split(which).Next() >> 1;
}

void AppendTrain(const IterationOptions& options, const IterationInputs& inputs, int round,
                 pb::JobSpec* job) {
  pb::TrainPayload payload;
  payload.set_seed(options.seed);
  const bool driver = round < options.train.aggregations;
  const bool last = round == AllRounds(options.train);
  const double share = driver ? kDriverEpochs : 1.0;
  const int epochs = std::max(1, static_cast<int>(std::lround(share * options.train.epochs)));
  payload.set_epochs(static_cast<uint32_t>(epochs));
  payload.set_batch(static_cast<uint32_t>(options.train.batch));
  payload.set_learning_rate(options.train.learning_rate);
  for (int width : options.train.hidden) payload.add_hidden(static_cast<uint32_t>(width));
  const std::string stage = PolicyStage(options.train, round);
  pb::TaskSpec* task =
      AddTask(job, last ? "policy" : Numbered("policy", round, 1), stage, kKindTrain, payload);
  task->set_weight(0.02 * epochs * std::max(1, options.trajectories.count) * (round + 1) / 45.0);
  AddArtifact(task, kInputModel, inputs.model);
  if (inputs.shards.empty()) {
    AddStageOutputs(task, kInputShard, kStageTrajectories, kOutputShard);
  } else {
    for (const std::string& shard : inputs.shards) AddArtifact(task, kInputShard, shard);
  }
  for (int r = 0; r < round; ++r)
    AddStageOutputs(task, kInputShard, AggregateStage(options.train, r), kOutputShard);
  AddExamination(options.train, round, task);
  if (IsFurther(options.train, round))
    AddStageOutputs(task, kInputPolicy, PolicyStage(options.train, round - 1), kOutputPolicy);
}

// The first policies are helped more: each round the expert drives half as often as in the one before.
void AppendAggregation(const IterationOptions& options, const IterationInputs& inputs, int round,
                       pb::JobSpec* job) {
  pb::TrajectoriesPayload payload = PairsPayload(options, DerivedSeed(options, static_cast<uint64_t>(round)));
  payload.set_expert_share(std::pow(0.5, round + 1));
  payload.set_hold_s(kHeldShare * options.trajectories.duration_s);
  TrajectoriesOptions pairs = options.trajectories;
  pairs.count = std::max(1, static_cast<int>(std::lround(kAggregatedPairs * pairs.count)));
  for (pb::TaskSpec* task : AppendShards(pairs, payload, "aggregate-" + std::to_string(round),
                                         AggregateStage(options.train, round), kKindAggregate, inputs.model, job)) {
    AddStageOutputs(task, kInputPolicy, PolicyStage(options.train, round), kOutputPolicy);
    AddExamination(options.train, round + 1, task);
  }
}

void AppendExamination(const IterationOptions& options, const IterationInputs& inputs, int round,
                       pb::JobSpec* job) {
  pb::TrajectoriesPayload payload = PairsPayload(options, DerivedSeed(options, 1000));
  payload.set_count(static_cast<uint32_t>(options.train.examination_pairs));
  const bool last = round == AllRounds(options.train);
  pb::TaskSpec* task = AddTask(job, last ? "examination" : Numbered("examination", round, 1),
                               ExamineStage(options.train, round), kKindExamine, payload);
  task->set_weight(payload.count());
  AddArtifact(task, kInputModel, inputs.model);
  AddStageOutputs(task, kInputPolicy, PolicyStage(options.train, round), kOutputPolicy);
  AddExamination(options.train, round, task);
}

void AppendPolicies(const IterationOptions& options, const IterationInputs& inputs, pb::JobSpec* job) {
  const int rounds = AllRounds(options.train);
  for (int round = 0; round <= rounds; ++round) {
    AppendTrain(options, inputs, round, job);
    if (options.train.examination_pairs > 0 && round >= options.train.aggregations)
      AppendExamination(options, inputs, round, job);
    if (round < rounds) AppendAggregation(options, inputs, round, job);
  }
}

void AppendRollout(const IterationOptions& options, const IterationInputs& inputs, bool whole_iteration,
                   pb::JobSpec* job) {
  const RolloutOptions& o = options.rollout;
  pb::RolloutPayload payload;
  payload.set_seed(options.seed);
  payload.set_robot(options.robot);
  payload.set_duration_s(o.duration_s);
  payload.set_rate_hz(o.rate_hz);
  payload.mutable_goal_q()->Assign(o.goal_q.begin(), o.goal_q.end());
  payload.mutable_goal_position()->Assign(o.goal_position.begin(), o.goal_position.end());
  payload.set_reach_s(o.reach_s);
  payload.set_controller(o.controller);
  if (o.excitation >= 0) payload.set_excitation(o.excitation);
  payload.set_slower_attempts(static_cast<uint32_t>(o.slower_attempts));
  payload.set_whole(!whole_iteration && !o.accept_partial);  // an iteration goes on with what there is
  payload.mutable_start_q()->Assign(options.home.begin(), options.home.end());
  payload.mutable_peak_torque()->Assign(options.peak_torque.begin(), options.peak_torque.end());
  pb::TaskSpec* task = AddTask(job, "rollout", kStageRollout, kKindRollout, payload);
  task->set_max_attempts(1);
  task->set_weight(20.0 * o.duration_s);
  task->add_required_tags("robot:" + options.robot);
  AddArtifact(task, kInputModel, inputs.model);
  if (o.controller == "trajectory") AddArtifact(task, kInputMotion, inputs.motion);
  if (o.controller == "policy")
    AddFrom(task, kInputPolicy, whole_iteration, LastPolicyStage(options.train), kOutputPolicy, inputs.policy);
  if (o.controller == "policy" && whole_iteration && options.train.examination_pairs > 0)
    AddStageOutputs(task, kInputExamination, LastExamineStage(options.train), kOutputExamination);
}

pb::IdentifyPayload IdentifyPayloadOf(const IterationOptions& options) {
  const IdentifyOptions& o = options.identify;
  pb::IdentifyPayload payload;
  payload.set_seed(options.seed);
  payload.set_chains(static_cast<uint32_t>(o.chains));
  payload.set_rounds(static_cast<uint32_t>(o.rounds));
  payload.set_budget_s(o.budget_s / o.rounds);
  payload.set_hops(o.hops == 0 ? 0u : static_cast<uint32_t>(std::max(1, (o.hops + o.rounds - 1) / o.rounds)));
  payload.set_window(o.whole_recording ? pb::IDENTIFY_WINDOW_WHOLE : pb::IDENTIFY_WINDOW_SINGLE);
  payload.set_solver(o.solver == "lbfgs" ? pb::IDENTIFY_SOLVER_LBFGS : pb::IDENTIFY_SOLVER_LM);
  payload.set_bounds(o.bounds == "paper"  ? pb::IDENTIFY_BOUNDS_PAPER
                     : o.bounds == "none" ? pb::IDENTIFY_BOUNDS_NONE
                                          : pb::IDENTIFY_BOUNDS_PHYSICAL);
  payload.set_parametrisation(o.parametrisation == "raw" ? pb::IDENTIFY_PARAMETRISATION_RAW
                                                         : pb::IDENTIFY_PARAMETRISATION_LOG_CHOLESKY);
  payload.set_window_s(o.window_s);
  payload.set_window_start_s(o.window_start_s);
  payload.set_alpha(o.alpha);
  payload.set_friction(o.friction);
  return payload;
}

// Identification of the model that was given, or of the one that this job's diagnosis made.
enum class Branch { kGiven, kDiagnosed };

std::string ChainTask(Branch branch, int chain, int round) {
  return Numbered(branch == Branch::kGiven ? "chain" : "refine", chain, 2) + "-round-" +
         std::to_string(round);
}
// Rounds are stages of their own, so that a later one can read all chains of the one before.
std::string RoundStage(Branch branch, const IdentifyOptions& o, int round) {
  return OfSo(branch == Branch::kGiven ? kStageIdentify : kStageRefine, round + 1, o.rounds);
}
std::string LastRoundStage(Branch branch, const IdentifyOptions& o) {
  return RoundStage(branch, o, o.rounds - 1);
}

// The model that identification alone goes on from.
const std::string& IdentifiedSoFar(const IterationInputs& inputs) {
  return inputs.identified.empty() ? inputs.model : inputs.identified;
}

void AppendIdentify(const IterationOptions& options, const IterationInputs& inputs, Branch branch,
                    bool recorded_here, pb::JobSpec* job) {
  const IdentifyOptions& o = options.identify;
  for (int round = 0; round < o.rounds; ++round) {
    for (int chain = 0; chain < o.chains; ++chain) {
      pb::IdentifyPayload payload = IdentifyPayloadOf(options);
      payload.set_round(static_cast<uint32_t>(round));
      payload.set_chain(static_cast<uint32_t>(chain));
      pb::TaskSpec* task =
          AddTask(job, ChainTask(branch, chain, round), RoundStage(branch, o, round), kKindIdentify, payload);
      task->set_weight(20.0 * std::max(1.0, payload.budget_s()));
      AddFrom(task, kInputModel, branch == Branch::kDiagnosed, kStageDiagnose, kOutputModel,
              IdentifiedSoFar(inputs));
      AddFrom(task, kInputRecording, recorded_here, kStageRollout, kOutputRecording, inputs.recording);
      if (round > 0) {
        AddTaskOutput(task, kInputChain, ChainTask(branch, chain, round - 1), kOutputChain);
        AddStageOutputs(task, kInputOthers, RoundStage(branch, o, round - 1), kOutputChain);
      }
    }
  }
}

void AppendConclude(const IterationOptions& options, const IterationInputs& inputs, bool whole_iteration,
                    pb::JobSpec* job) {
  pb::ConcludePayload payload;
  *payload.mutable_identify() = IdentifyPayloadOf(options);
  payload.set_robot(options.robot);
  payload.set_iteration(static_cast<uint32_t>(options.iteration));
  payload.set_accept_partial(options.rollout.accept_partial);
  pb::TaskSpec* task = AddTask(job, "conclusion", kStageConclude, kKindConclude, payload);
  task->set_weight(20.0);
  AddArtifact(task, kInputModel, IdentifiedSoFar(inputs));
  AddFrom(task, kInputRecording, whole_iteration, kStageRollout, kOutputRecording, inputs.recording);
  AddStageOutputs(task, kInputChain, LastRoundStage(Branch::kGiven, options.identify), kOutputChain);
  if (whole_iteration) {
    AddStageOutputs(task, kInputShard, kStageTrajectories, kOutputShard);
    AddStageOutputs(task, kInputPolicy, LastPolicyStage(options.train), kOutputPolicy);
    if (options.train.examination_pairs > 0)
      AddStageOutputs(task, kInputExamination, LastExamineStage(options.train), kOutputExamination);
  }
}

// The recordings of all rollouts, the one of this job last.
void AddRollouts(const IterationInputs& inputs, pb::TaskSpec* task) {
  for (const std::string& earlier : inputs.earlier) AddArtifact(task, kInputRecording, earlier);
  AddStageOutputs(task, kInputRecording, kStageRollout, kOutputRecording);
}

void AppendDiagnosis(const IterationOptions& options, const IterationInputs& inputs, pb::JobSpec* job) {
  pb::DiagnosePayload payload;
  payload.set_window_s(options.diagnosis.window_s);
  payload.set_seed(options.seed);
  payload.set_threads(static_cast<uint32_t>(options.diagnosis.threads));
  payload.set_work_limit(options.diagnosis.work_limit);
  payload.set_rollouts(true);
  pb::TaskSpec* task = AddTask(job, "diagnosis", kStageDiagnose, kKindDiagnose, payload);
  task->set_weight(20.0 * options.diagnosis.work_limit);
  AddArtifact(task, kInputModel, inputs.nominal);
  if (!inputs.diagnosed.empty()) AddArtifact(task, kInputDiagnosed, inputs.diagnosed);
  AddRollouts(inputs, task);
}

void AppendAdoption(const IterationOptions& options, const IterationInputs& inputs, pb::JobSpec* job) {
  pb::AdoptPayload payload;
  *payload.mutable_identify() = IdentifyPayloadOf(options);
  payload.set_robot(options.robot);
  payload.set_iteration(static_cast<uint32_t>(options.iteration));
  payload.set_accept_partial(options.rollout.accept_partial);
  pb::TaskSpec* task = AddTask(job, "adoption", kStageAdopt, kKindAdopt, payload);
  task->set_weight(20.0);
  AddArtifact(task, kInputNominal, inputs.nominal);
  AddArtifact(task, kInputModel, inputs.model);
  AddArtifact(task, kInputIdentifiedBefore, IdentifiedSoFar(inputs));
  if (!inputs.diagnosed.empty()) AddArtifact(task, kInputDiagnosedBefore, inputs.diagnosed);
  AddStageOutputs(task, kInputIdentified, kStageConclude, kOutputModel);
  AddStageOutputs(task, kInputResult, kStageConclude, kOutputResult);
  AddStageOutputs(task, kInputDiagnosis, kStageDiagnose, kOutputDiagnosis);
  AddStageOutputs(task, kInputDiagnosed, kStageDiagnose, kOutputModel);
  AddStageOutputs(task, kInputChain, LastRoundStage(Branch::kDiagnosed, options.identify), kOutputChain);
  AddRollouts(inputs, task);
}

json SpecJson(const IterationOptions& options) {
  json spec = OptionsToJson(options);
  spec["robot"] = options.robot;
  spec["iteration"] = options.iteration;
  return spec;
}

pb::JobSpec NewJob(const std::string& kind, const IterationOptions& options) {
  pb::JobSpec job;
  job.set_kind(kind);
  job.set_name(kind == "iteration" ? "iteration " + std::to_string(options.iteration) : kind);
  job.set_spec_json(SpecJson(options).dump());
  (*job.mutable_labels())["robot"] = options.robot;
  return job;
}

}  // namespace

double CurriculumShare(const CurriculumOptions& options, int iteration) {
  return options.on ? std::min(1.0, options.first * std::pow(options.growth, iteration - 1)) : 1.0;
}

Status Validate(const IterationOptions& o) {
  RG_RETURN_IF_ERROR(InRange("trajectories", o.trajectories.count, 1, 1000000));
  RG_RETURN_IF_ERROR(InRange("shard size", o.trajectories.shard_size, 1, 100000));
  RG_RETURN_IF_ERROR(InRange("trajectory duration [s]", o.trajectories.duration_s, 0.08, 60.0));
  RG_RETURN_IF_ERROR(InRange("reach", o.trajectories.reach, 0.01, 1.0));
  RG_RETURN_IF_ERROR(InRange("spread [rad]", o.trajectories.spread, 0.0, 1e3));
  RG_RETURN_IF_ERROR(InRange("epochs", o.train.epochs, 1, 100000));
  RG_RETURN_IF_ERROR(InRange("batch", o.train.batch, 1, 100000));
  RG_RETURN_IF_ERROR(InRange("aggregations", o.train.aggregations, 0, 100));
  RG_RETURN_IF_ERROR(InRange("examination pairs", o.train.examination_pairs, 0, 100000));
  RG_RETURN_IF_ERROR(InRange("curriculum's first share", o.curriculum.first, 0.01, 1.0));
  RG_RETURN_IF_ERROR(InRange("curriculum's growth", o.curriculum.growth, 1.0, 100.0));
  RG_RETURN_IF_ERROR(InRange("learning rate", o.train.learning_rate, 1e-7, 1.0));
  if (o.train.hidden.empty()) return InvalidError("hidden layers: none given, at least one is needed");
  for (int width : o.train.hidden) RG_RETURN_IF_ERROR(InRange("hidden layer width", width, 1, 4096));
  RG_RETURN_IF_ERROR(InRange("rollout duration [s]", o.rollout.duration_s, 0.2, 600.0));
  RG_RETURN_IF_ERROR(InRange("rollout rate [Hz]", o.rollout.rate_hz, 5.0, 1000.0));
  RG_RETURN_IF_ERROR(InRange("slower attempts", o.rollout.slower_attempts, 0, kMostSlowerAttempts));
  RG_RETURN_IF_ERROR(OneOf("controller", o.rollout.controller, {"policy", "mpc"}));
  if (o.rollout.excitation >= 0)
    RG_RETURN_IF_ERROR(InRange("excitation", o.rollout.excitation, 0.0, 1.0));
  if (!o.rollout.goal_q.empty() && !o.home.empty() && o.rollout.goal_q.size() != o.home.size()) {
    return InvalidError("goal has " + std::to_string(o.rollout.goal_q.size()) + " numbers, must have " +
                        std::to_string(o.home.size()) + ", one per joint");
  }
  for (double q : o.rollout.goal_q) RG_RETURN_IF_ERROR(InRange("goal [rad or m]", q, -1e3, 1e3));
  for (double x : o.rollout.goal_position) RG_RETURN_IF_ERROR(InRange("goal position [m]", x, -1e3, 1e3));
  if (!o.rollout.goal_position.empty() && o.rollout.goal_position.size() != 3) {
    return InvalidError("goal position has " + std::to_string(o.rollout.goal_position.size()) +
                        " numbers, must have 3 (x y z in m)");
  }
  RG_RETURN_IF_ERROR(InRange("chains", o.identify.chains, 1, 1000));
  RG_RETURN_IF_ERROR(InRange("rounds", o.identify.rounds, 1, 1000));
  RG_RETURN_IF_ERROR(InRange("identification budget [s]", o.identify.budget_s, 0.0, 1e6));
  RG_RETURN_IF_ERROR(InRange("hops", o.identify.hops, 0, 1000000));
  if (o.identify.budget_s == 0.0 && o.identify.hops == 0) {
    return InvalidError("identification has neither a budget in seconds nor a number of hops");
  }
  RG_RETURN_IF_ERROR(InRange("identification window [s]", o.identify.window_s, 0.0, 600.0));
  RG_RETURN_IF_ERROR(InRange("identification window start [s]", o.identify.window_start_s, 0.0, 600.0));
  RG_RETURN_IF_ERROR(InRange("alpha", o.identify.alpha, 0.0, 1e9));
  RG_RETURN_IF_ERROR(InRange("diagnosis work", o.diagnosis.work_limit, 1.0, 1e6));
  RG_RETURN_IF_ERROR(OneOf("solver", o.identify.solver, {"lm", "lbfgs"}));
  RG_RETURN_IF_ERROR(OneOf("bounds", o.identify.bounds, {"physical", "paper", "none"}));
  RG_RETURN_IF_ERROR(OneOf("parametrisation", o.identify.parametrisation, {"log-cholesky", "raw"}));
  return Status::Ok();
}

pb::JobSpec CompileIteration(const IterationOptions& given, const IterationInputs& inputs) {
  IterationOptions options = given;
  const double share = CurriculumShare(options.curriculum, options.iteration);
  options.trajectories.reach *= share;
  options.trajectories.spread *= share;
  options.rollout.reach_s *= share;
  pb::JobSpec job = NewJob("iteration", given);
  AppendTrajectories(options, inputs, &job);
  AppendPolicies(options, inputs, &job);
  AppendRollout(options, inputs, true, &job);
  AppendIdentify(options, inputs, Branch::kGiven, true, &job);
  AppendConclude(options, inputs, true, &job);
  if (options.diagnosis.on) {
    AppendDiagnosis(options, inputs, &job);
    AppendIdentify(options, inputs, Branch::kDiagnosed, true, &job);
    AppendAdoption(options, inputs, &job);
  }
  return job;
}

pb::JobSpec CompileTrajectories(const IterationOptions& options, const IterationInputs& inputs) {
  pb::JobSpec job = NewJob("trajectories", options);
  AppendTrajectories(options, inputs, &job);
  return job;
}

pb::JobSpec CompileTrain(const IterationOptions& options, const IterationInputs& inputs) {
  RG_CHECK(!inputs.shards.empty());
  pb::JobSpec job = NewJob("train", options);
  IterationOptions once = options;
  once.train.aggregations = once.train.examination_pairs = 0;
  AppendTrain(once, inputs, 0, &job);
  return job;
}

pb::JobSpec CompileRollout(const IterationOptions& options, const IterationInputs& inputs) {
  pb::JobSpec job = NewJob("rollout", options);
  AppendRollout(options, inputs, false, &job);
  return job;
}

pb::JobSpec CompileIdentify(const IterationOptions& options, const IterationInputs& inputs) {
  pb::JobSpec job = NewJob("identify", options);
  AppendIdentify(options, inputs, Branch::kGiven, false, &job);
  AppendConclude(options, inputs, false, &job);
  return job;
}

pb::JobSpec CompileDiagnose(const DiagnoseOptions& options, const std::string& set,
                            const std::string& model) {
  pb::JobSpec job;
  job.set_kind("diagnose");
  job.set_name("diagnose");
  job.set_spec_json(
      json{{"window_s", options.window_s},
           {"seed", options.seed},
           {"threads", options.threads},
           {"trust_effort", options.trust_effort}}
          .dump());
  pb::DiagnosePayload payload;
  payload.set_window_s(options.window_s);
  payload.set_seed(options.seed);
  payload.set_threads(static_cast<uint32_t>(options.threads));
  payload.set_trust_effort(options.trust_effort);
  pb::TaskSpec* task = AddTask(&job, "diagnosis", kStageDiagnose, kKindDiagnose, payload);
  AddArtifact(task, kInputRecording, set);
  if (!model.empty()) AddArtifact(task, kInputModel, model);
  return job;
}

const std::vector<std::string>& IterationStages() {
  static const std::vector<std::string> stages = {kStageTrajectories, kStagePolicy,   kStageExamine,
                                                  kStageRollout,      kStageIdentify, kStageConclude,
                                                  kStageDiagnose,     kStageRefine,   kStageAdopt};
  return stages;
}

}  // namespace rg::jobs
