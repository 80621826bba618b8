#include "services/cli/job_view.h"

#include <cmath>
#include <cstdio>

#include "common/base/clock.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/context.h"
#include "services/cli/progress_display.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;

double Seconds(int64_t from_ns, int64_t to_ns) {
  if (from_ns == 0) return std::nan("");
  return 1e-9 * static_cast<double>((to_ns == 0 ? RealClock().WallNanos() : to_ns) - from_ns);
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

std::string TasksTable(const pb::GetJobReply& job) {
  TextTable table({"TASK", "STAGE", "STATE", ">ATTEMPTS", "WORKER", ">SECONDS", "REASON"});
  for (const pb::TaskInfo& task : job.tasks()) {
    table.AddRow(
        {task.name(), task.stage(), TaskStateText(task.state()), std::to_string(task.attempts()),
         coordinator::WorkerOf(task),
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

std::string TimeText(int64_t wall_ns) {
  return wall_ns == 0 ? "–" : FormatWallTime(wall_ns).substr(0, 19) + "Z";
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
  ProgressDisplay display(quiet);
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
