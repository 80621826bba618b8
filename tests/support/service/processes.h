// A coordinator and workers as real processes on local sockets, in a folder of their own; and short
// ways to say what a job is. Everything is killed and removed at the end.
#pragma once

#include <sys/types.h>

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "coordinator/client/client.h"

namespace rg::testing {

namespace pb = realitygrad::v1;

// A child process; killed when the object goes.
class Process {
 public:
  // stdout and stderr go to `log_path`.
  Process(const std::vector<std::string>& arguments, const std::string& log_path);
  ~Process();
  Process(const Process&) = delete;
  void Signal(int number) const;
  // -1: still running after the time.
  int WaitForExit(double timeout_s);
  void KillNow();
  pid_t pid() const { return pid_; }

 private:
  pid_t pid_ = -1;
  bool ended_ = false;
  int exit_code_ = -1;
};

class Service {
 public:
  // `more` are further flags of the coordinator.
  explicit Service(int heartbeat_ms = 400, std::vector<std::string> more = {});
  ~Service();

  void StartCoordinator();     // again after a kill: on the same endpoint and database
  bool TryStartCoordinator();  // false: it ended before it listened
  void KillCoordinator();      // kill -9
  // Of the coordinators that are started from now on: a file of folder().
  void UseDatabase(const std::string& name) { database_ = name; }
  std::string database() const { return folder_ + "/" + database_; }
  Process& coordinator() { return *coordinator_; }
  // `more` are further flags.
  Process& StartWorker(const std::string& name, int slots = 1, const std::vector<std::string>& more = {});
  // One that runs the kind "rollout".
  Process& StartAgent(const std::string& name, const std::vector<std::string>& more = {});
  Process& worker(const std::string& name) { return *workers_.at(name); }

  coordinator::Client& client() { return *client_; }
  std::unique_ptr<coordinator::Client> NewClient() const;
  const std::string& folder() const { return folder_; }
  std::string endpoint() const { return "ipc://" + folder_ + "/socket"; }
  double Counter(const std::string& name);
  // Waits until `workers` are connected.
  bool WaitForWorkers(uint32_t workers, double timeout_s = 20.0);
  // Until the task itself has said something: a lease alone may still be on its way to the worker.
  bool WaitForProgress(int64_t job, const std::string& task, double timeout_s = 20.0);
  bool WaitForTask(int64_t job, const std::string& task, pb::TaskState state, double timeout_s = 20.0);
  // The end of everything that was logged, for a failing test.
  std::string Logs() const;

 private:
  Process& StartProgram(const std::string& name, const std::vector<std::string>& flags);

  std::string folder_;
  std::string database_ = "service.db";
  int heartbeat_ms_;
  std::vector<std::string> more_;
  int starts_ = 0;
  std::unique_ptr<Process> coordinator_;
  std::map<std::string, std::unique_ptr<Process>> workers_;
  std::unique_ptr<coordinator::Client> client_;
};

// A task of a synthetic kind.
pb::TaskSpec* AddTask(pb::JobSpec* job, const std::string& name, const std::string& kind,
                      const std::string& payload_json = "{}");
void AddInput(pb::TaskSpec* task, const std::string& name, const std::string& from_task,
              bool optional = false);
void AddStageInput(pb::TaskSpec* task, const std::string& name, const std::string& stage);
const pb::TaskInfo* FindTask(const pb::GetJobReply& reply, const std::string& name);
std::string BinFolder();

}  // namespace rg::testing
