// A service of real programs for `bench service`: an encrypted coordinator on loopback, its database in a
// folder of its own on a real disk, workers as processes. Everything is stopped and removed at the end.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "services/cli/child_processes.h"

namespace rg::coordinator {
class Client;
}

namespace rg::lab {

class ServiceRig {
 public:
  // kInternal: no folder can be made under /var/tmp.
  static Result<std::unique_ptr<ServiceRig>> Make(const CancelToken* cancel);
  ~ServiceRig();

  // Returns when it listens; seconds from its start to its first answer.
  Result<double> StartCoordinator();
  void StopCoordinator();
  // A process with `flags` of RunSimulatedWorkers (services/lab/bench_command.cc).
  Status StartSimulatedWorkers(const std::string& prefix, const std::vector<std::string>& flags);
  Status StartWorker(const std::string& name, int slots);
  void StopWorkers(double grace_s = 3.0);
  // Until so many are connected; kUnavailable after a minute.
  Status AwaitWorkers(size_t count);
  // Ok while all programs are running and nobody has interrupted.
  Status Check();

  coordinator::Client& client() { return *client_; }
  Result<std::unique_ptr<coordinator::Client>> NewClient() const;
  const std::string& folder() const { return folder_; }
  std::string database() const { return folder_ + "/service.db"; }
  // Of the coordinator's process so far.
  double CoordinatorCpuSeconds() const;
  double CoordinatorMiB(bool peak) const;

 private:
  explicit ServiceRig(std::string folder, const CancelToken* cancel)
      : folder_(std::move(folder)), cancel_(cancel) {}
  Status MakeKeys();

  const std::string folder_;
  const CancelToken* cancel_;
  std::string address_;
  cli::ChildProcesses coordinator_, workers_;
  std::unique_ptr<coordinator::Client> client_;
};

}  // namespace rg::lab
