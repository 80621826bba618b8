// The service on this machine: the programs of this build as children, on a socket in a folder that only
// this user can enter. What `run`, `experiment` and `bench` work through; there is no other path.
#pragma once

#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <thread>

#include "common/base/status.h"
#include "services/cli/child_processes.h"

namespace realitygrad::v1 {
class GetJobReply;
class JobSpec;
class TaskOutput;
}  // namespace realitygrad::v1

namespace rg::coordinator {
class Client;
}

namespace rg::cli {

struct LocalServiceOptions {
  std::string folder;        // database, logs, caches, spool; must exist
  std::string agent_config;  // file; the agent of a simulated robot
  int workers = 1;
  bool lock_step = false;  // the simulated robot does not wait for real time
  std::string stand_in;    // file, realitygrad.stand_in/1; empty: no ROS master, no stand-in
  uint64_t seed = 1;       // of the stand-in
  bool quiet = false;      // nothing is said of workers that are started again
};

class LocalService {
 public:
  LocalService();
  // Stops the programs; what they had committed stays in the folder.
  ~LocalService();
  // Returns when all programs have joined the coordinator. Error: one of them ended, or 20 s passed.
  Status Start(const LocalServiceOptions& options);
  coordinator::Client& client() { return *client_; }
  const std::string& address() const { return address_; }
  // Ok while the programs are running. From Start on they are watched: a worker that ended is started again, three
  // times. Where that does not help, or another program ended, this says which, and the client's call under way and
  // all later ones return kCancelled. An agent is never started again: nobody knows what its arm was doing.
  Status Check();

 private:
  Status StartPrograms(const LocalServiceOptions& options);
  Status AwaitWorkers(size_t count);
  void Watch();
  // Ok: nothing ended, or what ended runs again.
  Status LookAfterChildren();

  ChildProcesses arm_;  // the stand-in and its ROS master: stopped after the agent
  ChildProcesses children_;  // from Start on the watcher's, until it has ended
  std::unique_ptr<coordinator::Client> client_;
  std::string address_, socket_folder_, address_file_;
  bool quiet_ = false;
  std::map<std::string, int> started_again_;

  std::mutex mutex_;  // of what follows
  std::condition_variable wake_;
  bool end_ = false;
  Status trouble_;
  std::thread watcher_;
};

// Ctrl-C from now on: the call of a LocalService's client that is under way returns kCancelled; nothing
// is lost.
void InstallInterruptHandlers();
bool Interrupted();

// Submits, shows progress on stderr unless `quiet`, waits for success; the job with its tasks. The same
// `request_id` always means the same job. Errors: kCancelled, kAborted with the job's reason.
Result<realitygrad::v1::GetJobReply> RunJob(coordinator::Client& client, realitygrad::v1::JobSpec job,
                                            const std::string& request_id, bool quiet);
// The last output of a kind of artefact, in the order of the graph; null if there is none.
const realitygrad::v1::TaskOutput* FindOutput(const realitygrad::v1::GetJobReply& job,
                                              const std::string& kind);
// The "realitygrad.iteration/1" of an iteration's or identification's job, with "seconds" per stage, "job"
// and the hash of the new "model" added.
Result<nlohmann::json> FetchResult(coordinator::Client& client, const realitygrad::v1::GetJobReply& job);

}  // namespace rg::cli
