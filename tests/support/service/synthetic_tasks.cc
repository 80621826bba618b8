#include "tests/support/service/synthetic_tasks.h"

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/clock.h"
#include "common/base/rng.h"
#include "coordinator/client/client.h"

namespace rg::testing {
namespace {

using nlohmann::json;
using worker::TaskContext;
using worker::TaskInput;
using worker::TaskOutputs;

json Options(const TaskInput& input) {
  const json options = json::parse(input.payload, nullptr, false);
  return options.is_object() ? options : json::object();
}

TaskOutputs One(std::string bytes, const std::string& summary = "{}") {
  TaskOutputs outputs;
  outputs.artifacts.push_back({"out", "text", std::move(bytes), "{}", {}});
  outputs.summary_json = summary;
  return outputs;
}

void SleepFor(double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); }

Result<TaskOutputs> Echo(const TaskInput& input, TaskContext&) {
  std::string text = Options(input).value("text", "");
  for (const auto& artifact : input.inputs) text += artifact.bytes;
  return One(text);
}

// For `seconds`, or until there is the file `until`.
Result<TaskOutputs> Sleep(const TaskInput& input, TaskContext& context) {
  const json options = Options(input);
  const double seconds = options.value("seconds", 1.0);
  const std::string until = options.value("until", "");
  const double begin = RealClock().SteadySeconds();
  double elapsed = 0.0;
  while ((elapsed = RealClock().SteadySeconds() - begin) < seconds) {
    if (context.cancelled()) return CancelledError("told to stop");
    if (!until.empty() && access(until.c_str(), F_OK) == 0) break;
    context.Progress({"sleeping", elapsed, seconds, ""});
    SleepFor(std::min(0.02, seconds - elapsed));
  }
  return One(input.task_name + " slept");
}

Result<TaskOutputs> Fail(const TaskInput& input, TaskContext& context) {
  const json options = Options(input);
  context.Log("about to fail");
  if (options.contains("until") && input.attempt > options["until"].get<uint32_t>()) return One("recovered");
  return Status(static_cast<StatusCode>(options.value("code", 12)), "as it was told");
}

Result<TaskOutputs> Crash(const TaskInput& input, TaskContext&) {
  const json options = Options(input);
  if (options.contains("until") && input.attempt > options["until"].get<uint32_t>()) return One("survived");
  fprintf(stderr, "famous last words\n");
  raise(SIGKILL);
  return One("");
}

Result<TaskOutputs> Garble(const TaskInput&, TaskContext& context) {
  printf("printed \xff\xfe\n");
  fflush(stdout);
  context.Log("logged \xff\xfe");
  context.Progress({"\xff", 1.0, 2.0, "\xfe"});
  return InternalError("failed \xff\xfe");
}

Result<TaskOutputs> Hang(const TaskInput&, TaskContext&) {
  while (true) SleepFor(3600.0);
}

Result<TaskOutputs> Count(const TaskInput& input, TaskContext& context) {
  const json options = Options(input);
  const int to = options.value("to", 10);
  const std::string checkpoint = context.LoadCheckpoint();
  const int begin = checkpoint.empty() ? 0 : std::stoi(checkpoint);
  for (int i = begin; i < to; ++i) {
    if (context.cancelled()) return CancelledError("told to stop");
    SleepFor(options.value("step_seconds", 0.05));
    RG_RETURN_IF_ERROR(context.SaveCheckpoint(std::to_string(i + 1)));
    context.Progress({"counting", i + 1.0, static_cast<double>(to), ""});
    context.Log("counted to " + std::to_string(i + 1));
  }
  const json result = {{"began_at", begin}, {"attempt", input.attempt}, {"ended_at", to}};
  return One(result.dump(), result.dump());
}

Result<TaskOutputs> Blob(const TaskInput& input, TaskContext&) {
  const json options = Options(input);
  Rng rng(options.value("seed", uint64_t{1}));
  std::string bytes(options.value("bytes", size_t{1}), '\0');
  for (char& byte : bytes) byte = static_cast<char>(rng.Next() & 0xff);
  return One(std::move(bytes));
}

Result<TaskOutputs> Append(const TaskInput& input, TaskContext&) {
  const json options = Options(input);
  const std::string line = options.value("line", input.task_name) + "\n";
  const int fd = open(options.value("path", "").c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (fd < 0) return InvalidError("path cannot be opened");
  const bool written = write(fd, line.data(), line.size()) == static_cast<ssize_t>(line.size());
  SleepFor(options.value("seconds", 0.0));
  const std::string last = options.value("last_line", "");
  if (!last.empty() && write(fd, (last + "\n").data(), last.size() + 1) < 0) return InternalError("short write");
  close(fd);
  return written ? Result<TaskOutputs>(One(line)) : Result<TaskOutputs>(InternalError("short write"));
}

Result<TaskOutputs> StopSlowly(const TaskInput& input, TaskContext& context) {
  while (!context.cancelled()) SleepFor(0.01);
  SleepFor(Options(input).value("needs", 0.0));
  return Append(input, context);
}

Result<TaskOutputs> Parameters(const TaskInput& input, TaskContext&) {
  const json options = Options(input);
  const json metadata = {
      {"robot", options.value("robot", "arm")},
      {"source", "identified"},
      {"rollout", options.value("rollout", "")},
      {"held_back", options.value("held_back", false)},
      {"residual_before", 2.0},
      {"residual_after", 1.0},
      {"values", {{{"name", "mass.arm"}, {"value", options.value("value", 1.0)}, {"stddev", 0.1}}}}};
  TaskOutputs outputs;
  outputs.artifacts.push_back({"out", "parameters", metadata["values"].dump(), metadata.dump(), {}});
  outputs.remark = options.value("remark", "");
  return outputs;
}

// Submits a job of `parts` tasks which sleep for `seconds`, and waits for what they say.
Result<TaskOutputs> Lead(const TaskInput& input, TaskContext& context) {
  const json options = Options(input);
  RG_ASSIGN_OR_RETURN(const auto coordinator, context.Coordinator());
  realitygrad::v1::JobSpec job;
  job.set_kind("parts");
  for (int i = 0; i < options.value("parts", 2); ++i) {
    auto* task = job.add_tasks();
    task->set_name("part" + std::to_string(i));
    task->set_kind("sleep");
    task->set_payload(json{{"seconds", options.value("seconds", 0.1)}}.dump());
  }
  RG_ASSIGN_OR_RETURN(const int64_t id, coordinator->Submit(job, "parts"));
  context.Progress({"leading", 0.0, 1.0, ""});
  if (options.value("leave", false)) return One("left them");
  RG_RETURN_IF_ERROR(coordinator->WaitForJob(id, 60.0).status());
  RG_ASSIGN_OR_RETURN(const auto done, coordinator->GetJob(id));
  std::string text;
  for (const auto& task : done.tasks()) {
    for (const auto& output : task.outputs()) {
      RG_ASSIGN_OR_RETURN(const std::string said, coordinator->GetArtifact(output.sha256()));
      text += said + ";";
    }
  }
  return One(text, json{{"job", id}, {"attempt", input.attempt}}.dump());
}

}  // namespace

worker::TaskRegistry SyntheticTasks() {
  worker::TaskRegistry registry;
  registry.Register("echo", Echo);
  registry.Register("sleep", Sleep);
  registry.Register("fail", Fail);
  registry.Register("crash", Crash);
  registry.Register("garble", Garble);
  registry.Register("hang", Hang);
  registry.Register("stop_slowly", StopSlowly, 60.0);
  registry.Register("count", Count);
  registry.Register("blob", Blob);
  registry.Register("append", Append);
  registry.Register("parameters", Parameters);
  registry.Register("lead", Lead);
  return registry;
}

void AddSyntheticRobotTasks(worker::TaskRegistry* registry) { registry->Register("rollout", Append); }

worker::TaskRegistry SyntheticRobotTasks() {
  worker::TaskRegistry registry;
  AddSyntheticRobotTasks(&registry);
  return registry;
}

}  // namespace rg::testing
