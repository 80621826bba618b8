// `job describe`: everything about one job on one page.
#include <CLI/CLI.hpp>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "coordinator/client/client.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/job_selector.h"
#include "services/cli/job_view.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

constexpr size_t kEventsShown = 20;

struct Description {
  pb::GetJobReply job;
  std::vector<pb::JobSummary> children;
  std::vector<pb::EventRecord> events;
};

Result<Description> Ask(coordinator::Client& client, int64_t id) {
  Description out;
  RG_ASSIGN_OR_RETURN(out.job, client.GetJob(id, true, true));
  pb::ListJobsRequest children;
  children.set_parent_job(out.job.job().id());
  RG_ASSIGN_OR_RETURN(out.children, client.ListAllJobs(children));
  for (int64_t after = 0;;) {
    RG_ASSIGN_OR_RETURN(const auto page, client.Events(out.job.job().id(), after));
    if (page.empty()) return out;
    after = page.back().id();
    out.events.insert(out.events.end(), page.begin(), page.end());
  }
}

std::string Labels(const pb::JobSummary& job) {
  std::string text;
  for (const auto& [name, value] :
       std::map<std::string, std::string>(job.labels().begin(), job.labels().end()))
    text += (text.empty() ? "" : ", ") + name + (value.empty() ? "" : "=" + value);
  return text.empty() ? "–" : text;
}

// Attempts that did not end well, of every task.
std::string Troubles(const pb::GetJobReply& job) {
  TextTable table({"TASK", ">ATTEMPT", "WORKER", "ENDED", "WHY"});
  for (const pb::TaskInfo& task : job.tasks()) {
    for (const pb::AttemptInfo& attempt : task.attempt_list()) {
      if (attempt.outcome() == pb::ATTEMPT_OUTCOME_SUCCEEDED ||
          attempt.outcome() == pb::ATTEMPT_OUTCOME_UNSPECIFIED)
        continue;
      std::string outcome = pb::AttemptOutcome_Name(attempt.outcome()).substr(sizeof("ATTEMPT_OUTCOME_") - 1);
      for (char& c : outcome) c = static_cast<char>(c == '_' ? ' ' : std::tolower(c));
      table.AddRow({task.name(), std::to_string(attempt.number()), attempt.worker(),
                    TimeText(attempt.finished_ns()),
                    outcome + (attempt.error().empty() ? "" : ": " + attempt.error())});
    }
  }
  return table.empty() ? "" : "\nattempts that came to nothing\n" + table.ToString();
}

std::string Outputs(const pb::GetJobReply& job) {
  TextTable table({"TASK", "OUTPUT", "KIND", "ARTEFACT", ">BYTES"});
  for (const pb::TaskInfo& task : job.tasks()) {
    for (const pb::TaskOutput& output : task.outputs())
      table.AddRow({task.name(), output.name(), output.kind(), output.sha256().substr(0, 12),
                    std::to_string(output.size())});
  }
  return table.empty() ? "" : "\noutputs\n" + table.ToString();
}

std::string Events(const std::vector<pb::EventRecord>& events) {
  TextTable table({"TIME", "EVENT", "TASK", "WORKER", "DETAIL"});
  const size_t first = events.size() > kEventsShown ? events.size() - kEventsShown : 0;
  for (size_t i = first; i < events.size(); ++i)
    table.AddRow({TimeText(events[i].wall_ns()), events[i].kind(), events[i].task(), events[i].worker(),
                  events[i].detail()});
  if (table.empty()) return "";
  return "\nevents" + (first > 0 ? " (the last of " + std::to_string(events.size()) + ")" : std::string()) +
         "\n" + table.ToString();
}

std::string Text(const Description& d) {
  const pb::JobSummary& job = d.job.job();
  const json spec = json::parse(d.job.spec_json().empty() ? "null" : d.job.spec_json(), nullptr, false);
  std::string out = JobDetails(d.job, true);
  out += "\nname      " + (job.name().empty() ? "–" : job.name()) + "\npriority  " +
         std::to_string(job.priority()) + "\nlabels    " + Labels(job) + "\n";
  if (job.after_jobs_size() > 0) {
    out += "after     ";
    for (const int64_t id : job.after_jobs()) out += std::to_string(id) + " ";
    out += "\n";
  }
  if (job.time_limit_s() > 0.0)
    out += "limit     " + FormatSeconds(job.time_limit_s()) + ", until " + TimeText(job.deadline_ns()) + "\n";
  if (job.parent_job() != 0) out += "of job    " + std::to_string(job.parent_job()) + "\n";
  if (spec.is_object() && !spec.empty()) out += "asked for " + spec.dump() + "\n";
  out += Troubles(d.job) + Outputs(d.job);
  if (!d.children.empty()) out += "\njobs of its tasks\n" + JobsTable(d.children);
  return out + Events(d.events);
}

json Json(const Description& d) {
  json out = coordinator::JobDetailsJson(d.job, true);
  out["children"] = json::array();
  for (const auto& child : d.children) out["children"].push_back(coordinator::JobJson(child));
  out["events"] = json::array();
  for (const auto& e : d.events) out["events"].push_back(coordinator::EventJson(e));
  return out;
}

Status Describe(Context& context, const std::string& selector) {
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  RG_ASSIGN_OR_RETURN(const auto ids, ParseSelector(selector, *client));
  json all = json::array();
  for (const int64_t id : ids) {
    RG_ASSIGN_OR_RETURN(const Description description, Ask(*client, id));
    if (!context.json()) Print(Text(description));
    if (context.json()) all.push_back(Json(description));
  }
  const bool is_single = selector != "all" && ids.size() == 1;
  if (context.json())
    PrintJson(is_single ? "realitygrad.job/1" : "realitygrad.jobs/1",
              is_single ? all.front() : json{{"jobs", all}});
  return Status::Ok();
}

}  // namespace

void AddDescribeCommand(CLI::App& job, Context& context) {
  auto selector = std::make_shared<std::string>("last");
  CLI::App* command =
      job.add_subcommand("describe", "All about it: stages, tasks, failed attempts, outputs, events");
  command->add_option("ID", *selector, "5, 1-10, 1,3, all or last")->capture_default_str();
  command->callback([&context, selector] { context.Failed(Describe(context, *selector)); });
}

}  // namespace rg::cli
