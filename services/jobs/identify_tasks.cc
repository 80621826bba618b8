#include "services/jobs/identify_tasks.h"

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/base/clock.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/identify_problem.h"
#include "services/jobs/iteration_result.h"
#include "services/jobs/kinds.h"
#include "services/jobs/task_support.h"
#include "services/rollouts/recording_bundle.h"
#include "services/sysid/basin_hopping.h"

namespace rg::jobs {
namespace {

namespace pb = ::realitygrad::v1;
using Eigen::VectorXd;
using nlohmann::json;

Result<recordings::Recording> RecordingOf(const worker::TaskInput& input) {
  RG_ASSIGN_OR_RETURN(const worker::InputArtifact* artifact, input.Require(kInputRecording));
  const std::string name = "recording " + artifact->sha256.substr(0, 12);
  if (const Status rows = rollouts::CheckRows(artifact->bytes, rollouts::kLeastRows); !rows.ok())
    return rows.WithPrefix(name);
  auto set = rollouts::LoadBundleOfWholeTorques(artifact->bytes);
  if (!set.ok()) return set.status().WithPrefix(name);
  return set->recordings.front();
}

Result<sysid::HopState> StateFrom(const worker::InputArtifact& artifact) {
  auto state = sysid::ParseHopState(artifact.bytes);
  if (!state.ok()) return state.status().WithPrefix("chain " + artifact.sha256.substr(0, 12));
  return state;
}

// Where this round begins: a checkpoint of it, the chain of the round before (which takes the others'
// best), or a new chain, of which the first begins where the regression says.
Result<sysid::HopState> StartOf(const worker::TaskInput& input, worker::TaskContext& context,
                                const pb::IdentifyPayload& payload, const sim::Plant& plant,
                                const recordings::Recording& recording, const IdentifyProblem& problem) {
  if (const std::string checkpoint = context.LoadCheckpoint(); !checkpoint.empty()) {
    auto state = sysid::ParseHopState(checkpoint);
    if (state.ok()) return state;
    context.Log("checkpoint ignored: " + state.status().message());
  }
  const worker::InputArtifact* own = input.Find(kInputChain);
  if (own == nullptr) {
    const int chain = static_cast<int>(payload.chain());
    if (chain > 0 || !OptionsOf(payload).regress) return sysid::StartChain(payload.seed(), chain);
    return sysid::StartChainAt(payload.seed(), chain, problem.Start(plant, recording),
                               std::numeric_limits<double>::max());
  }
  RG_ASSIGN_OR_RETURN(sysid::HopState state, StateFrom(*own));
  std::vector<sysid::HopState> others;
  for (const worker::InputArtifact* other : input.All(kInputOthers)) {
    RG_ASSIGN_OR_RETURN(sysid::HopState theirs, StateFrom(*other));
    others.push_back(std::move(theirs));
  }
  const int from = sysid::ExchangeAll(others, &state);
  if (from >= 0) context.Log("took the best of chain " + std::to_string(from));
  return state;
}

// The last round weighs long predictions too: its costs are on another scale than those that the chain
// brought along. False: the long prediction is not finite there.
bool Rescale(const IdentifyProblem& problem, sysid::HopState* state) {
  if (!state->started()) return false;
  double cost = 0.0;
  if (!sysid::EvaluateCost(problem.problem(), state->best, {}, &cost)) return false;
  sysid::ChangeCost(cost, state);
  return true;
}

// Before the last round but one a chain that may stop early only looks for what to tell the others: two hops
// of each of two chains are as likely to agree as four of one, in half the time.
constexpr int kHopsBeforeExchange = 2;

int MostHops(const pb::IdentifyPayload& payload) {
  if (payload.hops() > 0) return static_cast<int>(payload.hops());
  return payload.chains() > 1 && payload.round() + 2 < payload.rounds() ? kHopsBeforeExchange : 1 << 30;
}

// The time that a chain has searched, over all its rounds. It travels in the metadata, since a chain's bytes
// depend on its payload and inputs alone.
struct SearchTime {
  std::vector<double> hops;  // at which each ended
  double total = 0.0;
};

SearchTime TimeSoFar(const worker::InputArtifact* own) {
  if (own == nullptr) return {};
  const json said = MetadataOf(*own);
  return {said.value("hop_seconds", std::vector<double>()), said.value("search_seconds", 0.0)};
}

double Milliseconds(double seconds) { return std::round(1e3 * seconds) / 1e3; }

// Hops until the round's budget is spent, or hops agree before a budget of time is; a checkpoint after each.
sysid::HopState HopOn(const IdentifyProblem& problem, const pb::IdentifyPayload& payload,
                      sysid::HopState state, int first_hop, worker::TaskContext& context, SearchTime* time) {
  sysid::HopOptions options;
  options.solve.solver = SolverOf(payload);
  // A hop that no longer moves the cost's fifth digit has found its basin's floor: the next one tells more.
  options.solve.function_tolerance = 1e-5;
  const bool timed = payload.budget_s() > 0;
  const int hops = MostHops(payload);
  const double seconds = timed ? payload.budget_s() : 1e30;
  const double start = RealClock().SteadySeconds(), before = time->total;
  // When the hops of an attempt that was lost ended is not known: they count no time.
  time->hops.resize(static_cast<size_t>(state.hops), before);
  while (!context.cancelled()) {
    const double spent = RealClock().SteadySeconds() - start;
    const int done = state.hops - first_hop;
    if (done >= hops || spent >= seconds || (timed && sysid::Agrees(state))) break;
    // One hop, or what the clock leaves of it, between checkpoints.
    state = sysid::RunHops(problem.problem(), options, std::move(state), {1, seconds - spent}, RealClock(),
                           {}, &context.cancel_token());
    time->total = Milliseconds(before + RealClock().SteadySeconds() - start);
    time->hops.resize(static_cast<size_t>(state.hops), time->total);
    (void)context.SaveCheckpoint(sysid::SerializeHopState(state));
    char note[64];
    std::snprintf(note, sizeof note, "cost %.4g, %d hops", state.best_cost, state.hops);
    context.Progress({kStageIdentify,
                      timed ? std::min(seconds, RealClock().SteadySeconds() - start) : state.hops - first_hop,
                      timed ? seconds : hops, note});
  }
  return state;
}

}  // namespace

Result<worker::TaskOutputs> RunIdentify(const worker::TaskInput& input, worker::TaskContext& context) {
  const double start = RealClock().SteadySeconds();
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::IdentifyPayload>(input));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile given, ModelOf(input));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, ModelToFit(given, OptionsOf(payload)));
  RG_ASSIGN_OR_RETURN(const recordings::Recording recording, RecordingOf(input));
  RG_ASSIGN_OR_RETURN(IdentifyProblem problem,
                      IdentifyProblem::Create(model.plant, model.values, recording, OptionsOf(payload)));
  const worker::InputArtifact* own = input.Find(kInputChain);
  int first_hop = 0;
  if (own != nullptr) {
    RG_ASSIGN_OR_RETURN(const sysid::HopState before, StateFrom(*own));
    first_hop = before.hops;
  }
  RG_ASSIGN_OR_RETURN(sysid::HopState state,
                      StartOf(input, context, payload, model.plant, recording, problem));
  if (problem.long_weight() > 0 && !Rescale(problem, &state)) {
    context.Log("the whole recording cannot be simulated from the best so far: windows only");
    IdentifyProblemOptions options = OptionsOf(payload);
    options.long_weight = 0.0;
    RG_ASSIGN_OR_RETURN(problem, IdentifyProblem::Create(model.plant, model.values, recording, options));
  }
  SearchTime time = TimeSoFar(own);
  state = HopOn(problem, payload, std::move(state), first_hop, context, &time);
  if (context.cancelled()) return CancelledError("identification was cancelled");
  const json summary = {{"chain", state.chain},
                        {"hops", state.hops},
                        {"best_cost", state.best_cost},
                        {"windows", problem.windows()},
                        {"seconds", RealClock().SteadySeconds() - start}};
  json metadata = summary;
  metadata["hop_seconds"] = time.hops, metadata["search_seconds"] = time.total;
  worker::TaskOutputs outputs;
  outputs.artifacts.push_back(
      {kOutputChain, kArtifactHopState, sysid::SerializeHopState(state), metadata.dump()});
  outputs.summary_json = summary.dump();
  return outputs;
}

IdentifyProblemOptions LastRoundOf(const pb::IdentifyPayload& payload) {
  pb::IdentifyPayload last = payload;
  last.set_round(payload.rounds() - 1);
  return OptionsOf(last);
}

// Chains may have ended on different costs (see Rescale).
Result<sysid::HopState> BestChain(const worker::TaskInput& input, const IdentifyProblem& problem) {
  std::optional<sysid::HopState> best;
  for (const worker::InputArtifact* artifact : input.All(kInputChain)) {
    RG_ASSIGN_OR_RETURN(sysid::HopState state, StateFrom(*artifact));
    if (state.started() && !Rescale(problem, &state)) state.best_cost += 1e9;
    if (state.started() && (!best || state.best_cost < best->best_cost)) best = std::move(state);
  }
  if (!best) return FailedPreconditionError("no chain found parameters that can be simulated");
  return *best;
}

Result<worker::TaskOutputs> RunConclude(const worker::TaskInput& input, worker::TaskContext& context) {
  RG_ASSIGN_OR_RETURN(const auto payload, ParsePayload<pb::ConcludePayload>(input));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile given, ModelOf(input));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, ModelToFit(given, OptionsOf(payload.identify())));
  RG_ASSIGN_OR_RETURN(const recordings::Recording recording, RecordingOf(input));
  RG_ASSIGN_OR_RETURN(
      const IdentifyProblem problem,
      IdentifyProblem::Create(model.plant, model.values, recording, LastRoundOf(payload.identify())));
  RG_ASSIGN_OR_RETURN(const sysid::HopState best, BestChain(input, problem));
  const VectorXd after = problem.FullValues(best.best);
  context.Progress({kStageConclude, 0, 2, "judging before and after"});
  const Judgement judgement = Judge(given, model.plant, after, recording);
  context.Progress({kStageConclude, 1, 2, "what the data determine"});
  const sysid::IdentifiabilityReport identified =
      Determine(model.plant, problem, best.best, judgement.noise_variance);
  const std::string model_json = sim::ModelToJson(model.plant, after, model.version + 1);
  const json result = ResultJson(input, payload, judgement, best, identified);

  worker::TaskOutputs outputs;
  outputs.artifacts.push_back(
      {kOutputModel, kArtifactModel, model_json, json{{"robot", payload.robot()}}.dump()});
  json metadata = ParametersMetadata(input, payload, model, judgement, model_json, problem, after, identified);
  outputs.remark = NoteRolloutEnd(*input.Find(kInputRecording), payload.accept_partial(), &metadata);
  outputs.artifacts.push_back({kOutputParameters, kArtifactParameters,
                               ParametersJson(model.plant, problem, after, identified).dump(), metadata.dump()});
  outputs.artifacts.push_back(
      {kOutputResult, kArtifactResult, result.dump(), json{{"robot", payload.robot()}}.dump()});
  outputs.summary_json = SummaryOf(result).dump();
  return outputs;
}

}  // namespace rg::jobs
