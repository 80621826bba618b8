#include "services/cli/job_view.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/context.h"
#include "services/cli/progress_display.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

// "JOB_STATE_RUNNING" -> "running"
std::string Lower(std::string name, size_t prefix) {
  name.erase(0, prefix);
  std::transform(name.begin(), name.end(), name.begin(),
                 [](char c) { return static_cast<char>(std::tolower(c)); });
  return name;
}

json TimeJson(int64_t wall_ns) { return wall_ns == 0 ? json(nullptr) : json(FormatWallTime(wall_ns)); }

double Seconds(int64_t from_ns, int64_t to_ns) {
  if (from_ns == 0) return std::nan("");
  return 1e-9 * static_cast<double>((to_ns == 0 ? RealClock().WallNanos() : to_ns) - from_ns);
}

json Parsed(const std::string& text) {
  json value = json::parse(text.empty() ? "null" : text, nullptr, false);
  return value.is_discarded() ? json(text) : value;
}

std::string Percent(double fraction) { return std::to_string(std::lround(100 * fraction)) + " %"; }

std::string StagesTable(const pb::GetJobReply& job) {
  TextTable table({"STAGE", ">DONE", ">OF", ">RUNNING", ">FAILED", ">PROGRESS", ">SECONDS", "NOTE"});
  for (const pb::StageInfo& stage : job.stages()) {
    table.AddRow(
        {stage.name(), std::to_string(stage.done()), std::to_string(stage.total()),
         std::to_string(stage.running()), std::to_string(stage.failed()), Percent(stage.progress()),
         stage.started_ns() == 0 ? "–" : FormatSeconds(Seconds(stage.started_ns(), stage.finished_ns())),
         stage.latest().note()});
  }
  return table.ToString();
}

// Who runs it, or ran it last as far as the reply has attempts.
const std::string& WorkerOf(const pb::TaskInfo& task) {
  const int attempts = task.attempt_list_size();
  return task.worker().empty() && attempts > 0 ? task.attempt_list(attempts - 1).worker() : task.worker();
}

std::string TasksTable(const pb::GetJobReply& job) {
  TextTable table({"TASK", "STAGE", "STATE", ">ATTEMPTS", "WORKER", ">SECONDS", "REASON"});
  for (const pb::TaskInfo& task : job.tasks()) {
    table.AddRow(
        {task.name(), task.stage(), TaskStateText(task.state()), std::to_string(task.attempts()),
         WorkerOf(task),
         task.started_ns() == 0 ? "–" : FormatSeconds(Seconds(task.started_ns(), task.finished_ns())),
         task.reason()});
  }
  return table.ToString();
}

// The stage that people should see now: the first that is neither done nor untouched, else the first
// that is not done.
const pb::StageInfo* CurrentStage(const pb::GetJobReply& job) {
  for (const pb::StageInfo& stage : job.stages()) {
    if (stage.done() < stage.total()) return &stage;
  }
  return job.stages_size() ? &job.stages(job.stages_size() - 1) : nullptr;
}

ProgressUpdate UpdateOf(const pb::StageInfo& stage) {
  ProgressUpdate update{stage.name(), stage.progress() * 100.0, 100.0, stage.latest().note()};
  // A stage of many tasks is counted in tasks, but moves with the progress inside them.
  if (stage.total() > 1) {
    update.total = stage.total();
    update.done = std::round(10.0 * stage.progress() * stage.total()) / 10.0;
  } else if (stage.latest().total() > 0) {
    update.total = stage.latest().total();
    update.done = stage.done() == stage.total() ? update.total : stage.latest().done();
  }
  if (stage.failed() > 0) update.note = std::to_string(stage.failed()) + " failed  " + update.note;
  return update;
}

}  // namespace

std::string JobStateText(int state) {
  return Lower(pb::JobState_Name(static_cast<pb::JobState>(state)), sizeof("JOB_STATE_") - 1);
}
std::string TaskStateText(int state) {
  return Lower(pb::TaskState_Name(static_cast<pb::TaskState>(state)), sizeof("TASK_STATE_") - 1);
}
std::string TimeText(int64_t wall_ns) {
  return wall_ns == 0 ? "–" : FormatWallTime(wall_ns).substr(0, 19) + "Z";
}

Who WhoOf(const std::string& submitted_by) {
  const size_t at = submitted_by.find(" (");
  if (at == std::string::npos || submitted_by.back() != ')') return {submitted_by, ""};
  return {submitted_by.substr(0, at), submitted_by.substr(at + 2, submitted_by.size() - at - 3)};
}

json JobJson(const pb::JobSummary& job) {
  return {{"id", job.id()},
          {"kind", job.kind()},
          {"name", job.name()},
          {"state", JobStateText(job.state())},
          {"reason", job.reason()},
          {"submitted_by", WhoOf(job.submitted_by()).name},
          {"submitted_from", WhoOf(job.submitted_by()).remark},
          {"priority", job.priority()},
          {"after", std::vector<int64_t>(job.after_jobs().begin(), job.after_jobs().end())},
          {"waits_for", std::vector<int64_t>(job.waits_for().begin(), job.waits_for().end())},
          {"time_limit_s", job.time_limit_s() == 0.0 ? json(nullptr) : json(job.time_limit_s())},
          {"deadline", TimeJson(job.deadline_ns())},
          {"parent_job", job.parent_job() == 0 ? json(nullptr) : json(job.parent_job())},
          {"labels", std::map<std::string, std::string>(job.labels().begin(), job.labels().end())},
          {"submitted", TimeJson(job.submitted_ns())},
          {"started", TimeJson(job.started_ns())},
          {"finished", TimeJson(job.finished_ns())},
          {"tasks",
           {{"total", job.tasks_total()},
            {"done", job.tasks_done()},
            {"running", job.tasks_running()},
            {"failed", job.tasks_failed()}}},
          {"progress", job.progress()},
          {"eta_s", job.eta_s() < 0 ? json(nullptr) : json(job.eta_s())}};
}

json JobDetailsJson(const pb::GetJobReply& reply) {
  json out = JobJson(reply.job());
  out["spec"] = Parsed(reply.spec_json());
  out["stages"] = json::array();
  for (const pb::StageInfo& stage : reply.stages()) {
    out["stages"].push_back({{"name", stage.name()},
                             {"total", stage.total()},
                             {"done", stage.done()},
                             {"running", stage.running()},
                             {"failed", stage.failed()},
                             {"progress", stage.progress()},
                             {"started", TimeJson(stage.started_ns())},
                             {"finished", TimeJson(stage.finished_ns())}});
  }
  out["task_list"] = json::array();
  for (const pb::TaskInfo& task : reply.tasks()) {
    json outputs = json::array();
    for (const pb::TaskOutput& output : task.outputs()) {
      outputs.push_back({{"name", output.name()},
                         {"kind", output.kind()},
                         {"sha256", output.sha256()},
                         {"size", output.size()}});
    }
    out["task_list"].push_back({{"name", task.name()},
                                {"stage", task.stage()},
                                {"kind", task.kind()},
                                {"state", TaskStateText(task.state())},
                                {"reason", task.reason()},
                                {"attempts", task.attempts()},
                                {"worker", WorkerOf(task)},
                                {"started", TimeJson(task.started_ns())},
                                {"finished", TimeJson(task.finished_ns())},
                                {"summary", Parsed(task.summary_json())},
                                {"outputs", outputs}});
  }
  return out;
}

std::string JobsTable(const std::vector<pb::JobSummary>& jobs) {
  TextTable table({">ID", "KIND", "NAME", "STATE", ">PROGRESS", ">TASKS", ">ETA", "SUBMITTED", "BY", "REASON"});
  for (const pb::JobSummary& job : jobs) {
    table.AddRow({std::to_string(job.id()), job.kind(), job.name(), JobStateText(job.state()),
                  Percent(job.progress()),
                  std::to_string(job.tasks_done()) + "/" + std::to_string(job.tasks_total()),
                  job.finished_ns() != 0 || job.eta_s() < 0 ? "–" : FormatSeconds(job.eta_s()),
                  TimeText(job.submitted_ns()), WhoOf(job.submitted_by()).name, job.reason()});
  }
  return table.ToString();
}

std::string JobDetails(const pb::GetJobReply& reply, bool with_tasks) {
  const pb::JobSummary& job = reply.job();
  std::string out = "job " + std::to_string(job.id()) + "  " + job.kind() + "  " + JobStateText(job.state());
  if (!job.reason().empty()) out += "  (" + job.reason() + ")";
  out += "\nsubmitted " + TimeText(job.submitted_ns()) + " by " + job.submitted_by();
  if (job.started_ns() != 0) {
    out += job.finished_ns() != 0 ? ", took " : ", running for ";
    out += FormatSeconds(Seconds(job.started_ns(), job.finished_ns()));
  }
  for (int i = 0; i < job.waits_for_size(); ++i)
    out += (i == 0 ? ", comes after job " : ", ") + std::to_string(job.waits_for(i));
  if (job.finished_ns() == 0 && job.eta_s() >= 0) out += ", ETA " + FormatSeconds(job.eta_s());
  out += "\n\n" + StagesTable(reply);
  if (with_tasks) out += "\n" + TasksTable(reply);
  return out;
}

json WorkerJson(const pb::WorkerInfo& worker) {
  return {{"name", worker.name()},
          {"host", worker.host()},
          {"pid", worker.pid()},
          {"tags", std::vector<std::string>(worker.tags().begin(), worker.tags().end())},
          {"kinds", std::vector<std::string>(worker.kinds().begin(), worker.kinds().end())},
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

namespace {

constexpr size_t kErrorShown = 60;

std::string Tenths(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.1f", value);
  return text;
}
std::string Gib(uint64_t bytes) { return bytes == 0 ? "–" : Tenths(static_cast<double>(bytes) / (1 << 30)) + " GiB"; }

}  // namespace

std::string WorkersTable(const std::vector<pb::WorkerInfo>& workers) {
  std::string unable;
  TextTable table({"NAME", "HOST", "STATE", ">BUSY", ">SLOTS", ">DONE", ">FAILED", ">DISK", ">MEMORY", ">LOAD", ">SEEN", "TAGS", "LAST ERROR"});
  for (const pb::WorkerInfo& worker : workers) {
    std::string tags;
    for (const std::string& tag : worker.tags()) tags += (tags.empty() ? "" : ",") + tag;
    table.AddRow({worker.name(), worker.host(),
                  !worker.connected()         ? "lost"
                  : worker.draining()         ? "draining"
                  : !worker.unable().empty()  ? "unable"
                  : worker.busy()             ? "busy"
                                              : "idle",
                  std::to_string(worker.busy()), std::to_string(worker.slots()),
                  std::to_string(worker.tasks_done()), std::to_string(worker.tasks_failed()),
                  Gib(worker.disk_free_bytes()), Gib(worker.memory_free_bytes()), Tenths(worker.load()),
                  FormatSeconds(worker.last_seen_s()) + " ago", tags, worker.last_error().substr(0, kErrorShown)});
    if (!worker.drain_reason().empty()) unable += "\n" + worker.name() + " drains: " + worker.drain_reason() + "\n";
    if (!worker.unable().empty()) unable += "\n" + worker.name() + " can run nothing for now: " + worker.unable() + "\n";
  }
  return table.ToString() + unable;
}

Result<pb::GetJobReply> FollowJob(coordinator::Client& client, int64_t job, double timeout_s, bool quiet) {
  // One that is not there now is said to be so; one that goes away meanwhile is waited for.
  RG_RETURN_IF_ERROR(client.GetJob(job, false, false).status());
  ProgressDisplay display({.terminal = StderrIsTerminal(), .width = TerminalWidth(), .quiet = quiet},
                          RealClock());
  std::string shown;
  auto end = client.WaitForJob(job, timeout_s, [&](const pb::GetJobReply& now) {
    // Stages that ended between two looks are shown too, so that none is missing from the log.
    const pb::StageInfo* current = CurrentStage(now);
    bool passed = shown.empty();
    for (const pb::StageInfo& stage : now.stages()) {
      if (stage.name() == shown) passed = true;
      if (!passed || (stage.started_ns() == 0 && stage.done() == 0)) continue;
      display.Show(UpdateOf(stage));
      shown = stage.name();
      if (&stage == current) break;
    }
  });
  display.Finish();
  return end;
}

}  // namespace rg::cli
