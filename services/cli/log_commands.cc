// `job logs`: what tasks said.
#include <CLI/CLI.hpp>
#include <chrono>
#include <map>
#include <nlohmann/json.hpp>
#include <thread>

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

struct LogArguments {
  std::string id = "last", task;
  bool follow = false, previous = false;
  uint32_t tail = 0;
};

std::string LineText(const pb::TaskLogLine& line) {
  return FormatWallTime(line.wall_ns()) + "  " + line.task() + "#" + std::to_string(line.attempt()) + "  " +
         line.text();
}

// All lines after `after`, which becomes the last one's number.
Result<std::vector<pb::TaskLogLine>> Fetch(coordinator::Client& client, int64_t job, const std::string& task,
                                           uint64_t* after) {
  std::vector<pb::TaskLogLine> lines;
  while (true) {
    RG_ASSIGN_OR_RETURN(const auto reply, client.Logs(job, task, *after));
    if (reply.lines_size() == 0) return lines;
    *after = reply.lines(reply.lines_size() - 1).sequence();
    lines.insert(lines.end(), reply.lines().begin(), reply.lines().end());
  }
}

// Of each task the attempt before its newest; tasks of a single attempt have none.
Result<std::vector<pb::TaskLogLine>> OfPreviousAttempts(coordinator::Client& client, int64_t job,
                                                        std::vector<pb::TaskLogLine> lines) {
  RG_ASSIGN_OR_RETURN(const auto details, client.GetJob(job));
  std::map<std::string, uint32_t> newest;
  for (const auto& task : details.tasks()) newest[task.name()] = task.attempts();
  std::erase_if(lines,
                [&](const pb::TaskLogLine& line) { return line.attempt() + 1 != newest[line.task()]; });
  return lines;
}

void Say(const Context& context, const std::vector<pb::TaskLogLine>& lines) {
  for (const auto& line : lines)
    Print(context.json() ? coordinator::Dump(coordinator::LogLineJson(line)) : LineText(line));
}

// Until the job is over; JSON Lines, as for every stream.
Status Follow(Context& context, coordinator::Client& client, const LogArguments& arguments, int64_t job,
              std::vector<pb::TaskLogLine> lines, uint64_t after) {
  Say(context, lines);
  while (true) {
    RG_ASSIGN_OR_RETURN(const auto now, client.WatchJob(job, 0, 0));
    RG_ASSIGN_OR_RETURN(lines, Fetch(client, job, arguments.task, &after));
    Say(context, lines);
    std::fflush(stdout);
    if (IsOver(now.job().state())) return Status::Ok();
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
  }
}

// What there is now.
Result<std::vector<pb::TaskLogLine>> LinesOf(coordinator::Client& client, const LogArguments& arguments,
                                             int64_t job, uint64_t* after) {
  RG_ASSIGN_OR_RETURN(auto lines, Fetch(client, job, arguments.task, after));
  if (arguments.previous) {
    RG_ASSIGN_OR_RETURN(lines, OfPreviousAttempts(client, job, std::move(lines)));
  }
  if (arguments.tail > 0 && lines.size() > arguments.tail)
    lines.erase(lines.begin(), lines.end() - arguments.tail);
  return lines;
}

Status ShowLogs(Context& context, const LogArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  RG_ASSIGN_OR_RETURN(const auto ids, ParseSelector(arguments.id, *client));
  if (arguments.follow && ids.size() != 1) return context.Usage(InvalidError("--follow: one job at a time"));
  json jobs = json::array();
  for (int64_t id : ids) {
    if (id == 0) {  // the newest, which may be another one in a moment
      RG_ASSIGN_OR_RETURN(const auto newest, client->WatchJob(0, 0, 0));
      id = newest.job().id();
    }
    uint64_t after = 0;
    RG_ASSIGN_OR_RETURN(auto lines, LinesOf(*client, arguments, id, &after));
    if (arguments.follow) return Follow(context, *client, arguments, id, std::move(lines), after);
    if (!context.json()) Say(context, lines);
    json list = json::array();
    for (const auto& line : lines) list.push_back(coordinator::LogLineJson(line));
    jobs.push_back({{"lines", std::move(list)}});
  }
  if (!context.json()) return Status::Ok();
  const bool is_single = arguments.id != "all" && ids.size() == 1;
  PrintJson(is_single ? "realitygrad.logs/1" : "realitygrad.logs-of-jobs/1",
            is_single ? jobs.front() : json{{"jobs", jobs}});
  return Status::Ok();
}

}  // namespace

void AddLogCommand(CLI::App& job, Context& context) {
  auto arguments = std::make_shared<LogArguments>();
  CLI::App* logs = job.add_subcommand("logs", "What its tasks said");
  logs->add_option("ID", arguments->id, "5, 1-10, 1,3, all or last")->capture_default_str();
  logs->add_option("--task", arguments->task, "Only this task");
  CLI::Option* follow = logs->add_flag("-f,--follow", arguments->follow,
                                       "Go on until the job is over (with --output json: JSON Lines)");
  logs->add_option("--tail", arguments->tail, "Only the last so many lines of what is there")
      ->check(CLI::PositiveNumber);
  logs->add_flag("--previous", arguments->previous, "Of each task the attempt before its newest")
      ->excludes(follow);
  logs->callback([&context, arguments] { context.Failed(ShowLogs(context, *arguments)); });
}

}  // namespace rg::cli
