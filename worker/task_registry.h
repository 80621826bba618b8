// What algorithms register against: a kind of task is a name and a function.
//
//   TaskRegistry registry;
//   registry.Register("trajectories.shard", [](const TaskInput& input, TaskContext& context)
//       -> Result<TaskOutputs> { … });
//   return worker::WorkerMain(argc, argv, registry);
//
// The function runs in a child process, one task at a time. It must be deterministic in its payload
// and inputs (seeds travel in the payload): a task may run more than once, on several hosts, and any
// of the results may be the one that is committed. An error status ends the attempt; its code says
// whether another attempt can help (TaskFailureIsRetryable).
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"

namespace rg::coordinator {
class Client;
}

namespace rg::worker {

// An artefact that the task reads; its bytes have been checked against `sha256`.
struct InputArtifact {
  std::string name;    // as the job's graph calls it; the inputs of a whole stage share one name
  std::string sha256;  // 64 hexadecimal digits
  std::string kind;    // "dataset", "policy", "recording", …
  std::string metadata_json;
  std::string from_task;    // name of the producing task; empty if the client named the artefact
  std::string from_output;  // name of its output
  std::string bytes;
};

struct TaskInput {
  std::string kind;
  std::string task_name;
  std::string job_name;
  int64_t job = 0;
  int64_t task = 0;
  std::string database = {};  // identity of the one that these are numbers of
  uint32_t attempt = 1;  // from 1
  std::string payload;
  std::vector<InputArtifact> inputs;  // in the order of the graph

  // The first input of that name, or null.
  const InputArtifact* Find(std::string_view name) const;
  // The same, where absence is an error that names the input.
  Result<const InputArtifact*> Require(std::string_view name) const;
  // Every input of that name, in the order of the graph.
  std::vector<const InputArtifact*> All(std::string_view name) const;
};

struct OutputArtifact {
  std::string name;  // children name it as (task, name)
  std::string kind;
  std::string bytes;
  // An object. For kind "parameters" it must have {"robot": name, "source": "nominal" | "identified" |
  // "imported", "values": [{"name", "value", "stddev"?}, …]} and may have "residual_before",
  // "residual_after", "recording" and "model" (hashes), "parent_version", "note", "rollout" (how it ended),
  // "held_back"; such an output becomes a version of the parameter history.
  std::string metadata_json = "{}";
  // Hashes of artefacts it derives from besides the task's inputs, which are always its parents.
  std::vector<std::string> extra_parents;
};

struct TaskOutputs {
  std::vector<OutputArtifact> artifacts;
  std::string summary_json = "{}";  // at most 64 KiB; shown in `job show`, kept in the task's row
  std::string remark;  // what did not go as asked though this is a result, one line: the task's and its job's reason
};

// How a running task speaks with the outside. All calls may be made from any thread of the task.
class TaskContext {
 public:
  virtual ~TaskContext() = default;

  // Call as often as convenient; forwarded at most every 200 ms.
  virtual void Progress(const ProgressUpdate& update) = 0;
  // True once the job was cancelled, the lease was lost or the worker must stop. Return soon then,
  // with CancelledError or with what there is; the result no longer counts.
  bool cancelled() const { return cancel_token().cancelled(); }
  virtual const CancelToken& cancel_token() const = 0;
  // The newest checkpoint of any earlier attempt on any worker (empty: none), and a new one, which
  // replaces it. Save returns when it is on its way, not when it is durable. At most 64 MiB.
  virtual std::string LoadCheckpoint() = 0;
  virtual Status SaveCheckpoint(std::string bytes) = 0;
  // One line of the task's log, kept by the coordinator (the last few thousand lines of a task).
  virtual void Log(std::string_view line) = 0;
  // An empty folder of this attempt, removed after it.
  virtual const std::string& scratch_folder() const = 0;
  // A connection that speaks for this task, under its lease: it may read everything, put artefacts, and
  // submit jobs, and cancel those. Such a job is over when the task is. The same request id is the same job
  // for every attempt, so that one which takes up after a lost worker finds what that one had asked for.
  // kUnavailable: there is no coordinator.
  virtual Result<std::shared_ptr<coordinator::Client>> Coordinator() {
    return UnavailableError("this task runs without a coordinator");
  }

  // Progress as a callback for the numeric rooms.
  ProgressFn progress_fn() {
    return [this](const ProgressUpdate& update) { Progress(update); };
  }
};

using TaskFunction = std::function<Result<TaskOutputs>(const TaskInput&, TaskContext&)>;

// invalid, already exists, failed precondition, permission denied, not found: never; else: yes.
bool TaskFailureIsRetryable(StatusCode code);

class TaskRegistry {
 public:
  // The kind must be new (RG_CHECK). `least_grace_s`: what a cancelled task of it needs to return, where that is more
  // than other kinds are given.
  void Register(std::string kind, TaskFunction function, double least_grace_s = 0.0);
  const TaskFunction* Find(std::string_view kind) const;  // null: not registered
  std::vector<std::string> kinds() const;                 // sorted
  const std::map<std::string, double, std::less<>>& least_grace_s() const { return least_grace_s_; }

 private:
  std::map<std::string, TaskFunction, std::less<>> functions_;
  std::map<std::string, double, std::less<>> least_grace_s_;
};

// A context for calling a task function directly, in tests: it records what the function said.
class RecordingTaskContext final : public TaskContext {
 public:
  explicit RecordingTaskContext(std::string scratch_folder, std::string checkpoint = "");
  void Progress(const ProgressUpdate& update) override { progress.push_back(update); }
  const CancelToken& cancel_token() const override { return cancel; }
  std::string LoadCheckpoint() override { return checkpoint; }
  Status SaveCheckpoint(std::string bytes) override;
  void Log(std::string_view line) override { lines.emplace_back(line); }
  const std::string& scratch_folder() const override { return scratch_folder_; }

  CancelToken cancel;
  std::string checkpoint;
  int checkpoints_saved = 0;
  std::vector<ProgressUpdate> progress;
  std::vector<std::string> lines;

 private:
  std::string scratch_folder_;
};

}  // namespace rg::worker
