#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <map>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/clock.h"
#include "coordinator/client/client.h"
#include "services/cli/archive_command.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/job_selector.h"
#include "services/cli/job_view.h"
#include "services/cli/live_view.h"
#include "services/cli/progress_display.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

struct JobArguments {
  std::string id = "last";
  std::string task, reason;
  bool tasks = false, plain = false, mine = false, others = false;
  int priority = 0;
  double timeout_s = -1.0;
};

struct ListArguments {
  int64_t of = 0;  // what tasks of this job submitted; 0: what clients did
  std::vector<std::string> states, labels;
  std::string since, by;
  bool mine = false;
  uint32_t limit = 100;
  int64_t before = 0;
  bool watch = false;
  double timeout_s = -1.0;
};

Result<pb::JobState> ParseJobState(const std::string& text) {
  std::string names;
  for (int state = pb::JobState_MIN + 1; state <= pb::JobState_MAX; ++state) {
    if (JobStateText(state) == text) return static_cast<pb::JobState>(state);
    names += (names.empty() ? "" : ", ") + JobStateText(state);
  }
  return InvalidError("--state '" + text + "': must be one of " + names);
}

// "90s", "15m", "36h", "7d": so long ago; or a day or moment in UTC: 2026-03-01, 2026-03-01T08:30:00.
Result<int64_t> ParseSince(const std::string& text) {
  double amount = 0.0;
  char unit = 0, rest = 0;
  const std::string units = "smhd";
  constexpr double kSeconds[] = {1.0, 60.0, 3600.0, 86400.0};
  if (std::sscanf(text.c_str(), "%lf%c%c", &amount, &unit, &rest) == 2 && amount >= 0.0 && amount < 1e8 &&
      units.find(unit) != std::string::npos) {
    return RealClock().WallNanos() - static_cast<int64_t>(1e9 * amount * kSeconds[units.find(unit)]);
  }
  for (const char* format : {"%Y-%m-%d", "%Y-%m-%dT%H:%M:%S", "%Y-%m-%dT%H:%M:%SZ"}) {
    std::tm moment{};
    const char* end = strptime(text.c_str(), format, &moment);
    constexpr int64_t kNanos = 1'000'000'000, kLast = INT64_MAX / kNanos;  // 2262
    if (end != nullptr && *end == 0) return std::clamp<int64_t>(timegm(&moment), 0, kLast) * kNanos;
  }
  return InvalidError(
      "--since '" + text +
      "': must be a time ago (90s, 15m, 36h, 7d) or a moment (2026-03-01, 2026-03-01T08:30:00)");
}

Result<pb::ListJobsRequest> ListRequest(const ListArguments& arguments) {
  pb::ListJobsRequest request;
  request.set_parent_job(arguments.of);
  request.set_limit(arguments.limit);
  request.set_before_id(arguments.before);
  request.set_by(arguments.by);
  request.set_mine(arguments.mine);
  for (const std::string& text : arguments.states) {
    RG_ASSIGN_OR_RETURN(const pb::JobState state, ParseJobState(text));
    request.add_states(state);
  }
  for (const std::string& label : arguments.labels) {
    const size_t equals = label.find('=');
    if (equals == 0) return InvalidError("--label '" + label + "': must be NAME or NAME=VALUE");
    (*request.mutable_labels())[label.substr(0, equals)] =
        equals == std::string::npos ? "" : label.substr(equals + 1);
  }
  if (!arguments.since.empty()) {
    RG_ASSIGN_OR_RETURN(const int64_t since, ParseSince(arguments.since));
    request.set_since_ns(since);
  }
  return request;
}

std::string JobsText(const std::vector<pb::JobSummary>& jobs, const ListArguments& arguments) {
  const bool filtered = !arguments.states.empty() || !arguments.labels.empty() || !arguments.since.empty() ||
                        arguments.before != 0 || arguments.mine || !arguments.by.empty();
  return !jobs.empty()       ? JobsTable(jobs)
         : filtered          ? "no jobs"
         : arguments.of != 0 ? "no task of job " + std::to_string(arguments.of) + " submitted a job"
                             : "no jobs yet: submit one with `realitygrad submit iteration`";
}

void ShowJobs(const Context& context, const pb::ListJobsReply& reply, const ListArguments& arguments) {
  const std::vector<pb::JobSummary> jobs(reply.jobs().begin(), reply.jobs().end());
  if (context.quiet()) {
    for (const auto& job : jobs) Print(std::to_string(job.id()));
  } else if (context.json()) {
    json list = json::array();
    for (const auto& job : jobs) list.push_back(coordinator::JobJson(job));
    PrintJson("realitygrad.jobs/1", {{"jobs", list}, {"more", reply.more()}});
  } else {
    Print(JobsText(jobs, arguments));
    if (reply.more()) PrintNote("there are older ones: --before " + std::to_string(jobs.back().id()));
  }
}

// Shows the list again whenever it is another; on a terminal in its place, with JSON a line for each job that
// changed.
Status WatchJobs(const Context& context, coordinator::Client& client, const pb::ListJobsRequest& request,
                 const ListArguments& arguments) {
  const double end = RealClock().SteadySeconds() + arguments.timeout_s;
  std::map<int64_t, uint64_t> revisions;
  std::string shown;
  while (true) {
    RG_ASSIGN_OR_RETURN(const auto jobs, client.ListJobs(request));
    for (const auto& job : jobs) {
      const auto [known, is_new] = revisions.try_emplace(job.id(), job.revision());
      if (!is_new && known->second == job.revision()) continue;
      known->second = job.revision();
      if (context.json()) Print(coordinator::Dump(coordinator::JobJson(job)));
      if (context.quiet()) Print(std::to_string(job.id()));
    }
    const std::string text = JobsText(jobs, arguments);
    if (!context.json() && !context.quiet() && text != shown) {
      if (isatty(STDOUT_FILENO) == 1) std::fputs("\033[H\033[2J", stdout);
      Print(text);
      shown = text;
    }
    std::fflush(stdout);
    if (arguments.timeout_s >= 0 && RealClock().SteadySeconds() > end) return Status::Ok();
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
  }
}

void ListJobs(Context& context, const ListArguments& arguments) {
  const auto request = ListRequest(arguments);
  if (context.Failed(context.Usage(request.status()))) return;
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  if (arguments.watch) return context.Failed(WatchJobs(context, **client, *request, arguments)), void();
  const auto reply = (*client)->ListJobsReply(*request);
  if (!context.Failed(reply.status())) ShowJobs(context, *reply, arguments);
}

// Calls `body` for every job that `arguments.id` selects; "all" leaves out those in no `wanted` state.
// Of the exit codes the highest is kept. The JSON values that the bodies give become one: the value
// itself for a single job, else {"format": `plural`, "jobs": […]}.
template <class Body>
void WithJobs(Context& context, const JobArguments& arguments, const char* format, const char* plural,
              const Body& body, WantedState wanted = nullptr) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  const auto ids = ParseSelector(arguments.id, **client, wanted);
  if (context.Failed(ids.status())) return;
  json values = json::array();
  int code = kExitOk;
  for (const int64_t id : *ids) {
    json value = body(**client, id);
    if (!value.is_null()) values.push_back(std::move(value));
    code = std::max(code, context.exit_code);
  }
  context.exit_code = code;
  if (!context.json() || (values.empty() && code != kExitOk)) return;
  const bool single = arguments.id != "all" && ids->size() == 1;
  if (single) {
    PrintJson(format, values.front());
  } else {
    PrintJson(plural, {{"jobs", values}});
  }
}

void ShowJob(Context& context, const JobArguments& arguments) {
  const auto show = [&](coordinator::Client& client, int64_t id) -> json {
    const auto job = client.GetJob(id, true, true);
    if (context.Failed(job.status())) return nullptr;
    if (context.json()) return coordinator::JobDetailsJson(*job, true);
    if (context.quiet()) {
      Print(std::to_string(job->job().id()));
    } else {
      Print(JobDetails(*job, arguments.tasks || job->tasks_size() <= 12));
    }
    return nullptr;
  };
  WithJobs(context, arguments, "realitygrad.job/1", "realitygrad.jobs/1", show);
}

void WatchJob(Context& context, const JobArguments& arguments) {
  const auto watch = [&](coordinator::Client& client, int64_t id) -> json {
    const bool draws = !arguments.plain && !context.quiet() && StderrIsTerminal();
    const auto job = draws ? WatchLive(client, id, arguments.timeout_s)
                           : FollowJob(client, id, arguments.timeout_s, context.quiet());
    if (context.Failed(job.status())) return nullptr;
    context.exit_code = coordinator::ExitCodeOf(job->job().state());
    if (context.json()) return coordinator::JobDetailsJson(*job, true);
    if (!context.quiet()) Print(JobDetails(*job, false));
    return nullptr;
  };
  WithJobs(context, arguments, "realitygrad.job/1", "realitygrad.jobs/1", watch);
}

// The states in which `action` makes sense: what "all" stands for.
WantedState StatesFor(pb::JobAction action) {
  switch (action) {
    case pb::JOB_ACTION_RETRY:
      return [](pb::JobState s) { return s == pb::JOB_STATE_FAILED; };
    case pb::JOB_ACTION_RESUME:
      return [](pb::JobState s) { return s == pb::JOB_STATE_PAUSED; };
    case pb::JOB_ACTION_PAUSE:
      return [](pb::JobState s) { return s == pb::JOB_STATE_QUEUED || s == pb::JOB_STATE_RUNNING; };
    default:
      return [](pb::JobState s) {
        return s == pb::JOB_STATE_QUEUED || s == pb::JOB_STATE_RUNNING || s == pb::JOB_STATE_PAUSED;
      };
  }
}

// Whether the person at the terminal says so.
bool Confirmed(const std::string& question) {
  std::fprintf(stderr, "%s [y/N] ", question.c_str());
  const int answer = std::getchar();
  return answer == 'y' || answer == 'Y';
}

// What "all" stands for. Jobs of others are ended only where that is meant.
Result<std::vector<int64_t>> AllFor(coordinator::Client& client, const JobArguments& arguments, pb::JobAction action) {
  RG_ASSIGN_OR_RETURN(AllJobs all, SelectAll(client, StatesFor(action)));
  if (arguments.mine || all.others.empty()) return all.mine;
  if (action == pb::JOB_ACTION_CANCEL && !arguments.others) {
    std::string names;
    for (const std::string& name : all.names) names += (names.empty() ? "" : ", ") + name;
    const std::string whose = std::to_string(all.others.size()) + " of the " +
                              std::to_string(all.others.size() + all.mine.size()) + " jobs are others' (" + names + ")";
    if (isatty(STDIN_FILENO) != 1) return FailedPreconditionError(whose + ": --mine leaves them, --others cancels them too");
    if (!Confirmed(whose + ". Cancel them too?")) return all.mine;
  }
  all.mine.insert(all.mine.end(), all.others.begin(), all.others.end());
  return all.mine;
}

json ShowActedOn(const Context& context, const pb::JobSummary& job) {
  if (context.json()) return coordinator::JobJson(job);
  if (!context.quiet()) Print("job " + std::to_string(job.id()) + " is " + JobStateText(job.state()));
  return nullptr;
}

// In one transaction.
void ActOnMany(Context& context, coordinator::Client& client, const std::vector<int64_t>& ids,
               const JobArguments& arguments, pb::JobAction action) {
  const auto reply = client.ActOnMany(ids, action, arguments.reason);
  if (context.Failed(reply.status())) return;
  json values = json::array();
  for (int i = 0; i < reply->jobs_size(); ++i) {
    if (!reply->errors(i).empty()) {
      context.Failed(FailedPreconditionError(reply->errors(i)));
    } else if (json value = ShowActedOn(context, reply->jobs(i)); !value.is_null()) {
      values.push_back(std::move(value));
    }
  }
  if (context.json()) PrintJson("realitygrad.jobs/1", {{"jobs", values}});
}

void ActOnJob(Context& context, const JobArguments& arguments, pb::JobAction action) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  const bool is_all = arguments.id == "all";
  const auto ids = is_all ? AllFor(**client, arguments, action) : ParseSelector(arguments.id, **client);
  if (context.Failed(ids.status())) return;
  if (is_all || ids->size() != 1) return ActOnMany(context, **client, *ids, arguments, action);
  const auto job = (*client)->Act(ids->front(), action, arguments.reason);
  if (context.Failed(job.status())) return;
  const json value = ShowActedOn(context, *job);
  if (context.json()) PrintJson("realitygrad.job/1", value);
}

void SetPriority(Context& context, const JobArguments& arguments) {
  const auto set = [&](coordinator::Client& client, int64_t id) -> json {
    const auto job = client.SetPriority(id, arguments.priority);
    if (context.Failed(job.status())) return nullptr;
    if (context.json()) return coordinator::JobJson(*job);
    if (!context.quiet())
      Print("job " + std::to_string(job->id()) + " has priority " + std::to_string(job->priority()));
    return nullptr;
  };
  WithJobs(context, arguments, "realitygrad.job/1", "realitygrad.jobs/1", set,
           StatesFor(pb::JOB_ACTION_PRIORITY));
}

struct EventArguments {
  int64_t job = 0, after = 0;
  uint32_t limit = 0;
};

void ListEvents(Context& context, const EventArguments& arguments) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  json list = json::array();
  TextTable table({">ID", "TIME", ">JOB", "TASK", "WORKER", "EVENT", "DETAIL"});
  int64_t after = arguments.after;
  uint32_t count = 0;
  while (arguments.limit == 0 || count < arguments.limit) {
    const auto page =
        (*client)->Events(arguments.job, after, arguments.limit == 0 ? 0 : arguments.limit - count);
    if (context.Failed(page.status())) return;
    if (page->empty()) break;
    for (const pb::EventRecord& event : *page) {
      after = event.id();
      ++count;
      if (context.quiet()) Print(std::to_string(event.id()));
      if (context.json()) {
        list.push_back(coordinator::EventJson(event));
      } else {
        table.AddRow({std::to_string(event.id()), TimeText(event.wall_ns()),
                      event.job() == 0 ? "–" : std::to_string(event.job()), event.task(), event.worker(),
                      event.kind(), event.detail()});
      }
    }
  }
  if (context.json()) {
    PrintJson("realitygrad.events/1", {{"events", list}});
  } else if (!context.quiet()) {
    Print(table.empty() ? "nothing happened" : table.ToString());
  }
}

void Explain(Context& context, const JobArguments& arguments) {
  const auto explain = [&](coordinator::Client& client, int64_t id) -> json {
    const auto reply = client.Explain(id, arguments.task);
    if (context.Failed(reply.status())) return nullptr;
    if (!reply->placeable() && !reply->task().empty()) context.exit_code = kExitCannotPlace;
    if (context.json()) {
      return {{"task", reply->task()},
              {"state", TaskStateText(reply->state())},
              {"reasons", std::vector<std::string>(reply->reasons().begin(), reply->reasons().end())},
              {"placeable", reply->placeable()}};
    }
    Print(reply->task().empty() ? "nothing waits" : reply->task() + " is " + TaskStateText(reply->state()));
    for (const std::string& reason : reply->reasons()) Print("  " + reason);
    return nullptr;
  };
  WithJobs(context, arguments, "realitygrad.explain/1", "realitygrad.explain-jobs/1", explain);
}

void ListWorkers(Context& context) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  const auto workers = (*client)->Workers();
  if (context.Failed(workers.status())) return;
  if (context.quiet()) {
    for (const auto& worker : *workers) Print(worker.name());
  } else if (context.json()) {
    json list = json::array();
    for (const auto& worker : *workers) list.push_back(coordinator::WorkerJson(worker));
    PrintJson("realitygrad.workers/1", {{"workers", list}});
  } else {
    Print(workers->empty() ? "no workers: start one with `realitygrad worker`" : WorkersTable(*workers));
  }
}

void DrainWorker(Context& context, const std::string& name, const std::string& reason) {
  auto client = context.Connect();
  if (context.Failed(client.status()) || context.Failed((*client)->DrainWorker(name, reason))) return;
  if (!context.quiet()) PrintNote(name + " finishes what it runs and leaves");
}

}  // namespace

void AddJobCommands(CLI::App& app, Context& context) {
  CLI::App* jobs = app.add_subcommand("jobs", "List jobs");
  auto list = std::make_shared<ListArguments>();
  jobs->add_option("--of", list->of, "Those that tasks of this job submitted")->check(CLI::PositiveNumber);
  jobs->add_option("--state", list->states,
                   "queued, running, paused, succeeded, failed or cancelled; several");
  jobs->add_option("--label", list->labels, "NAME or NAME=VALUE; all of several");
  jobs->add_flag("--mine", list->mine, "Submitted with this key, or without keys by this user@host");
  jobs->add_option("--by", list->by, "Submitted by the key of this name");
  jobs->add_option("--since", list->since, "Submitted since: 90s, 15m, 36h, 7d ago, or 2026-03-01");
  jobs->add_option("--limit", list->limit, "At most so many, the newest")
      ->check(CLI::Range(1, 10'000))
      ->capture_default_str();
  jobs->add_option("--before", list->before, "Only jobs older than this one: the next page")
      ->check(CLI::PositiveNumber);
  AddArchiveCommand(jobs, context);
  CLI::Option* watch_jobs = jobs->add_flag("--watch", list->watch, "Go on: show what changes, until Ctrl-C");
  jobs->add_option("--timeout", list->timeout_s, "With --watch: seconds, then it ends")->needs(watch_jobs);
  jobs->callback([&context, list, jobs] {
    if (jobs->get_subcommands().empty()) ListJobs(context, *list);
  });

  CLI::App* events = app.add_subcommand("events", "What happened: submits, ends, losses, refusals");
  auto event_arguments = std::make_shared<EventArguments>();
  events->add_option("--job", event_arguments->job, "Only of this job")->check(CLI::PositiveNumber);
  events->add_option("--after", event_arguments->after, "Only later than the event of this id");
  events->add_option("--limit", event_arguments->limit, "At most so many, the oldest first (0: all)")
      ->capture_default_str();
  events->callback([&context, event_arguments] { ListEvents(context, *event_arguments); });
  app.add_subcommand("workers", "List workers and what they do")->callback([&context] {
    ListWorkers(context);
  });

  CLI::App* worker = app.add_subcommand("worker", "Run a worker (realitygrad worker --help), or drain one")
                         ->require_subcommand(1);
  auto name = std::make_shared<std::string>(), reason = std::make_shared<std::string>();
  CLI::App* drain = worker->add_subcommand("drain", "Let it finish what it runs and leave");
  drain->add_option("NAME", *name)->required();
  drain->add_option("--reason", *reason, "Shown with the worker");
  drain->callback([&context, name, reason] { DrainWorker(context, *name, *reason); });

  CLI::App* job = app.add_subcommand("job", "Look at one job, or act on it")->require_subcommand(1);
  const auto add = [&](const char* name, const char* help, auto function) {
    auto arguments = std::make_shared<JobArguments>();
    CLI::App* command = job->add_subcommand(name, help);
    command->add_option("ID", arguments->id, "5, 1-10, 1,3, all or last")->capture_default_str();
    command->callback([&context, arguments, function] { function(context, *arguments); });
    return std::pair{command, arguments};
  };
  auto [show, show_arguments] = add("show", "Stages, tasks and attempts", ShowJob);
  show->add_flag("--tasks", show_arguments->tasks, "List every task");
  for (const auto& [name, help] : {std::pair{"watch", "Follow its progress until it ends"},
                                   std::pair{"wait", "The same; the exit code says how it ended"}}) {
    auto [watch, watch_arguments] = add(name, help, WatchJob);
    watch->add_option("--timeout", watch_arguments->timeout_s, "Seconds to wait at the most");
    watch->add_flag("--plain", watch_arguments->plain, "A line for each stage, also on a terminal");
  }
  struct Act {
    const char *name, *help;
    pb::JobAction action;
  };
  for (const Act& act : {Act{"cancel", "Stop it for good", pb::JOB_ACTION_CANCEL},
                         Act{"pause", "Start nothing new", pb::JOB_ACTION_PAUSE},
                         Act{"resume", "Go on", pb::JOB_ACTION_RESUME},
                         Act{"retry", "Run failed tasks again (consent for those that may run only once)",
                             pb::JOB_ACTION_RETRY}}) {
    auto [command, arguments] =
        add(act.name, act.help,
            [action = act.action](Context& c, const JobArguments& a) { ActOnJob(c, a, action); });
    command->add_option("--reason", arguments->reason, "Kept with the job");
    command->add_flag("--mine", arguments->mine, "Of all: those of this key, or without keys of this user@host");
    command->add_flag("--others", arguments->others, "Of all: those of others too")->excludes("--mine");
  }
  auto [priority, priority_arguments] =
      add("priority", "Change when its turn comes: what has not started, and what its tasks submit", SetPriority);
  priority->get_option("ID")->required();
  priority->add_option("PRIORITY", priority_arguments->priority, "Higher first")->required();
  AddLogCommand(*job, context);
  AddDescribeCommand(*job, context);
  auto [explain, explain_arguments] = add("explain", "Why does it wait?", Explain);
  explain->add_option("--task", explain_arguments->task, "This task; default: the first that waits");
}

}  // namespace rg::cli
