#include "services/jobs/iteration_result.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "common/base/hash.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/identify_problem.h"
#include "services/jobs/kinds.h"
#include "services/jobs/task_support.h"
#include "services/rollouts/rollout_end.h"
#include "services/sysid/shooting_fit.h"

namespace rg::jobs {
namespace {

namespace pb = ::realitygrad::v1;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

constexpr double kJudgementWindow_s = 1.0;

json Numbers(const VectorXd& values) {
  return std::vector<double>(values.data(), values.data() + values.size());
}

json Rows(const MatrixXd& values) {
  json rows = json::array();
  for (Eigen::Index i = 0; i < values.rows(); ++i) rows.push_back(Numbers(values.row(i)));
  return rows;
}

json ErrorJson(const rollouts::SimulationError& e) {
  return {{"ok", e.ok},
          {"failure", e.failure},
          {"rows", e.rows},
          {"residual", e.residual},
          {"accumulated_tip_m", e.accumulated_tip_m},
          {"joint_rms", e.joint_rms},
          {"tip_rms_m", e.tip_rms_m},
          {"tip_max_m", e.tip_max_m},
          {"joint_rms_each", Numbers(e.joint_rms_each)}};
}

// Totals over the shards' metadata.
json TrajectoriesJson(const worker::TaskInput& input) {
  json total = {
      {"solved", 0}, {"failed", 0}, {"failures", json::object()}, {"samples", 0}, {"task_seconds", 0.0}};
  for (const worker::InputArtifact* shard : input.All(kInputShard)) {
    const json one = MetadataOf(*shard);
    for (const char* key : {"solved", "failed", "samples"})
      total[key] = total[key].get<int64_t>() + one.value(key, int64_t{0});
    total["task_seconds"] = total["task_seconds"].get<double>() + one.value("seconds", 0.0);
    const json failures = one.value("failures", json::object());
    for (const auto& [reason, count] : failures.items()) {
      total["failures"][reason] = total["failures"].value(reason, int64_t{0}) + count.get<int64_t>();
    }
  }
  return total;
}

json SaidOf(const worker::TaskInput& input, const char* name) {
  const worker::InputArtifact* artifact = input.Find(name);
  if (artifact == nullptr) return nullptr;
  json out = MetadataOf(*artifact);
  out["sha256"] = artifact->sha256;
  return out;
}

// The hops of all chains, by columns: when each ended (seconds that its chain had searched), where it began
// if at a point of the chain itself, its cost, whether it was accepted. Costs from hop `whole_from` on, if
// there is one, weigh the whole recording too: another scale. A hop that the clock cut is in `best_cost`
// alone.
json SearchJson(const worker::TaskInput& input) {
  json chains = json::array();
  for (const worker::InputArtifact* artifact : input.All(kInputChain)) {
    const auto state = sysid::ParseHopState(artifact->bytes);
    if (!state.ok() || !state->started()) continue;
    const json said = MetadataOf(*artifact);
    json chain = {{"chain", state->chain},
                  {"seconds", said.value("hop_seconds", json::array())},
                  {"whole_from", state->first_hop > 0 ? json(state->first_hop) : json()},
                  {"search_seconds", said.value("search_seconds", 0.0)},
                  {"best_cost", state->best_cost}};
    for (const char* column : {"start", "cost", "accepted"}) chain[column] = json::array();
    for (const sysid::HopRecord& hop : state->history) {
      chain["start"].push_back(hop.start);
      chain["cost"].push_back(hop.cost);
      chain["accepted"].push_back(hop.accepted);
    }
    chains.push_back(std::move(chain));
  }
  return chains;
}

json RolloutJson(const worker::TaskInput& input, bool accept_partial) {
  json out = SaidOf(input, kInputRecording);
  const rollouts::RolloutEnd end = rollouts::HowItEnded(out);
  out["ended"] = end.text, out["as_asked"] = end.as_asked, out["held_back"] = !end.as_asked && !accept_partial;
  return out;
}

// Links that could exist before the fit and cannot after it: parameters that move one by one may go there
// without the residual telling.
std::vector<std::string> NewlyImpossible(const sim::Plant& plant, const VectorXd& before,
                                         const VectorXd& after) {
  const auto link_of = [](const std::string& line) { return line.substr(0, line.find(':')); };
  std::set<std::string> were;
  for (const std::string& line : sysid::ImpossibleInertias(plant, before)) were.insert(link_of(line));
  std::vector<std::string> lines;
  for (std::string& line : sysid::ImpossibleInertias(plant, after)) {
    if (!were.contains(link_of(line))) lines.push_back(std::move(line));
  }
  return lines;
}

}  // namespace

Judgement Judge(const sim::ModelFile& before, const sim::Plant& plant, const VectorXd& after,
                const recordings::Recording& recording) {
  Judgement out;
  rollouts::SimulationScoreOptions whole, windows;
  windows.window_s = kJudgementWindow_s;
  out.before = rollouts::ScoreSimulation(before.plant, before.values, recording, whole);
  out.after = rollouts::ScoreSimulation(plant, after, recording, whole);
  out.before_windows = rollouts::ScoreSimulation(before.plant, before.values, recording, windows);
  out.after_windows = rollouts::ScoreSimulation(plant, after, recording, windows);
  out.t = recording.t;
  out.measured = recording.q;
  out.noise_variance = std::max(1e-10, out.after_windows.joint_rms * out.after_windows.joint_rms);
  return out;
}

sysid::IdentifiabilityReport Determine(const sim::Plant& plant, const IdentifyProblem& problem,
                                       const VectorXd& p, double noise_variance) {
  const sysid::LeastSquaresProblem& ls = problem.problem();
  VectorXd r(ls.residuals->num_residuals());
  sysid::RowMatrix jacobian(r.size(), p.size());
  if (!ls.residuals->Evaluate(p, {}, &r, &jacobian)) jacobian.setZero();
  const sysid::FitSpace space = problem.space();
  sysid::IdentifiabilityInput input = sysid::IdentifiabilityInputOf(
      space, p, sysid::InformationOf(jacobian / std::sqrt(noise_variance)));
  input.nominal = space.Parameters(ls.initial);
  sysid::IdentifiabilityReport report = sysid::Identify(input);
  report.warnings = NewlyImpossible(plant, problem.FullValues(ls.initial), problem.FullValues(p));
  return report;
}

json ResultJson(const worker::TaskInput& input, const pb::ConcludePayload& payload,
                const Judgement& judgement, const sysid::HopState& best,
                const sysid::IdentifiabilityReport& identified) {
  int hops = 0;
  for (const worker::InputArtifact* chain : input.All(kInputChain))
    hops += MetadataOf(*chain).value("hops", 0);
  return {{"format", "realitygrad.iteration/1"},
          {"iteration", payload.iteration()},
          {"robot", payload.robot()},
          {"trajectories", TrajectoriesJson(input)},
          {"policy", SaidOf(input, kInputPolicy)},
          {"examination", SaidOf(input, kInputExamination)},
          {"rollout", RolloutJson(input, payload.accept_partial())},
          {"identification",
           {{"chains", payload.identify().chains()},
            {"hops", hops},
            {"best_chain", best.chain},
            {"best_cost", best.best_cost},
            {"search", SearchJson(input)},
            {"before", ErrorJson(judgement.before)},
            {"after", ErrorJson(judgement.after)},
            {"before_windows", ErrorJson(judgement.before_windows)},
            {"after_windows", ErrorJson(judgement.after_windows)},
            {"window_s", kJudgementWindow_s},
            {"identifiability", sysid::IdentifiabilityToJson(identified)}}},
          {"series",
           {{"t", Numbers(judgement.t)},
            {"measured", Rows(judgement.measured)},
            {"before", Rows(judgement.before.position)},
            {"after", Rows(judgement.after.position)}}}};
}

std::string NoteRolloutEnd(const worker::InputArtifact& recording, bool accept_partial, json* metadata) {
  const rollouts::RolloutEnd end = rollouts::HowItEnded(recording.metadata_json);
  (*metadata)["rollout"] = end.text;
  (*metadata)["held_back"] = !end.as_asked && !accept_partial;
  if (end.as_asked) return "";
  return "rollout " + end.text + (accept_partial ? "; accepted" : "; its parameters are not current until promoted");
}

json SummaryOf(const json& result) {
  const json& id = result.at("identification");
  return {{"residual_before", id["before"]["residual"]},
          {"residual_after", id["after"]["residual"]},
          {"tip_before_m", id["before"]["accumulated_tip_m"]},
          {"tip_after_m", id["after"]["accumulated_tip_m"]},
          {"window_rms_before", id["before_windows"]["joint_rms"]},
          {"window_rms_after", id["after_windows"]["joint_rms"]}};
}

json ParametersJson(const sim::Plant& plant, const IdentifyProblem& problem, const VectorXd& values,
                    const sysid::IdentifiabilityReport& identified) {
  json rows = json::array();
  for (size_t i = 0; i < problem.parameters().size(); ++i) {
    const int index = problem.parameters()[i];
    const sysid::ParameterVerdict& verdict = identified.parameters[i];
    rows.push_back({{"name", plant.parameters()[index].name},
                    {"value", values[index]},
                    {"stddev", verdict.stddev},
                    {"unit", plant.parameters()[index].unit},
                    {"verdict", sysid::VerdictName(verdict.verdict)}});
  }
  return rows;
}

json ParametersMetadata(const worker::TaskInput& input, const pb::ConcludePayload& payload,
                        const sim::ModelFile& before, const Judgement& judgement,
                        const std::string& model_json, const IdentifyProblem& problem, const VectorXd& values,
                        const sysid::IdentifiabilityReport& identified) {
  json rows = json::array();
  for (const json& row : ParametersJson(before.plant, problem, values, identified)) {
    rows.push_back({{"name", row["name"]}, {"value", row["value"]}, {"stddev", row["stddev"]}});
  }
  return {{"robot", payload.robot()},
          {"source", "identified"},
          {"values", rows},
          {"residual_before", judgement.before.residual},
          {"residual_after", judgement.after.residual},
          {"parent_version", before.version},
          {"recording", input.Find(kInputRecording)->sha256},
          {"model", Sha256Hex(model_json)},
          {"note", "iteration " + std::to_string(payload.iteration())}};
}

}  // namespace rg::jobs
