#include "coordinator/client/as_json.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "realitygrad/v1/parameters.pb.h"

namespace rg::coordinator {

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

template <class Number>
json NullFor(Number nothing, Number value) {
  return value == nothing ? json(nullptr) : json(value);
}

// Text that is no JSON is given as text.
json Parsed(const std::string& text) {
  json value = json::parse(text.empty() ? "null" : text, nullptr, false);
  return value.is_discarded() ? json(text) : value;
}

template <class T>
std::vector<T> List(const auto& repeated) {
  return {repeated.begin(), repeated.end()};
}

std::string ProgressText(const pb::TaskProgress& progress) {
  if (progress.stage().empty() && progress.total() <= 0) return progress.note();
  char numbers[64] = "";
  if (progress.total() > 0)
    std::snprintf(numbers, sizeof numbers, " %.4g/%.4g", progress.done(), progress.total());
  return progress.stage() + numbers + (progress.note().empty() ? "" : ", " + progress.note());
}

json StageJson(const pb::StageInfo& stage, int64_t wall_ns) {
  return {{"name", stage.name()},
          {"total", stage.total()},
          {"done", stage.done()},
          {"running", stage.running()},
          {"failed", stage.failed()},
          {"progress", stage.progress()},
          {"note", ProgressText(stage.latest())},
          {"started", TimeJson(stage.started_ns())},
          {"finished", TimeJson(stage.finished_ns())},
          {"seconds", SecondsJson(stage.started_ns(), stage.finished_ns(), wall_ns)}};
}

json TaskJson(const pb::TaskInfo& task, int64_t wall_ns) {
  json outputs = json::array();
  for (const pb::TaskOutput& output : task.outputs())
    outputs.push_back({{"name", output.name()},
                       {"kind", output.kind()},
                       {"sha256", output.sha256()},
                       {"size", output.size()}});
  return {{"name", task.name()},
          {"stage", task.stage()},
          {"kind", task.kind()},
          {"state", TaskStateText(task.state())},
          {"reason", task.reason()},
          {"attempts", task.attempts()},
          {"worker", WorkerOf(task)},
          {"progress", ProgressText(task.progress())},
          {"started", TimeJson(task.started_ns())},
          {"finished", TimeJson(task.finished_ns())},
          {"seconds", SecondsJson(task.started_ns(), task.finished_ns(), wall_ns)},
          {"outputs", outputs}};
}

}  // namespace

std::string JobStateText(int state) {
  return Lower(pb::JobState_Name(static_cast<pb::JobState>(state)), sizeof("JOB_STATE_") - 1);
}
std::string TaskStateText(int state) {
  return Lower(pb::TaskState_Name(static_cast<pb::TaskState>(state)), sizeof("TASK_STATE_") - 1);
}

Who WhoOf(const std::string& submitted_by) {
  const size_t at = submitted_by.find(" (");
  if (at == std::string::npos || submitted_by.back() != ')') return {submitted_by, ""};
  return {submitted_by.substr(0, at), submitted_by.substr(at + 2, submitted_by.size() - at - 3)};
}

json SecondsJson(int64_t from_ns, int64_t to_ns, int64_t now_ns) {
  if (from_ns == 0) return nullptr;
  return std::max(0.0, 1e-9 * static_cast<double>((to_ns == 0 ? now_ns : to_ns) - from_ns));
}

json JobJson(const pb::JobSummary& job, int64_t wall_ns) {
  return {{"id", job.id()},
          {"kind", job.kind()},
          {"name", job.name()},
          {"state", JobStateText(job.state())},
          {"reason", job.reason()},
          {"submitted_by", WhoOf(job.submitted_by()).name},
          {"submitted_from", WhoOf(job.submitted_by()).remark},
          {"priority", job.priority()},
          {"parent_job", NullFor<int64_t>(0, job.parent_job())},
          {"labels", std::map<std::string, std::string>(job.labels().begin(), job.labels().end())},
          {"after", List<int64_t>(job.after_jobs())},
          {"waits_for", List<int64_t>(job.waits_for())},
          {"time_limit_s", NullFor(0.0, job.time_limit_s())},
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

json JobDetailsJson(const pb::GetJobReply& reply, bool with_summaries, int64_t wall_ns) {
  json out = JobJson(reply.job(), wall_ns);
  out["spec"] = Parsed(reply.spec_json());
  const double best = BestResidual(reply);
  out["best_residual"] = std::isnan(best) ? json(nullptr) : json(best);
  out["stages"] = json::array();
  for (const pb::StageInfo& stage : reply.stages()) out["stages"].push_back(StageJson(stage, wall_ns));
  out["task_list"] = json::array();
  for (const pb::TaskInfo& task : reply.tasks()) {
    out["task_list"].push_back(TaskJson(task, wall_ns));
    if (with_summaries) out["task_list"].back()["summary"] = Parsed(task.summary_json());
  }
  return out;
}

double BestResidual(const pb::GetJobReply& reply) {
  std::map<std::string, int> place;
  for (const pb::StageInfo& stage : reply.stages())
    place.emplace(stage.name(), static_cast<int>(place.size()));
  int newest = -1;
  double best = std::nan("");
  for (const pb::TaskInfo& task : reply.tasks()) {
    const json summary = Parsed(task.summary_json());
    const auto stage = place.find(task.stage());
    if (!summary.is_object() || !summary.contains("best_cost") || !summary["best_cost"].is_number() ||
        stage == place.end() || stage->second < newest)
      continue;
    const double cost = summary["best_cost"];
    best = stage->second > newest ? cost : std::min(best, cost);
    newest = stage->second;
  }
  return best;
}

const std::string& WorkerOf(const pb::TaskInfo& task) {
  const int attempts = task.attempt_list_size();
  return task.worker().empty() && attempts > 0 ? task.attempt_list(attempts - 1).worker() : task.worker();
}

json WorkerJson(const pb::WorkerInfo& worker) {
  return {{"name", worker.name()},
          {"host", worker.host()},
          {"pid", worker.pid()},
          {"tags", List<std::string>(worker.tags())},
          {"kinds", List<std::string>(worker.kinds())},
          {"slots", worker.slots()},
          {"busy", worker.busy()},
          {"draining", worker.draining()},
          {"drain_reason", worker.drain_reason()},
          {"unable", worker.unable()},
          {"connected", worker.connected()},
          {"last_seen_s", worker.last_seen_s()},
          {"tasks_done", worker.tasks_done()},
          {"tasks_failed", worker.tasks_failed()},
          {"disk_free_bytes", worker.disk_free_bytes()},
          {"memory_free_bytes", worker.memory_free_bytes()},
          {"load", worker.load()},
          {"robot_state", worker.robot_state()},
          {"last_error", worker.last_error()}};
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
          {"task", event.task()},     {"job", NullFor<int64_t>(0, event.job())},
          {"worker", event.worker()}, {"event", event.kind()},
          {"detail", event.detail()}};
}

json ArtifactJson(const pb::ArtifactInfo& info) {
  json metadata = json::parse(info.metadata_json(), nullptr, false);
  return {{"sha256", info.sha256()},
          {"kind", info.kind()},
          {"size_bytes", info.size_bytes()},
          {"created", FormatWallTime(info.created_ns())},
          {"job", info.job_id()},
          {"task", info.task_id()},
          {"metadata", metadata.is_object() ? metadata : json::object()},
          {"parents", List<std::string>(info.parents())},
          {"pins", List<std::string>(info.pins())}};
}

std::string SourceText(int source) {
  return source == pb::PARAMETER_SOURCE_NOMINAL      ? "nominal"
         : source == pb::PARAMETER_SOURCE_IDENTIFIED ? "identified"
         : source == pb::PARAMETER_SOURCE_IMPORTED   ? "imported"
                                                     : "?";
}

json VersionJson(const pb::ParameterVersion& v) {
  json out = {{"robot", v.robot()},
              {"version", v.version()},
              {"parent", NullFor<int64_t>(0, v.parent_version())},
              {"source", SourceText(v.source())},
              {"recording", v.recording_sha256()},
              {"model", v.model_sha256()},
              {"residual_before", v.has_residual_before() ? json(v.residual_before()) : json(nullptr)},
              {"residual_after", v.has_residual_after() ? json(v.residual_after()) : json(nullptr)},
              {"created", FormatWallTime(v.created_ns())},
              {"job", v.job_id()},
              {"rollout", v.rollout()},
              {"held_back", v.held_back()},
              {"note", v.note()}};
  for (const auto& value : v.values())
    out["values"].push_back({{"name", value.name()},
                             {"value", value.value()},
                             {"stddev", value.has_stddev() ? json(value.stddev()) : json(nullptr)}});
  return out;
}

std::string Dump(const json& value) { return value.dump(-1, ' ', false, json::error_handler_t::replace); }

}  // namespace rg::coordinator
