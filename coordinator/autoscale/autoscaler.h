// Workers on a cluster, as many as there is work for: asks for allocations and gives them back (plan.h), from
// a thread of its own beside the coordinator, to which it is a viewer among others.
//
// What is asked for is written down first, in a file beside the database, under a name that the cluster will
// show: a coordinator that was killed finds its allocations again and asks for nothing twice. The workers
// stay when the coordinator stops, for as long as their patience lasts.
#pragma once

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "common/base/status.h"
#include "coordinator/autoscale/plan.h"
#include "coordinator/autoscale/slurm.h"
#include "coordinator/client/client.h"

namespace CLI {
class App;
}

namespace rg::coordinator::autoscale {

struct Flags {
  std::string manager;  // "slurm"; empty: none
  std::string address, worker, worker_key, server_key;
  std::vector<std::string> sbatch, tags;
  int max_allocations = 8;
  uint32_t slots = 1;
  double idle_s = 60.0, period_s = 5.0, patience_s = 900.0;
};

void AddFlags(CLI::App& app, Flags& flags);

// The file of the state: {"format": "realitygrad.allocations/1", …}. `prefix` of all tags is made with the
// file.
struct Stored {
  std::string prefix;
  State state;
};
Result<Stored> LoadOrMake(const std::string& path);
Status Save(const std::string& path, const Stored& stored);

class Autoscaler {
 public:
  // What can be told of the flags before anything is begun. kInvalid.
  static Status Check(const Flags& flags, const std::string& endpoint);
  // Null if the flags want none. Tries out whether the cluster would take such an allocation: kInvalid if
  // not.
  static Result<std::unique_ptr<Autoscaler>> Start(const Flags& flags, const std::string& endpoint,
                                                   const std::string& database, ClientOptions viewer);
  ~Autoscaler();

  // {"autoscale": {"manager", "running", "pending", "in_vain", "note"}}
  std::string StatusJson() const;

 private:
  Autoscaler(Limits limits, std::vector<std::string> tags, std::string file, Stored stored, Slurm slurm,
             ClientOptions viewer, double period_s);
  void Work();
  void Turn();
  Result<Seen> Look();
  void Ask(const std::string& tag);
  void GiveBack(const std::string& id);
  void Keep();
  void TidyLogs(int64_t now_ns);
  void Say(std::string note);

  const Limits limits_;
  const std::vector<std::string> tags_;
  const std::string file_;
  Stored stored_;
  std::string written_;
  int64_t tidied_ns_ = 0;
  const Slurm slurm_;
  const ClientOptions viewer_;
  const double period_s_;
  std::unique_ptr<Client> client_;
  mutable std::mutex mutex_;  // guards what follows
  std::condition_variable wake_;
  bool stop_ = false;
  int running_ = 0, pending_ = 0, in_vain_ = 0;
  std::string note_;
  std::thread thread_;
};

}  // namespace rg::coordinator::autoscale
