#include "coordinator/web/feed_json.h"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "coordinator/web/metrics.h"

namespace rg::coordinator::web {

namespace pb = realitygrad::v1;
using nlohmann::json;

namespace {

// "JOB_STATE_RUNNING" -> "running"
std::string Lower(const std::string& name, size_t prefix) {
  std::string text = name.size() > prefix ? name.substr(prefix) : "?";
  std::transform(text.begin(), text.end(), text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

json TimeJson(int64_t wall_ns) { return wall_ns == 0 ? json(nullptr) : json(FormatWallTime(wall_ns)); }

json SecondsJson(int64_t from_ns, int64_t to_ns, int64_t now_ns) {
  if (from_ns == 0) return nullptr;
  return std::max(0.0, 1e-9 * static_cast<double>((to_ns == 0 ? now_ns : to_ns) - from_ns));
}

json Parsed(const std::string& text) { return json::parse(text.empty() ? "null" : text, nullptr, false); }

std::vector<std::string> Words(const google::protobuf::RepeatedPtrField<std::string>& words) {
  return {words.begin(), words.end()};
}

std::string ProgressText(const pb::TaskProgress& progress) {
  if (progress.stage().empty() && progress.total() <= 0) return progress.note();
  char numbers[64] = "";
  if (progress.total() > 0)
    std::snprintf(numbers, sizeof numbers, " %.4g/%.4g", progress.done(), progress.total());
  return progress.stage() + numbers + (progress.note().empty() ? "" : ", " + progress.note());
}

json TaskJson(const pb::TaskInfo& task, int64_t wall_ns) {
  json outputs = json::array();
  for (const pb::TaskOutput& output : task.outputs())
    outputs.push_back({{"name", output.name()}, {"kind", output.kind()}, {"sha256", output.sha256()}});
  return {{"name", task.name()},
          {"stage", task.stage()},
          {"kind", task.kind()},
          {"state", Lower(pb::TaskState_Name(task.state()), sizeof("TASK_STATE_") - 1)},
          {"reason", task.reason()},
          {"attempts", task.attempts()},
          {"worker", task.worker().empty() && task.attempt_list_size() > 0
                         ? task.attempt_list(task.attempt_list_size() - 1).worker()
                         : task.worker()},
          {"progress", ProgressText(task.progress())},
          {"seconds", SecondsJson(task.started_ns(), task.finished_ns(), wall_ns)},
          {"outputs", outputs}};
}

double NumberOr(const json& value, const char* key, double otherwise) {
  const auto found = value.is_object() ? value.find(key) : value.end();
  return value.is_object() && found != value.end() && found->is_number() ? found->get<double>() : otherwise;
}

json NumberOrNull(const json& value, const char* key) {
  const auto found = value.is_object() ? value.find(key) : value.end();
  return value.is_object() && found != value.end() && found->is_number() ? *found : json(nullptr);
}

std::string TextOf(const json& value, const char* key) {
  const auto found = value.is_object() ? value.find(key) : value.end();
  return value.is_object() && found != value.end() && found->is_string() ? found->get<std::string>() : "";
}

}  // namespace

json StatusJson(const pb::StatusReply& status, int64_t wall_ns) {
  json counters = json::object();
  for (const auto& [name, value] : status.counters()) counters[name] = value;
  return {{"instance", status.instance()},
          {"version", status.version()},
          {"database", status.database()},
          {"uptime_s", SecondsJson(status.started_ns(), 0, wall_ns)},
          {"workers", status.workers()},
          {"slots", status.slots()},
          {"slots_busy", status.slots_busy()},
          {"slots_wanted", SlotsWanted(status)},
          {"tasks_waiting", status.tasks_waiting()},
          {"tasks_ready", status.tasks_ready()},
          {"tasks_running", status.tasks_leased()},
          {"trouble", status.trouble()},
          {"counters", counters}};
}

json JobJson(const pb::JobSummary& job, int64_t wall_ns) {
  return {{"id", job.id()},
          {"kind", job.kind()},
          {"name", job.name()},
          {"state", Lower(pb::JobState_Name(job.state()), sizeof("JOB_STATE_") - 1)},
          {"reason", job.reason()},
          {"submitted_by", job.submitted_by()},
          {"priority", job.priority()},
          {"parent_job", job.parent_job() == 0 ? json(nullptr) : json(job.parent_job())},
          {"labels", std::map<std::string, std::string>(job.labels().begin(), job.labels().end())},
          {"waits_for", std::vector<int64_t>(job.waits_for().begin(), job.waits_for().end())},
          {"time_limit_s", job.time_limit_s()},
          {"deadline", TimeJson(job.deadline_ns())},
          {"submitted", TimeJson(job.submitted_ns())},
          {"started", TimeJson(job.started_ns())},
          {"finished", TimeJson(job.finished_ns())},
          {"waited_s", SecondsJson(job.submitted_ns(), job.started_ns(), wall_ns)},
          {"seconds", SecondsJson(job.started_ns(), job.finished_ns(), wall_ns)},
          {"tasks",
           {{"total", job.tasks_total()},
            {"done", job.tasks_done()},
            {"running", job.tasks_running()},
            {"failed", job.tasks_failed()}}},
          {"progress", job.progress()},
          {"eta_s", job.eta_s() < 0 ? json(nullptr) : json(job.eta_s())}};
}

json BestResidual(const pb::GetJobReply& reply) {
  std::map<std::string, int> place;
  for (const pb::StageInfo& stage : reply.stages())
    place.emplace(stage.name(), static_cast<int>(place.size()));
  constexpr double kNone = 1e300;
  int newest = -1;
  double best = kNone;
  for (const pb::TaskInfo& task : reply.tasks()) {
    const double cost = NumberOr(Parsed(task.summary_json()), "best_cost", kNone);
    const auto stage = place.find(task.stage());
    if (cost >= kNone || stage == place.end() || stage->second < newest) continue;
    best = stage->second > newest ? cost : std::min(best, cost);
    newest = stage->second;
  }
  return newest < 0 ? json(nullptr) : json(best);
}

json JobDetailsJson(const pb::GetJobReply& reply, int64_t wall_ns) {
  json out = JobJson(reply.job(), wall_ns);
  out["spec"] = Parsed(reply.spec_json());
  if (out["spec"].is_discarded()) out["spec"] = nullptr;
  out["best_residual"] = BestResidual(reply);
  out["stages"] = json::array();
  for (const pb::StageInfo& stage : reply.stages()) {
    out["stages"].push_back({{"name", stage.name()},
                             {"total", stage.total()},
                             {"done", stage.done()},
                             {"running", stage.running()},
                             {"failed", stage.failed()},
                             {"progress", stage.progress()},
                             {"note", ProgressText(stage.latest())},
                             {"seconds", SecondsJson(stage.started_ns(), stage.finished_ns(), wall_ns)}});
  }
  out["task_list"] = json::array();
  for (const pb::TaskInfo& task : reply.tasks()) out["task_list"].push_back(TaskJson(task, wall_ns));
  return out;
}

json WorkerJson(const pb::WorkerInfo& worker) {
  return {{"name", worker.name()},
          {"host", worker.host()},
          {"slots", worker.slots()},
          {"busy", worker.busy()},
          {"draining", worker.draining()},
          {"unable", worker.unable()},
          {"drain_reason", worker.drain_reason()},
          {"disk_free_gib", std::floor(10.0 * static_cast<double>(worker.disk_free_bytes()) / (1 << 30)) / 10.0},
          {"last_error", worker.last_error()},
          {"connected", worker.connected()},
          // A whole number while it is away: the page is drawn again where it changes.
          {"last_seen_s", worker.connected() ? 0.0 : std::floor(worker.last_seen_s())},
          {"tasks_done", worker.tasks_done()},
          {"tasks_failed", worker.tasks_failed()},
          {"tags", Words(worker.tags())}};
}

json LogLineJson(const pb::TaskLogLine& line) {
  return {{"time", FormatWallTime(line.wall_ns())},
          {"task", line.task()},
          {"attempt", line.attempt()},
          {"text", line.text()},
          {"sequence", line.sequence()}};
}

json EventJson(const pb::EventRecord& event) {
  return {{"id", event.id()},         {"time", FormatWallTime(event.wall_ns())},
          {"job", event.job()},       {"task", event.task()},
          {"worker", event.worker()}, {"event", event.kind()},
          {"detail", event.detail()}};
}

json ArtifactJson(const pb::ArtifactInfo& info) {
  json metadata = Parsed(info.metadata_json());
  return {{"sha256", info.sha256()},
          {"kind", info.kind()},
          {"size", info.size_bytes()},
          {"created", FormatWallTime(info.created_ns())},
          {"job", info.job_id()},
          {"pins", Words(info.pins())},
          {"metadata", metadata.is_object() ? metadata : json::object()}};
}

json VersionJson(const pb::ParameterVersion& v) {
  const char* source = v.source() == pb::PARAMETER_SOURCE_NOMINAL      ? "nominal"
                       : v.source() == pb::PARAMETER_SOURCE_IDENTIFIED ? "identified"
                       : v.source() == pb::PARAMETER_SOURCE_IMPORTED   ? "imported"
                                                                       : "?";
  return {{"version", v.version()},
          {"parent", v.parent_version() == 0 ? json(nullptr) : json(v.parent_version())},
          {"source", source},
          {"recording", v.recording_sha256()},
          {"model", v.model_sha256()},
          {"residual_before", v.has_residual_before() ? json(v.residual_before()) : json(nullptr)},
          {"residual_after", v.has_residual_after() ? json(v.residual_after()) : json(nullptr)},
          {"created", FormatWallTime(v.created_ns())},
          {"job", v.job_id()},
          {"rollout", v.rollout()},
          {"held_back", v.held_back()},
          {"note", v.note()}};
}

json DiagnosisJson(const std::string& bytes, const pb::ArtifactInfo& info) {
  const json file = Parsed(bytes);
  json findings = json::array();
  const json none = json::object();
  const json& list = file.is_object() && file.contains("findings") ? file["findings"] : none;
  for (const json& finding : list.is_array() ? list : json::array()) {
    json joints = json::array();
    if (finding.is_object() && finding.contains("joints") && finding["joints"].is_array()) {
      for (const json& joint : finding["joints"])
        if (joint.is_string()) joints.push_back(joint);
    }
    findings.push_back({{"effect", TextOf(finding, "effect")},
                        {"statement", TextOf(finding, "statement")},
                        {"joints", joints},
                        {"confidence", NumberOrNull(finding, "confidence")}});
  }
  const json& fit = file.is_object() && file.contains("fit") ? file["fit"] : none;
  const json& holdout = fit.is_object() && fit.contains("holdout") ? fit["holdout"] : none;
  return {{"sha256", info.sha256()},
          {"job", info.job_id()},
          {"created", FormatWallTime(info.created_ns())},
          {"verdict", TextOf(file, "verdict")},
          {"findings", findings},
          {"before", NumberOrNull(holdout, "before_rms")},
          {"after", NumberOrNull(holdout, "after_rms")}};
}

std::string Dump(const json& value) { return value.dump(-1, ' ', false, json::error_handler_t::replace); }

}  // namespace rg::coordinator::web
